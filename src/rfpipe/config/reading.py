"""Reading files of settings, YAML and tables: what can't be meant is an error with its place."""

from __future__ import annotations

import csv
import difflib
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config.base import merged
from rfpipe.config.model import OWN_TO_SCENES
from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import ConfigError, InputError

_FOLDER = re.compile(r"(?!(con|prn|aux|nul|(com|lpt)[0-9])$)[a-z][a-z0-9_]{0,99}")
_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
_MORE_THAN_ONE_NUMBER = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-9]{1,2})+(\.[0-9_]*)?)")
"""Octal with a leading zero, and sixties with colons: 010 is 8 and 1:30 is 90 in YAML 1.1."""


def read_yaml(path: str | Path) -> object:
    """Read a YAML file.

    Raises
    ------
    ConfigError
        When it can't be read, is empty, isn't UTF-8 or YAML, has a key twice or one that is no
        text, or holds what may be meant as one of two numbers: with its place.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ConfigError(_unreadable(Path(path), error)) from error
    except UnicodeDecodeError as error:
        raise ConfigError(
            f"{path}: isn't text in the encoding UTF-8 ({error}); save it as UTF-8"
        ) from error
    try:
        data = parse_yaml(text)
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:
        message = str(error).replace('"<unicode string>"', f'"{path}"')
        raise ConfigError(f"{path}: is not valid YAML: {message}") from error
    if data in (None, {}):
        raise ConfigError(f"{path}: is empty; expected 'key: value' lines, see config/README.md")
    return data


def _unreadable(path: Path, error: OSError) -> str:
    """Describe why a settings file can't be read; names alike in its folder are suggested."""
    if path.is_dir():
        return f"{path}: is a folder; name a settings file, such as {path / 'config.yaml'}"
    if not isinstance(error, FileNotFoundError):
        return f"{path}: can't be read as a settings file: {error.strerror or error}"
    folder = path.parent
    if not folder.is_dir():
        return f"there is no file {path}: there is no folder {folder}"
    names = [each.name for each in sorted(folder.iterdir()) if each.suffix in (".yaml", ".yml")]
    close = difflib.get_close_matches(path.name, names, n=3)
    here = f" in {Path.cwd()}" if not path.is_absolute() else ""
    meant = f"; did you mean {' or '.join(str(folder / name) for name in close)}?" if close else ""
    return f"there is no file {path}{here}{meant}"


def parse_yaml(text: str) -> Any:
    """Read YAML as settings files have it; raises yaml.YAMLError with the place."""
    return yaml.load(text, Loader=_Loader)


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, stricter."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in keys:
                raise _wrong(f"the key {key!r} stands twice; remove one", key_node.start_mark)
            keys.add(key)
        return super().construct_mapping(node, deep)

    def checked_scalar(self, node: yaml.ScalarNode) -> Any:
        """Construct a number or a text, unless it could be meant as one of two numbers."""
        text = str(node.value)
        if node.style is None and _MORE_THAN_ONE_NUMBER.fullmatch(text):
            raise _wrong(
                f"{text} may be meant as one of two numbers: a leading 0 means octal in YAML, and "
                "colons sixties. Write a decimal number without them, or put it in quotes if it "
                "is a text",
                node.start_mark,
            )
        return yaml.SafeLoader.yaml_constructors[node.tag](self, node)


for _kind in ("int", "float", "str", "timestamp"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.checked_scalar)


def _wrong(what: str, mark: yaml.Mark | None) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, what, mark)


@dataclass(frozen=True)
class Collection:
    """The scenes of a table, each with its settings and its place in the file (``line 3``).

    `problems` are what is wrong with the table itself, each with its place.
    """

    file: Path
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_collection(file: Path, methods: Mapping[str, object]) -> Collection:
    """Read the scenes of a CSV file.

    It has commas, semicolons or tabs, in UTF-8 or UTF-16, and a header that names settings. A scene
    that sets options of some methods and chooses none has the run's. Problems are every row whose
    name is missing, stands twice or fits no folder, which goes on as ``line_3`` so that its other
    mistakes are found; cells without a column, those that aren't YAML though they begin with a
    bracket, and names of files that aren't there. ConfigError when the file can't be read.
    """
    collection = Collection(file)
    for place, row in _csv_rows(file):
        wrong = []
        name = row.pop("name", "")
        if unfit := _unfit(name, collection.places):
            wrong.append(unfit)
            name = place.replace(" ", "_")
        collection.places[name] = place
        if astray := row.pop("", None):
            wrong.append(f"{astray!r} stands in a column without name")
        values = {}
        for column, cell in row.items():
            try:
                values[column] = _value(cell, column)
            except yaml.YAMLError as error:
                wrong.append(f"{column}: {' '.join(str(error).split())}")
        collection.scenes[name] = _scene(values, methods)
        wrong += _missing_files(values)
        collection.problems.extend(f"{file}: {place}: {each}" for each in wrong)
    if not collection.places:
        raise ConfigError(f"{file}: has no scenes; expected a row for each")
    return collection


