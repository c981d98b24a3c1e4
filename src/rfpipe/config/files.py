"""Settings files: read, checked, every mistake in them said."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ConfigDict, ValidationError

from rfpipe.config.base import Location, Settings, located, setting, shown
from rfpipe.config.camera import CameraConfig
from rfpipe.config.devices import RigConfig
from rfpipe.config.model import DEFAULT_METHODS, Config
from rfpipe.config.reading import Collection, read_collection, read_yaml
from rfpipe.errors import ConfigError

_MOST_LINES = 30

_S = TypeVar("_S", bound=Settings)


def load_config(path: str | Path) -> Config:
    """Read the settings of a run from a YAML file; keys left out have their defaults.

    Raises
    ------
    ConfigError
        When the file can't be read or isn't YAML, and for every unknown key, wrong type and
        value out of range: with the file, the key, the value and what was expected.
    """
    return parse_config(read_yaml(path), str(path), [Path(path).parent])


def parse_config(data: object, source: str, folders: Sequence[Path] = ()) -> Config:
    """Check settings that are in memory, as YAML gives them; errors as `load_config`.

    Parameters
    ----------
    data
    source
        Where the settings came from, for messages.
    folders
        Where else to look for a collection than where rfpipe runs.
    """
    keys = _keys_of(RigConfig, data) if isinstance(data, Mapping) and is_rig(data) else []
    if any(key not in ("scene", "rig") for key in keys):  # these may be scenes or rigs, misspelt
        raise ConfigError(
            f"{source}: holds the settings of a rig ({', '.join(keys)}), for rfpipe aim, "
            "calibrate and serve, not of a run; a run's file is like config/config.yaml, and names "
            "a rig's file by rig_file or its server by capture.url"
        )
    collection = _collection(data, folders) if isinstance(data, Mapping) else None
    if collection is None:
        return _parsed(Config, data, source)
    assert isinstance(data, Mapping)
    scenes = {**(data.get("scenes") or {}), **collection.scenes}
    return _parsed(Config, {**data, "scenes": scenes}, source, collection)


def _collection(data: Mapping[str, Any], folders: Sequence[Path]) -> Collection | None:
    """Return the collection that settings name, or None."""
    name = data.get("collection")
    if not isinstance(name, str) or not name or not isinstance(data.get("scenes") or {}, Mapping):
        return None  # the model says what is wrong
    places = [Path(name), *(folder / name for folder in folders)]
    file = next(filter(Path.is_file, places), None)
    if file is None:
        looked = " nor ".join(dict.fromkeys(map(str, places)))
        raise ConfigError(f"collection is {name!r}; there is no file {looked}")
    methods = data.get("methods")
    known = methods if isinstance(methods, Mapping) else dict.fromkeys(DEFAULT_METHODS)
    collection = read_collection(file, known)
    for scene in set(data.get("scenes") or {}) & set(collection.scenes):
        place = f"{file}: {collection.places[scene]}"
        collection.problems.append(f"{place}: the settings have a scene {scene}, too")
    return collection


class _CameraSection(Settings):
    """The camera's section of a run's settings; others are not checked."""

    model_config = ConfigDict(extra="ignore")

    camera: CameraConfig | None = setting(None, "Numbers of the camera; null for exact radiance.")


def load_camera(path: str | Path) -> CameraConfig | None:
    """Read the camera's numbers from the settings of a run, whatever its other sections.

    Parameters
    ----------
    path : path
        A YAML file with a section ``camera``, alone or among others.

    Returns
    -------
    CameraConfig or None
        None where the section is null, which stands for pictures of exact radiance.

    Raises
    ------
    ConfigError
        When the file can't be read, has no section ``camera``, or that has mistakes: with the
        file, the key, the value and what was expected.
    """
    data = read_yaml(path)
    if isinstance(data, Mapping) and "camera" not in data:
        raise ConfigError(
            f"{path}: has no section camera, only {', '.join(map(str, data))}; expected 'camera:' "
            f"and below it the camera's numbers, such as {', '.join(CameraConfig.model_fields)}"
        )
    return _parsed(_CameraSection, data, str(path)).camera


def load_rig_config(path: str | Path) -> RigConfig:
    """Read the settings of a rig; errors as `load_config`."""
    return parse_rig_config(read_yaml(path), str(path))


def parse_rig_config(data: object, source: str) -> RigConfig:
    """Check settings of a rig that are already in memory; errors as `load_config`."""
    if isinstance(data, Mapping) and not is_rig(data) and (keys := _keys_of(Config, data)):
        named = data.get("rig_file")
        like = f"this run's is {named}" if named else "one is like config/rig.yaml"
        raise ConfigError(
            f"{source}: holds the settings of a run ({', '.join(keys)}), not of a rig. Give the "
            f"rig's file: {like}"
        )
    return _parsed(RigConfig, data, source)


def is_rig(data: object) -> bool:
    """Whether settings are those of a rig rather than of a run, by the keys that they have."""
    if not isinstance(data, Mapping):
        return False
    of_rig = sum(key in RigConfig.model_fields for key in data)
    return of_rig > sum(key in Config.model_fields for key in data)


def _keys_of(kind: type[Settings], data: Mapping[Any, Any]) -> list[str]:
    """Return the keys that belong to settings of one kind only: rig or run."""
    second_kind = RigConfig if kind is Config else Config
    shared = second_kind.model_fields
    return [key for key in data if key in kind.model_fields and key not in shared]


def _parsed(kind: type[_S], data: object, source: str, collection: Collection | None = None) -> _S:
    """Check settings, and say every mistake in them."""
    if not isinstance(data, Mapping):
        raise ConfigError(
            f"{source}: holds {shown(data)}; expected 'key: value' lines with the keys "
            f"{', '.join(kind.model_fields)}"
        )
    lines = [] if collection is None else collection.problems
    try:
        settings = kind.model_validate(dict(data))
        if not lines:
            return settings
    except ValidationError as error:
        mistakes = located(error) + _hidden_by_names(kind, data, error)
        found = [(_scene_of(*each, collection), each[1]) for each in mistakes]
        for scene, line in found:
            place = (
                f"{collection.file}: {collection.places[scene]}" if collection and scene else source
            )
            lines.append(f"{place}: {line}")
        # what is looked for after this, in the table's other scenes
        scenes = data.get("scenes", {})
        others = {name: scenes[name] for name in scenes if name not in dict(found)}
        if collection and 0 < len(others) < len(scenes) and len(lines) < _MOST_LINES:
            _parsed(kind, {**data, "scenes": others}, source, collection)
    if len(lines) > _MOST_LINES:
        lines[_MOST_LINES:] = [f"... and {len(lines) - _MOST_LINES} more mistakes"]
    raise ConfigError("\n".join(dict.fromkeys(lines)))


def _hidden_by_names(
    kind: type[Settings], data: Mapping[Any, Any], error: ValidationError
) -> list[tuple[Location, str]]:
    """Mistakes that are checked only once the scenes' names are valid.

    The settings are checked again with valid names in place of the others.
    """
    problems = error.errors(include_url=False)
    invalid = {it["loc"][1] for it in problems if it["loc"][::2] == ("scenes", "[key]")}
    if not invalid or kind is not Config:
        return []
    valid = {name: f"renamed_scene_{number}" for number, name in enumerate(sorted(invalid))}
    scenes = {valid.get(name, name): scene for name, scene in data["scenes"].items()}
    try:
        kind.model_validate({**data, "scenes": scenes})
    except ValidationError as renamed:
        mistakes = located(renamed)
    else:
        return []
    original = {renamed: str(name) for name, renamed in valid.items()}
    return [
        (
            tuple(original.get(str(part), part) for part in location),
            re.sub(r"renamed_scene_\d+", lambda match: original[match[0]], line),
        )
        for location, line in mistakes
    ]


def _scene_of(location: Location, line: str, collection: Collection | None) -> str:
    """Return the scene of a table that a mistake is about; empty for none."""
    scene = str(location[1]) if location[:1] == ("scenes",) and len(location) > 1 else ""
    if not location and (named := re.search(r"scenes\.(\w+)", line)):
        scene = named[1]
    return scene if collection is not None and scene in collection.places else ""
