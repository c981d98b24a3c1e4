"""Reading and checking of settings files; all mistakes are reported at once."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ConfigDict, Field, ValidationError

from rfpipe.config.base import Settings
from rfpipe.config.camera import CameraConfig
from rfpipe.config.devices import RigConfig
from rfpipe.config.mistakes import Location, located_mistakes, yaml_text
from rfpipe.config.model import DEFAULT_METHODS, Config
from rfpipe.config.reading import SceneTable, read_collection, read_yaml
from rfpipe.errors import ConfigError

_MOST_LINES = 30

_S = TypeVar("_S", bound=Settings)


def load_config(path: str | Path) -> Config:
    """Read the settings of a run from a YAML file; missing keys have their defaults.

    Raises
    ------
    ConfigError
        When the file can't be read or isn't YAML, a key is unknown, or a value has a wrong type or
        is out of range. The message names file, key, value and expectation of each mistake.
    """
    return parse_config(read_yaml(path), str(path), [Path(path).parent])


def parse_config(data: object, source: str, folders: Sequence[Path] = ()) -> Config:
    """Check settings in the form that a YAML parser returns; raises as `load_config`.

    Parameters
    ----------
    data : object
        The settings as plain data.
    source : str
        Origin of the settings, for messages.
    folders : sequence of Path
        Folders to search for a collection, after the current one.
    """
    keys = _keys_of(RigConfig, data) if isinstance(data, Mapping) and is_rig(data) else []
    if any(key not in ("scene", "rig") for key in keys):  # these may be misspelt scenes or rigs
        raise ConfigError(
            f"{source}: contains the settings of a rig ({', '.join(keys)}), for rfpipe aim, "
            "calibrate and serve, not those of a run. The settings of a run are like "
            "config/config.yaml; rig_file names the file of its rig, capture.url its server"
        )
    collection = _collection(data, folders) if isinstance(data, Mapping) else None
    if collection is None:
        return _parsed(Config, data, source)
    assert isinstance(data, Mapping)
    scenes = {**(data.get("scenes") or {}), **collection.scenes}
    return _parsed(Config, {**data, "scenes": scenes}, source, collection)


def _collection(data: Mapping[str, Any], folders: Sequence[Path]) -> SceneTable | None:
    """Read the collection that the settings name; None without one."""
    name = data.get("collection")
    if not isinstance(name, str) or not name or not isinstance(data.get("scenes") or {}, Mapping):
        return None  # the model reports the mistake
    paths = [Path(name), *(folder / name for folder in folders)]
    file = next(filter(Path.is_file, paths), None)
    if file is None:
        searched = " nor ".join(dict.fromkeys(map(str, paths)))
        raise ConfigError(f"collection is {name!r}; there is no file {searched}")
    methods = data.get("methods")
    run_methods = methods if isinstance(methods, Mapping) else dict.fromkeys(DEFAULT_METHODS)
    collection = read_collection(file, run_methods)
    for scene in set(data.get("scenes") or {}) & set(collection.scenes):
        place = f"{file}: {collection.places[scene]}"
        collection.problems.append(
            f"{place}: the settings file has a scene {scene}, too; rename one of the two"
        )
    return collection


class _CameraSection(Settings):
    """Section ``camera`` of a run's settings; other sections are not checked."""

    model_config = ConfigDict(extra="ignore")

    camera: CameraConfig | None = Field(
        None, description="Parameters of the camera; null: exact radiance."
    )


def load_camera(path: str | Path) -> CameraConfig | None:
    """Read the section ``camera`` of a run's settings, without checking other sections.

    Parameters
    ----------
    path : path
        A YAML file with a section ``camera``, alone or among others.

    Returns
    -------
    CameraConfig or None
        None if the section is null, for pictures of exact radiance.

    Raises
    ------
    ConfigError
        When the file can't be read, or the section ``camera`` is missing or has mistakes. The
        message names file, key, value and expectation.
    """
    data = read_yaml(path)
    if isinstance(data, Mapping) and "camera" not in data:
        raise ConfigError(
            f"{path}: has no section camera, only {', '.join(map(str, data))}; expected 'camera:' "
            f"and below it parameters such as {', '.join(CameraConfig.model_fields)}"
        )
    return _parsed(_CameraSection, data, str(path)).camera


def load_rig_config(path: str | Path) -> RigConfig:
    """Read the settings of a rig; raises as `load_config`."""
    return parse_rig_config(read_yaml(path), str(path))


