"""What is wrong with settings: the key, its value, what was expected, and what the key means."""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, get_args

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from rfpipe.config.base import Described, Settings
from rfpipe.config.drivers import DeviceDriver
from rfpipe.errors import InputError

Location = tuple[str | int, ...]


def explained(kind: type[Settings], error: ValidationError, data: object) -> list[str]:
    """Say every mistake in settings, a line each; parameters as of `located`."""
    return [line for _, line in located(kind, error, data)]


def located(
    kind: type[Settings], error: ValidationError, data: object
) -> list[tuple[Location, str]]:
    """Say every mistake in settings, a line each, with the location of the setting.

    Parameters
    ----------
    kind : type of Settings
        The model that they were checked by.
    error : ValidationError
    data
        The settings.
    """
    problems = error.errors(include_url=False, include_context=False)
    # a list with a wrong item is reported as wrong itself, too: keep the innermost
    outer = {problem["loc"][:n] for problem in problems for n in range(len(problem["loc"]))}
    return [
        (problem["loc"], _explained(kind, problem, data))
        for problem in problems
        if problem["loc"] not in outer
    ]


def shown(value: object) -> str:
    """Show a value as YAML would, short enough for a message."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return textwrap.shorten(repr(value), 80, placeholder=" ...")


def _explained(kind: type[Settings], problem: Mapping[str, Any], data: object) -> str:
    """Say one of pydantic's problems as: key, value, what was expected, what the key means."""
    location: Location = tuple(part for part in problem["loc"] if part != "[key]")
    own = 2 * (location[:1] == ("rigs",)) or 3 * (location[2:3] == ("settings",))
    if 0 < own < len(location):
        # settings of the run under a rig or a scene: of them is known what is known of the run's
        said = _explained(
            kind, {**problem, "loc": location[own:]}, _within_of(data, location[:own])
        )
        return f"{_dotted(location[:own])}.{said}"
    key = _dotted(location)
    model, field = field_at(kind, location, data)
    if problem["type"] == "unknown_name":
        return f"{key}: {problem['msg']}"
    if problem["type"] == "extra_forbidden":
        return _unknown_key(location, model)
    meaning = f" ({key}: {field.description})" if field and field.description else ""
    if problem["type"] == "missing":
        return f"{key} is missing; add it.{meaning}"
    expected = problem["msg"].removeprefix("Value error, ").removesuffix(" after validation")
    if problem["type"] != "value_error":
        expected = expected[expected.find("should") :]  # without "Input", "String", "Tuple"
    if problem["type"] in ("model_type", "dict_type"):
        expected = "should be a group of 'key: value' settings"
    if problem["type"] == "value_error" and not expected.startswith("should"):
        # a rule between settings names them and their values itself
        return f"{key}: {expected}" if key else expected
    return f"{key} is {shown(problem['input'])}; it {expected}.{meaning}"


def _within_of(data: object, location: Location) -> object:
    for part in location:
        data = data.get(part) if isinstance(data, Mapping) else None
    return data


def _unknown_key(location: tuple[str | int, ...], model: type[BaseModel]) -> str:
    unknown = str(location[-1])
    known = list(model.model_fields)
    close = difflib.get_close_matches(unknown, known, n=1)
    suggestion = f"did you mean {close[0]}? " if close else ""
    return f"{_dotted(location)} is unknown; {suggestion}Known here: {', '.join(known)}."


def _dotted(location: Sequence[str | int]) -> str:
    """Join a location's parts: ("camera", "exposures", 0) is camera.exposures[0]."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def field_at(
    kind: type[Settings], location: Sequence[str | int], data: object
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Find the innermost model that a location passes through, and the last field in it."""
    model: type[BaseModel] = kind
    field: FieldInfo | None = None
    for part in location:
        section, data = data, data.get(part) if isinstance(data, Mapping) else None
        found = model.model_fields.get(str(part))
        if found is None:  # a section's name, a list's index or an unknown key
            model = _described(model, str(part), data)
            continue
        field = found
        # a section that says its name is of that name's model
        inner = _described(model_within(found) or model, "", data)
        model = _driven(model, str(part), section) or inner
    return model, field


def _described(model: type[BaseModel], name: str, section: object) -> type[BaseModel]:
    """Return the model that a section's name stands for, where it stands for one."""
    if not issubclass(model, Described):
        return model
    try:
        return model.model_of(model.name_in(section) or name)
    except InputError:
        return model


def _driven(model: type[BaseModel], name: str, section: object) -> type[BaseModel] | None:
    """Return the model of a driver's options, where a location is about those."""
    if not issubclass(model, DeviceDriver) or name != "options":
        return None
    given = section.get("driver") if isinstance(section, Mapping) else None
    try:
        return model.options_model(given or model.model_fields["driver"].default)
    except InputError:
        return None


def model_within(field: FieldInfo) -> type[BaseModel] | None:
    """Find the settings model inside a field's type, such as ``dict[str, SceneSettings]``."""
    return _within(field.annotation)


def _within(annotation: object) -> type[BaseModel] | None:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_within, get_args(annotation))), None)