def _missing_files(row: Mapping[str, Any]) -> list[str]:
    """Return what is wrong with the files that a scene's settings name."""
    options: tuple[str, ...] = ()
    with suppress(InputError):  # no such kind, which the model says
        options = SceneSettings.model_of(str(row.get("kind"))).files
    return [
        f"{option} is {row[option]!r}, which isn't there"
        for option in options
        if isinstance(row.get(option), str) and not Path(row[option]).exists()
    ]


def _csv_rows(file: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the filled cells of each row of a CSV file by column, and the row's line."""
    try:
        content = file.read_bytes()
        is_wide = content[:2] in (b"\xff\xfe", b"\xfe\xff")
        text = content.decode("utf-16" if is_wide else "utf-8-sig")
        delimiter = max(",;\t", key=text[: re.search(r"[\r\n]|$", text).start()].count)  # type: ignore[union-attr]
        reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
        records = [(reader.line_num, [cell.strip() for cell in cells]) for cells in reader]
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise ConfigError(
            f"{file}: can't be read as a table: {error}; save it as CSV in the encoding UTF-8"
        ) from error
    filled = [
        (line, cells)
        for line, cells in records
        if any(cells) and not cells[0].startswith(("#", "sep="))
    ]
    line, header = filled[0] if filled else (1, [])
    twice = {column for column in header if column and header.count(column) > 1}
    if "name" not in header or twice:
        expected = f"{', '.join(sorted(twice))} stands twice" if twice else "has no column 'name'"
        raise ConfigError(f"{file}: line {line}: the header {expected}; it is {header}")
    for line, cells in filled[1:]:
        named = dict(zip(header, cells, strict=False))
        named[""] = next(filter(None, cells[len(header) :]), named.get("", ""))
        row = {column: cell for column, cell in named.items() if cell}
        if delimiter == ";":
            row |= {
                column: _DECIMAL_COMMA.sub(".", cell)
                for column, cell in row.items()
                if not column.startswith("about.")
            }
        yield f"line {line}", row


def _scene(row: Mapping[str, Any], methods: Mapping[str, object]) -> dict[str, Any]:
    """Return a scene's settings as the model takes them; those of the run are its ``settings``."""
    scene = _nested(row)
    if "methods" in scene:
        options = scene["methods"]
        chosen = row.get("methods") or dict.fromkeys(methods)
        names: dict[str, Any] = {name: {} for name in chosen}
        scene["methods"] = merged(names, options) if isinstance(options, Mapping) else names
    overrides = {name: scene.pop(name) for name in OWN_TO_SCENES - {"seed"} if name in scene}
    return merged(scene, {"settings": overrides}) if overrides else scene


def _nested(row: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings in groups: ``{"camera.bits": 12}`` as ``{"camera": {"bits": 12}}``."""
    tree: dict[str, Any] = {}
    for name, value in sorted(row.items()):  # methods before options of some
        parts = name.split(".", 1) if name.startswith("about.") else name.split(".")
        tree = merged(tree, reduce(lambda inner, part: {part: inner}, reversed(parts), value))
    return tree


def _value(text: str, column: str) -> Any:
    """Return a cell as the setting takes it: a text, which the model reads, or YAML."""
    if column.startswith("about."):
        return text
    if text in ("null", "~"):
        return None
    if text[0] in "[{":
        return parse_yaml(text)
    return re.split(r"[;,\s]+", text) if column == "methods" else text


def _unfit(name: str, places: Mapping[str, str]) -> str | None:
    """Return why a name is none for a scene and its folder, or None."""
    if not name:
        return "the scene has no name; give it one, such as bowl_1"
    if name in places:
        return f"the name {name} stands in {places[name]} as well; change one"
    if _FOLDER.fullmatch(name):
        return None
    return (
        f"the name {name[:110]!r} is not fit for a folder; expected a lower-case letter, then at "
        "most 99 such, digits and _, as in item_3; other names can stand in about.title"
    )
