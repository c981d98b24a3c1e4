"""Reading of settings files, YAML and tables; ambiguous or repeated entries are errors."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import reduce
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config.base import RESERVED_ON_WINDOWS, merge_settings
from rfpipe.config.model import OWN_TO_SCENES
from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import ConfigError, InputError
from rfpipe.text import similar_names

_FOLDER = re.compile(rf"(?!{RESERVED_ON_WINDOWS}$)[a-z][a-z0-9_]{{0,99}}")
"""Name of a scene that is valid as a folder's name, on Windows, too."""

_DECIMAL_COMMA = re.compile(r"(?<=\d),(?=\d)")
_AMBIGUOUS_NUMBER = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-9]{1,2})+(\.[0-9_]*)?)")
"""Octal and sexagesimal numbers of YAML 1.1, in which 010 is 8 and 1:30 is 90."""


def read_yaml(path: str | Path) -> object:
    """Read a YAML file.

    Raises
    ------
    ConfigError
        When the file can't be read, is empty, isn't UTF-8 or YAML, has a key twice or a key that
        isn't a text, or contains an ambiguous number such as 010.
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
    """Describe why a settings file can't be read; suggest files with similar names."""
    if path.is_dir():
        return f"{path}: is a folder; name a settings file, such as {path / 'config.yaml'}"
    if not isinstance(error, FileNotFoundError):
        return f"{path}: can't be read as a settings file: {error.strerror or error}"
    folder = path.parent
    if not folder.is_dir():
        return f"there is no file {path}: there is no folder {folder}"
    names = [file.name for file in sorted(folder.iterdir()) if file.suffix in (".yaml", ".yml")]
    similar = [str(folder / name) for name in similar_names(path.name, names, count=3)]
    in_folder = f" in {Path.cwd()}" if not path.is_absolute() else ""
    suggestion = f"; did you mean {' or '.join(similar)}?" if similar else ""
    return f"there is no file {path}{in_folder}{suggestion}"


def parse_yaml(text: str) -> Any:
    """Parse YAML by the strict rules for settings files; yaml.YAMLError names line and column."""
    return yaml.load(text, Loader=_Loader)


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, without repeated keys and ambiguous numbers."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        keys = set()
        for key_node, _ in node.value:
            key = str(key_node.value)
            if key in keys:
                raise _yaml_error(f"the key {key!r} appears twice; remove one", key_node.start_mark)
            keys.add(key)
        return super().construct_mapping(node, deep)

    def checked_scalar(self, node: yaml.ScalarNode) -> Any:
        """Construct a number or a text; reject ambiguous numbers."""
        text = str(node.value)
        if node.style is None and _AMBIGUOUS_NUMBER.fullmatch(text):
            raise _yaml_error(
                f"{text} is ambiguous: in YAML, a leading 0 means an octal number and colons mean "
                "base 60. Write a decimal number without them, or quotes around a text",
                node.start_mark,
            )
        return yaml.SafeLoader.yaml_constructors[node.tag](self, node)


for _kind in ("int", "float", "str", "timestamp"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.checked_scalar)


def _yaml_error(what: str, mark: yaml.Mark | None) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, what, mark)


@dataclass(frozen=True)
class SceneTable:
    """Scenes of a table.

    Attributes
    ----------
    file : Path
        The table.
    scenes : dict
        Settings of each scene by its name.
    places : dict
        Line of each scene in the file, such as ``line 3``.
    problems : list of str
        Mistakes in the table itself, each with its place.
    """

    file: Path
    scenes: dict[str, dict[str, Any]] = field(default_factory=dict)
    places: dict[str, str] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)


