"""From the rows of a collection to the scenes of a run, and from what is wrong back to a row."""

from __future__ import annotations

import re
import unicodedata
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rfpipe.config.collection.cells import meant
from rfpipe.config.collection.csv_rows import read_csv
from rfpipe.config.collection.rows import Path_, Row, refused, target_of
from rfpipe.config.collection.yaml_rows import read_yaml_rows
from rfpipe.config.model import DEFAULT_METHODS, Config
from rfpipe.errors import ConfigError

__all__ = ["Gathered", "check_files", "gather"]

_NAME = re.compile(r"[a-z][a-z0-9_]*")
_LONGEST = 100
_WINDOWS = {
    "con",
    "prn",
    "aux",
    "nul",
    *(f"{port}{n}" for port in ("com", "lpt") for n in range(10)),
}
_SCENE_IN = re.compile(r"\bscenes\.([a-z][a-z0-9_]*)((?:\.[a-z_][a-z0-9_]*)*)")
_UNKNOWN = re.compile(r"^scenes\.\w+\.\w+ is unknown; (?!did you mean)")
_NAMES = re.compile(r"[\s,;]+")


@dataclass
class Gathered:
    """The settings of a run with the scenes of its collection among them.

    Attributes
    ----------
    data : mapping
        As `rfpipe.config.Config` takes it.
    file : Path or None
        The collection, if there is one.
    """

    data: Mapping[str, Any]
    file: Path | None = None
    _places: dict[tuple[str, ...], str] = field(default_factory=dict)

    def place_of(self, location: Sequence[str | int], message: str = "") -> str | None:
        """Return where a setting stands in the collection, None for what doesn't.

        Parameters
        ----------
        location : sequence of str or int
            Of the setting, among the run's.
        message : str
            What is said of it, which may name a scene where it is about more than one setting.
        """
        parts = tuple(str(part) for part in location)
        if not parts and (named := _SCENE_IN.search(message)):
            parts = ("scenes", named[1], *named[2].split(".")[1:])
        if len(parts) == 2 and f"{parts[1]}: '" in message:  # a kind that isn't known
            parts = (*parts, "kind")
        for length in range(len(parts), 1, -1):
            if place := self._places.get(parts[:length]) if length > 2 else self._within(parts):
                return place
        return None

    def _within(self, parts: tuple[str, ...]) -> str | None:
        """Return where the first setting of a group stands, or else a row."""
        within = self._places.get(parts[:2])
        if within is None or len(parts) == 2:
            return within
        below = (at for at in self._places if at[:3] == parts[:3])
        return self._places.get(next(below, ()), within)

    def said(self, problems: Sequence[tuple[Sequence[str | int], str]], source: str) -> list[str]:
        """Return mistakes with their places, a line each; what is the same in many rows, once.

        Parameters
        ----------
        problems : sequence of (location, message)
        source : str
            Where settings stand that are none of the collection.
        """
        alike: dict[tuple[object, ...], list[str]] = {}
        for location, message in problems:
            place = self.place_of(location, message)
            if place is None:
                alike[None, message] = [f"{source}: {message}"]
                continue
            told = message
            if _UNKNOWN.search(message) and len(location) == 3:
                told += _instead(str(location[2]))
            column = place.partition(", ")[2]
            scene = str(location[1]) if len(location) > 1 else ""
            same = column, told.replace(f"scenes.{scene}.", "")
            alike.setdefault(same, []).append(f"{self.file}: {place}: {told}")
        return [
            first + (f" [and in {len(others)} more rows]" if others else "")
            for first, *others in alike.values()
        ]


def gather(data: Mapping[str, Any], folders: Sequence[Path] = ()) -> Gathered:
    """Put the rows of a collection among the scenes of a run.

    Parameters
    ----------
    data : mapping
        Settings of a run as YAML gives them; without a ``collection`` they are returned as given.
    folders : sequence of Path
        Where else to look for the file than where rfpipe runs.

    Raises
    ------
    ConfigError
        When the file isn't there or isn't readable, or scenes have no names fit for folders, or
        the same: with line and column.
    """
    asked = data.get("collection")
    if not isinstance(asked, str) or not asked:
        return Gathered(data)
    file = _found(asked, folders)
    rows = read_yaml_rows(file) if file.suffix.lower() in (".yaml", ".yml") else read_csv(file)
    given = data.get("scenes") or {}
    if not rows and not given:
        raise ConfigError(f"{file}: has no scenes; expected a row for each")
    if not isinstance(given, Mapping):
        return Gathered(data)  # the model says what is wrong with that
    run_methods = data.get("methods") or dict.fromkeys(DEFAULT_METHODS)
    scenes: dict[str, Any] = dict(given)
    places: dict[tuple[str, ...], str] = {}
    problems: list[tuple[str, str]] = []
    for row, name in _named(rows, set(given), problems):
        at: tuple[str, ...] = ("scenes", name)
        places[at] = places.get(at, row.place)
        try:
            scenes[name] = _scene(row, run_methods)
        except _BadCellError as error:
            problems.append((error.place, str(error)))
            continue
        places |= {(*at, *target_of(path)): place for path, place in row.places.items()}
    if problems:
        raise refused(file, problems)
    return Gathered({**data, "scenes": scenes}, file, places)


