"""Base classes of settings: strict models, and sections whose model depends on a name in them."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Self, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    SerializeAsAny,
    ValidationError,
    ValidationInfo,
    field_validator,
    model_validator,
)

from rfpipe import plugins
from rfpipe.config.mistakes import innermost, input_errors_as_mistakes, relocated
from rfpipe.errors import InputError, UnsuitableValueError

Extent = Annotated[int, Field(ge=1, le=4096)]
Fraction = Annotated[float, Field(gt=0, lt=1)]
Gamma = Annotated[float, Field(gt=0, le=5)]
SectionName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Share = Annotated[float, Field(ge=0, lt=1)]
Text = Annotated[str, Field(min_length=1)]
PixelPoint = tuple[float, float]
Corners = Annotated[
    tuple[tuple[PixelPoint, PixelPoint, PixelPoint, PixelPoint], ...], Field(min_length=1)
]
"""Upper left, upper right, lower right and lower left corner (x, y) of each view, in pixels."""
ViewCount = Annotated[int, Field(ge=1, le=16)]

RESERVED_ON_WINDOWS = r"(con|prn|aux|nul|(com|lpt)[0-9])"
"""Pattern of the names that no file or folder can have on Windows."""

_SEPARATORS = re.compile(r"(?<=\d)\s*x\s*(?=\d)|[;,\s]+")
"""Separators of the numbers in a table's cell, such as ``8 x 8`` or ``1; 2``."""


def group_of(model: type[Settings]) -> Any:
    """Return a field for a group of settings, all at their defaults.

    Its description is the first line of the model's docstring.
    """
    return Field(default_factory=model, description=str(model.__doc__).partition("\n")[0])


def check_command(command: str | None) -> str | None:
    """Return a command unchanged.

    Raises
    ------
    UnsuitableValueError
        When it names no program or a quotation mark isn't closed.
    """
    try:
        if command is not None and not shlex.split(command):
            raise ValueError("no program is named")
    except ValueError as error:
        raise UnsuitableValueError(
            f"be a program and its arguments, quoted as for a shell, or null: {error}"
        ) from None
    return command


class Settings(BaseModel):
    """Base class of all settings: immutable, without unknown keys and infinite numbers.

    Attributes
    ----------
    without_effect_on_frames : frozenset of str
        Options of a device that may change after a calibration, such as time-outs.
    """

    without_effect_on_frames: ClassVar[frozenset[str]] = frozenset()

    # validators are built at their first use, since a process needs those of few models
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _parse_text(cls, value: object, info: ValidationInfo) -> object:
        """Reject true and false as numbers; split a table's cell into numbers."""
        if not isinstance(value, bool | str) or info.field_name is None:
            return value
        types = _types(cls.model_fields[info.field_name].annotation)
        if isinstance(value, bool):
            # pydantic would read true as 1, and YAML reads a bare yes or on as true
            if bool not in types:
                raise UnsuitableValueError("not be true or false")
        elif tuple in types:
            return [_number(part) for part in _SEPARATORS.split(value) if part]
        elif str not in types:
            return _number(value)
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _describe_mistakes(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Describe each mistake in the model whose fields explain the setting."""
        try:
            return handler(data)
        except ValidationError as error:
            mistakes = [relocated(problem, cls.model_fields) for problem in innermost(error)]
            raise ValidationError.from_exception_data(cls.__name__, mistakes) from None


def _types(annotation: object) -> set[object]:
    """Return the types of which an annotation consists."""
    inner = (_types(argument) for argument in get_args(annotation))
    return {annotation, get_origin(annotation)}.union(*inner)


def _number(text: str) -> int | float | str:
    for type_ in (int, float):
        try:
            return type_(text)
        except ValueError:
            continue
    return text


class PluginSettings(Settings):
    """A section with the name of a method or scene, checked by the options of that plug-in.

    A direct subclass of this class checks a section by the class ``Options`` of the plug-in whose
    name or path the section has.

    Attributes
    ----------
    group : str
        Group of entry points in which the name is looked up. The class there has an attribute
        ``Options``, a model derived from this one.
    key : str
        Setting that holds the name.
    """

    group: ClassVar[str]
    key: ClassVar[str]

    @classmethod
    def model_of(cls, name: str) -> type[Self]:
        """Return the model of the options of a plug-in.

        Raises
        ------
        InputError
            When there is no plug-in of this name, or it has no such model.
        """
        model = getattr(plugins.find(cls.group, name), "Options", None)
        if not (isinstance(model, type) and issubclass(model, cls)):
            raise InputError(f"{name!r} has no Options derived from {cls.__name__}")
        return model

    @model_validator(mode="wrap")
    @classmethod
    def _check_by_plugin(cls, section: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if PluginSettings not in cls.__bases__ or not isinstance(section, Mapping):
            return handler(section)
        name = section.get(cls.key)
        if not isinstance(name, str):  # report the mistake in the name, not unknown options
            return handler({key: section[key] for key in section if key == cls.key})
        with input_errors_as_mistakes():
            model = cls.model_of(name)
        return model.model_validate(section)

    @property
    def plugin(self) -> Any:
        """Class of the method or scene."""
        return plugins.find(self.group, getattr(self, self.key))

    def options(self) -> dict[str, Any]:
        """Return all settings except the name, as plain data."""
        return self.model_dump(mode="json", exclude={self.key})


class MethodSettings(PluginSettings):
    """Settings that the sections of all methods have."""

    group: ClassVar[str] = plugins.METHODS
    key: ClassVar[str] = "method"

    method: Text | None = Field(
        None,
        description="The method, or a class of your own as module:Class or file.py:Class; by "
        "default, the name of the section.",
    )

    @property
    def error_target(self) -> float | None:
        """Target of the estimated error; None for a method without one."""
        return None

    @property
    def prior_path(self) -> str | None:
        """Folder of the transport with which an acquisition begins; None without one."""
        return None


def _with_names(sections: object) -> object:
    """Add to each method's section the section's name, unless it names a method."""
    if isinstance(sections, list | tuple):
        example = ", ".join(f"{name}: {{}}" for name in sections)
        raise UnsuitableValueError(f"be a section for each method, as in {{{example}}}")
    if not isinstance(sections, Mapping):
        return sections
    filled = {name: {} if section is None else section for name, section in sections.items()}
    return merge_settings({name: {"method": name} for name in sections}, filled)


def _add_options_to_schema(schema: dict[str, Any]) -> None:
    """List in a JSON schema the options of each section that is named after a method."""
    schema["properties"] = {
        name: {"propertyNames": {"enum": [*MethodSettings.model_of(name).model_fields]}}
        for name in plugins.names(plugins.METHODS)
    }


MethodSections = Annotated[
    dict[SectionName, SerializeAsAny[MethodSettings]],
    BeforeValidator(_with_names),
    Field(min_length=1, json_schema_extra=_add_options_to_schema),
]
"""Methods by the names of their sections."""


def merge_settings(base: Mapping[str, Any], overrides: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` with other values from `overrides`, merging groups recursively."""
    groups = {
        name: merge_settings(base[name], value)
        for name, value in overrides.items()
        if isinstance(base.get(name), Mapping) and isinstance(value, Mapping)
    }
    return {**base, **overrides, **groups}