def read_collection(file: Path, methods: Mapping[str, object]) -> SceneTable:
    """Read the scenes of a CSV file.

    The file has commas, semicolons or tabs, in UTF-8 or UTF-16, and a header that names settings.
    A scene that sets options of methods without choosing methods has those of the run.

    Problems are rows whose name is missing, repeated or unsuitable for a folder; cells without a
    column; cells that begin with a bracket and aren't YAML; and names of files that don't exist. A
    row without a valid name is read as ``line_3``, so that its other mistakes are reported as well.

    Raises
    ------
    ConfigError
        When the file can't be read or has no scenes.
    """
    collection = SceneTable(file)
    for place, row in _csv_rows(file):
        wrong = []
        name = row.pop("name", "")
        if problem := _problem_of_name(name, collection.places):
            wrong.append(problem)
            name = place.replace(" ", "_")
        collection.places[name] = place
        if unnamed_cell := row.pop("", None):
            wrong.append(f"{unnamed_cell!r} is in a column without a name; name the column")
        values = {}
        for column, cell in row.items():
            try:
                values[column] = _value(cell, column)
            except yaml.YAMLError as error:
                wrong.append(f"{column}: {' '.join(str(error).split())}")
        collection.scenes[name] = _scene(values, methods)
        wrong += _missing_files(values)
        collection.problems.extend(f"{file}: {place}: {problem}" for problem in wrong)
    if not collection.places:
        raise ConfigError(f"{file}: has no scenes; expected a row for each scene")
    return collection


def _missing_files(row: Mapping[str, Any]) -> list[str]:
    """Return a message for each file that a scene's settings name and that doesn't exist."""
    options: tuple[str, ...] = ()
    with suppress(InputError):  # the model reports an unknown kind
        options = SceneSettings.model_of(str(row.get("kind"))).files
    return [
        f"{option} is {row[option]!r}; there is no such file"
        for option in options
        if isinstance(row.get(option), str) and not Path(row[option]).exists()
    ]


def _csv_rows(file: Path) -> Iterator[tuple[str, dict[str, str]]]:
    """Yield the line of each row of a CSV file, and its non-empty cells by column."""
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
        repeated = f"has {', '.join(sorted(twice))} twice"
        problem = repeated if twice else "has no column 'name'"
        raise ConfigError(f"{file}: line {line}: the header {problem}; it is {header}")
    for line, cells in filled[1:]:
        cell_of = dict(zip(header, cells, strict=False))
        cell_of[""] = next(filter(None, cells[len(header) :]), cell_of.get("", ""))
        row = {column: cell for column, cell in cell_of.items() if cell}
        if delimiter == ";":
            row |= {
                column: _DECIMAL_COMMA.sub(".", cell)
                for column, cell in row.items()
                if not column.startswith("about.")
            }
        yield f"line {line}", row


def _scene(row: Mapping[str, Any], methods: Mapping[str, object]) -> dict[str, Any]:
    """Return a row as the settings of a scene; settings of the run become its ``settings``."""
    scene = _nested(row)
    if "methods" in scene:
        options = scene["methods"]
        sections: dict[str, Any] = {name: {} for name in row.get("methods") or methods}
        scene["methods"] = (
            merge_settings(sections, options) if isinstance(options, Mapping) else sections
        )
    overrides = {name: scene.pop(name) for name in OWN_TO_SCENES - {"seed"} if name in scene}
    return merge_settings(scene, {"settings": overrides}) if overrides else scene


def _nested(row: Mapping[str, Any]) -> dict[str, Any]:
    """Nest dotted names: ``{"camera.bits": 12}`` becomes ``{"camera": {"bits": 12}}``."""
    tree: dict[str, Any] = {}
    for name, value in sorted(row.items()):  # methods before methods.dual.tolerance
        parts = name.split(".", 1) if name.startswith("about.") else name.split(".")
        tree = merge_settings(
            tree, reduce(lambda inner, part: {part: inner}, reversed(parts), value)
        )
    return tree


def _value(text: str, column: str) -> Any:
    """Return the value of a cell: parsed YAML, or a text that the model parses."""
    if column.startswith("about."):
        return text
    if text in ("null", "~"):
        return None
    if text[0] in "[{":
        return parse_yaml(text)
    return re.split(r"[;,\s]+", text) if column == "methods" else text


def _problem_of_name(name: str, places: Mapping[str, str]) -> str | None:
    """Return the reason why a scene's name is invalid, or None."""
    if not name:
        return "the scene has no name; give it one, such as bowl_1"
    if name in places:
        return f"the name {name} is also in {places[name]}; change one of the two"
    if _FOLDER.fullmatch(name):
        return None
    return (
        f"the name {name[:110]!r} is unsuitable for a folder; expected a lower-case letter and at "
        "most 99 more letters, digits and _, as in item_3. Other names can go to about.title"
    )