def parse_rig_config(data: object, source: str) -> RigConfig:
    """Check the settings of a rig in the form of plain data; raises as `load_config`."""
    if isinstance(data, Mapping) and not is_rig(data) and (keys := _keys_of(Config, data)):
        rig_file = data.get("rig_file")
        example = f"this run's is {rig_file}" if rig_file else "one is like config/rig.yaml"
        raise ConfigError(
            f"{source}: contains the settings of a run ({', '.join(keys)}), not those of a rig. "
            f"Give the rig's file: {example}"
        )
    return _parsed(RigConfig, data, source)


def is_rig(data: object) -> bool:
    """Return True if the keys of settings are those of a rig rather than of a run."""
    if not isinstance(data, Mapping):
        return False
    rig_keys = sum(key in RigConfig.model_fields for key in data)
    return rig_keys > sum(key in Config.model_fields for key in data)


def _keys_of(kind: type[Settings], data: Mapping[Any, Any]) -> list[str]:
    """Return the keys that one kind of settings, rig or run, has and the other hasn't."""
    shared = (RigConfig if kind is Config else Config).model_fields
    return [key for key in data if key in kind.model_fields and key not in shared]


def _parsed(kind: type[_S], data: object, source: str, collection: SceneTable | None = None) -> _S:
    """Check settings; ConfigError with a line for each mistake, at most `_MOST_LINES`."""
    if not isinstance(data, Mapping):
        raise ConfigError(
            f"{source}: contains {yaml_text(data)}; expected 'key: value' lines with the keys "
            f"{', '.join(kind.model_fields)}"
        )
    lines = [] if collection is None else list(collection.problems)
    try:
        settings = kind.model_validate(dict(data))
        if not lines:
            return settings
    except ValidationError as error:
        lines += _lines_of(error, kind, data, source, collection)
    if len(lines) > _MOST_LINES:
        lines[_MOST_LINES:] = [f"... and {len(lines) - _MOST_LINES} more mistakes"]
    raise ConfigError("\n".join(dict.fromkeys(lines)))


def _lines_of(
    error: ValidationError,
    kind: type[Settings],
    data: Mapping[Any, Any],
    source: str,
    collection: SceneTable | None,
) -> list[str]:
    """Return a line for each mistake, including those that the first check didn't reach.

    pydantic runs rules between settings only once each setting is valid, so the scenes of a
    collection that had no mistake so far are checked again without the scenes that had one.
    """
    lines = []
    wrong_scenes = set()
    for location, line in located_mistakes(error) + _hidden_by_names(kind, data, error):
        scene = _scene_of(location, collection)
        wrong_scenes.add(scene)
        in_table = collection is not None and scene
        place = f"{collection.file}: {collection.places[scene]}" if in_table else source  # type: ignore[union-attr]
        lines.append(f"{place}: {line}")
    scenes = data.get("scenes", {})
    unchecked = {name: scenes[name] for name in scenes if name not in wrong_scenes}
    if collection and 0 < len(unchecked) < len(scenes) and len(lines) < _MOST_LINES:
        remaining = {**data, "scenes": unchecked}
        try:
            kind.model_validate(remaining)
        except ValidationError as next_error:
            lines += _lines_of(next_error, kind, remaining, source, collection)
    return lines


def _hidden_by_names(
    kind: type[Settings], data: Mapping[Any, Any], error: ValidationError
) -> list[tuple[Location, str]]:
    """Return the mistakes that invalid names of scenes hide from pydantic.

    The settings are checked again with placeholders for these names.
    """
    problems = error.errors(include_url=False)
    invalid = {it["loc"][1] for it in problems if it["loc"][::2] == ("scenes", "[key]")}
    if not invalid or kind is not Config:
        return []
    placeholders = {name: f"renamed_scene_{number}" for number, name in enumerate(sorted(invalid))}
    scenes = {placeholders.get(name, name): scene for name, scene in data["scenes"].items()}
    try:
        kind.model_validate({**data, "scenes": scenes})
    except ValidationError as renamed:
        mistakes = located_mistakes(renamed)
    else:
        return []
    names = {placeholder: str(name) for name, placeholder in placeholders.items()}
    return [
        (
            tuple(names.get(str(part), part) for part in location),
            re.sub(r"renamed_scene_\d+", lambda match: names[match[0]], line),
        )
        for location, line in mistakes
    ]


def _scene_of(location: Location, collection: SceneTable | None) -> str:
    """Return the scene of a collection to which a mistake belongs; empty for none."""
    scene = str(location[1]) if location[:1] == ("scenes",) and len(location) > 1 else ""
    return scene if collection is not None and scene in collection.places else ""
