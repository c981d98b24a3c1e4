"""What the settings' models share."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    SerializeAsAny,
    ValidationInfo,
    field_validator,
    model_validator,
)
from pydantic_core import PydanticCustomError

from rfpipe import plugins
from rfpipe.errors import InputError

_T = TypeVar("_T")

Extent = Annotated[int, Field(ge=1, le=4096)]
Fraction = Annotated[float, Field(gt=0, lt=1)]
Gamma = Annotated[float, Field(gt=0, le=5)]
SectionName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*$")]
Share = Annotated[float, Field(ge=0, lt=1)]
Text = Annotated[str, Field(min_length=1)]
Point = tuple[float, float]
Corners = Annotated[tuple[tuple[Point, Point, Point, Point], ...], Field(min_length=1)]
"""Upper left, upper right, lower right and lower left corner (x, y) of each view, in pixels."""
ViewCount = Annotated[int, Field(ge=1, le=16)]


def check_command(command: str | None) -> str | None:
    """Return a command as it is; raise ValueError where it is none."""
    if command is None:
        return None
    try:
        words = shlex.split(command)
    except ValueError as error:  # a quotation mark without its other one
        raise ValueError(
            f"should be a program and its arguments, quoted as for a shell: {error}"
        ) from None
    if not words:
        raise ValueError("should name a program, or be null")
    return command


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values can't change, numbers are finite."""

    # validators are built when they are first used: a process needs those of few models
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_as_number(cls, value: object, info: ValidationInfo) -> object:
        # pydantic would read true as 1, and YAML reads a bare yes or on as true
        name = info.field_name
        if isinstance(value, bool) and name and not _may_be_true(cls.model_fields[name].annotation):
            raise ValueError("should not be true or false")
        return value


def _may_be_true(annotation: Any) -> bool:
    """Tell whether a field takes true and false."""
    return annotation is bool or bool in get_args(annotation)


def group_of(model: type[Settings]) -> Any:
    """Return a field that is a group of settings, said by its model's docstring; all defaults."""
    return Field(default_factory=model, description=str(model.__doc__).partition("\n")[0])


class Described(Settings):
    """Settings by name whose model belongs to the subject that they set up, and lies beside it.

    A class derived directly from this one checks a section by the model of the section's name.

    Attributes
    ----------
    group : str
        The group of entry points among which a name is looked up; the subject has an attribute
        ``Options``, its model, derived from this one.
    key : str
        The setting that holds the name.
    """

    group: ClassVar[str]
    key: ClassVar[str]

    @classmethod
    def name_in(cls, section: object) -> str | None:
        """Return the name in a section, or None."""
        name = section.get(cls.key) if isinstance(section, Mapping) else None
        return name if isinstance(name, str) else None

    @classmethod
    def model_of(cls, name: str) -> type[Self]:
        """Return the model that belongs to a name.

        Raises
        ------
        InputError
            When nothing goes by that name, or it has no such model.
        """
        model = getattr(plugins.find(cls.group, name), "Options", None)
        if not (isinstance(model, type) and issubclass(model, cls)):
            raise InputError(f"{name!r} has no Options derived from {cls.__name__}")
        return model

    @model_validator(mode="wrap")
    @classmethod
    def _of_its_model(cls, section: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        if Described not in cls.__bases__ or not isinstance(section, Mapping):
            return handler(section)
        name = cls.name_in(section)
        if name is None:  # a mistake in the name alone
            return handler({key: section[key] for key in section if key == cls.key})
        return known(lambda: cls.model_of(name)).model_validate(section)

    @property
    def subject(self) -> Any:
        """The method or kind of scene that the settings are about."""
        return plugins.find(self.group, getattr(self, self.key))

    def options(self) -> dict[str, Any]:
        """Return all settings but the name, as plain data."""
        return self.model_dump(mode="json", exclude={self.key})


def known(find: Callable[[], _T]) -> _T:
    """Return the result of `find`; its InputError becomes a mistake in the settings."""
    try:
        return find()
    except InputError as error:
        raise PydanticCustomError("unknown_name", "{message}", {"message": str(error)}) from None


class MethodSettings(Described):
    """What the settings' section of every method has."""

    group: ClassVar[str] = plugins.METHODS
    key: ClassVar[str] = "method"

    method: Text | None = Field(
        None,
        description="The method's name, or a class of your own as module:Class or file.py:Class; "
        "by default the section's name.",
    )


def _named(sections: object) -> object:
    """Put the name of each method's section into it, where it says none."""
    if isinstance(sections, list | tuple):
        expected = ", ".join(f"{name}: {{}}" for name in sections)
        raise ValueError(f"should be a section for each method, as in {{{expected}}}")
    if not isinstance(sections, Mapping):
        return sections
    return {
        name: {"method": name, **(section or {})}
        if section is None or isinstance(section, Mapping)
        else section
        for name, section in sections.items()
    }


MethodSections = Annotated[
    dict[SectionName, SerializeAsAny[MethodSettings]],
    BeforeValidator(_named),
    Field(min_length=1),
]
"""Methods by the names of their sections."""