def check_files(settings: Config, gathered: Gathered) -> None:
    """Look for the files and folders that the rows of a collection name, such as recordings.

    Raises
    ------
    ConfigError
        When any isn't there: with line and column.
    """
    missing: list[tuple[tuple[str, ...], str]] = []
    for name, scene in settings.scenes.items():
        for option in type(scene).files:
            file = Path(getattr(scene, option))
            location = ("scenes", name, option)
            if not file.exists() and gathered.place_of(location):
                missing.append(
                    (location, f"{'.'.join(location)} is {str(file)!r}, which isn't there")
                )
    if missing:
        raise ConfigError("\n".join(gathered.said(missing, str(gathered.file))))


class _BadCellError(ValueError):
    """A cell that can't be what it is for."""

    def __init__(self, place: str, what: str) -> None:
        super().__init__(what)
        self.place = place


def _found(asked: str, folders: Sequence[Path]) -> Path:
    places = [Path(asked), *(folder / asked for folder in folders)]
    for place in places:
        if place.is_file():
            return place
    looked = " nor ".join(dict.fromkeys(str(place) for place in places))
    raise ConfigError(f"collection is {asked!r}; there is no file {looked}")


def _named(
    rows: Sequence[Row], taken: set[str], problems: list[tuple[str, str]]
) -> Iterator[tuple[Row, str]]:
    """Yield rows with their names; tell of names that can't be."""
    first: dict[str, str] = dict.fromkeys(taken, "the settings' scenes")
    for row in rows:
        name = row.values.get(("name",))
        place = row.places.get(("name",), row.place)
        if name is None:
            problems.append((place, "the scene has no name; give it one, such as bowl_1"))
        elif wrong := _unfit(str(name)):
            problems.append((place, wrong))
        elif str(name) in first:
            stands = first[str(name)]
            problems.append((place, f"the name {name} stands in {stands} as well; change one"))
        else:
            first[str(name)] = row.place
            yield row, str(name)


def _unfit(name: str) -> str | None:
    """Say why a name is none for a folder and a scene, if it isn't."""
    if len(name) > _LONGEST:
        return f"the name {name[:40]!r}... has {len(name)} characters; at most {_LONGEST} will do"
    if name in _WINDOWS:
        return (
            f"the name {name!r} can't be a folder's on Windows; expected another, such as {name}_1"
        )
    if _NAME.fullmatch(name):
        return None
    likely = re.sub(r"[^a-z0-9]+", "_", _in_ascii(name.lower())).strip("_")
    if not likely[:1].isalpha():
        likely = f"item_{likely}".rstrip("_")
    return (
        f"the name {name!r} is not fit for a folder; expected a lower-case letter, then such, "
        f"digits and _, as in {likely}. What else it is called can stand in a column about.number"
    )


def _instead(column: str) -> str:
    """Say where what a column is about belongs, since it is no setting of a scene."""
    if column in Config.model_fields:
        return f" {column} is the whole run's: it stands in the settings, not in this table."
    return f" What is only to be known of a scene goes into about.{column}."


def _in_ascii(text: str) -> str:
    """Write letters with marks as those who have none on their keys do: ue for ü, e for é."""
    for mark, letters in (("ä", "ae"), ("ö", "oe"), ("ü", "ue"), ("ß", "ss"), ("ø", "oe")):
        text = unicodedata.normalize("NFC", text).replace(mark, letters)
    return "".join(
        each for each in unicodedata.normalize("NFD", text) if not unicodedata.combining(each)
    )


def _scene(row: Row, run_methods: object) -> dict[str, Any]:
    """Return a scene's settings as the model takes them."""
    scene: dict[str, Any] = {}
    values = {path: value for path, value in row.values.items() if path != ("name",)}
    if ("methods",) in values:
        place = row.places.get(("methods",), row.place)
        scene["methods"] = _methods(values.pop(("methods",)), place)
    elif any(path[0] == "methods" for path in values):
        # options of methods alone choose none: all of the run's
        names = run_methods if isinstance(run_methods, Mapping) else {}
        scene["methods"] = {str(name): {} for name in names}
    kind = values.get(("kind",), values.get(("scene", "kind")))
    for path, value in values.items():
        _put(
            scene, target_of(path), _meant(row, path, value, kind), row.places.get(path, row.place)
        )
    return scene


def _meant(row: Row, path: Path_, value: object, kind: object) -> object:
    if not row.is_text:
        return value
    try:
        return meant(str(value), target_of(path), kind, comma=row.comma)
    except ValueError as error:
        place = row.places.get(path, row.place)
        raise _BadCellError(place, f"{'.'.join(path)}: {error}") from None


def _methods(value: object, place: str) -> object:
    """Return a scene's choice of methods: names, or sections as the run's settings have them."""
    if isinstance(value, str) and not value.startswith(("{", "[")):
        names = [name for name in _NAMES.split(value) if name]
        twice = [name for name, count in Counter(names).items() if count > 1]
        if twice:
            raise _BadCellError(place, f"methods: {twice[0]} stands twice; remove one")
        return {name: {} for name in names} or None
    found = meant(value, (), None) if isinstance(value, str) else value
    if isinstance(found, list):
        return {str(name): {} for name in found}
    if isinstance(found, Mapping):
        return {name: dict(section or {}) for name, section in found.items()}
    return found


def _put(tree: dict[str, Any], path: Path_, value: object, place: str) -> None:
    """Set a value in groups within groups."""
    *groups, last = path
    for group in groups:
        inner = tree.setdefault(group, {})
        if not isinstance(inner, dict):
            raise _BadCellError(
                place, f"{'.'.join(path)}: {group} is {inner!r} in this row, and no group"
            )
        tree = inner
    if isinstance(tree.get(last), dict) and isinstance(value, Mapping):
        tree[last] = {**value, **tree[last]}
    else:
        tree[last] = dict(value) if isinstance(value, Mapping) else value
