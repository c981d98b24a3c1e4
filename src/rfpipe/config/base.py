"""What the settings' models share: strictness, messages, and sections by name."""

from __future__ import annotations

import difflib
import re
import shlex
import textwrap
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Self, TypeVar, get_args, get_origin

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
from pydantic_core import InitErrorDetails, PydanticCustomError

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

Location = tuple[str | int, ...]

_BETWEEN = re.compile(r"(?<=\d)\s*x\s*(?=\d)|[;,\s]+")


_WORDS = {"ge": "at least", "gt": "above", "le": "at most", "lt": "below"}


def setting(default: Any, about: str, **limits: Any) -> Any:
    """Return a field, whose description tells its limits, too."""
    bounds = [f"{_WORDS[name]} {value:g}" for name, value in limits.items() if name in _WORDS]
    if {"ge", "le"} <= limits.keys():
        bounds = [f"{limits['ge']:,} to {limits['le']:,}"]
    what, between, rest = about.removesuffix(".").partition(";")
    return Field(default, description=f"{', '.join([what, *bounds])}{between}{rest}.", **limits)


def group_of(model: type[Settings]) -> Any:
    """Return a field that is a group of settings, said by its model's docstring; all defaults."""
    return Field(default_factory=model, description=str(model.__doc__).partition("\n")[0])


def check_command(command: str | None) -> str | None:
    """Return a command as it is; raise ValueError where it is none."""
    try:
        if command is not None and not shlex.split(command):
            raise ValueError("no program is named")
    except ValueError as error:  # such as a quotation mark without its other one
        raise ValueError(
            f"should be a program and its arguments, quoted as for a shell, or null: {error}"
        ) from None
    return command


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values can't change, numbers are finite.

    Attributes
    ----------
    without_effect_on_frames : frozenset of str
        Options of a device that may change after a calibration, such as time-outs.
    """

    without_effect_on_frames: ClassVar[frozenset[str]] = frozenset()

    # validators are built when they are first used: a process needs those of few models
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _as_meant(cls, value: object, info: ValidationInfo) -> object:
        """Refuse a truth value as a number; take a cell of a table, a text, as what it lists."""
        if not isinstance(value, bool | str) or info.field_name is None:
            return value
        kinds = _types(cls.model_fields[info.field_name].annotation)
        if isinstance(value, bool):
            # pydantic would read true as 1, and YAML reads a bare yes or on as true
            if bool not in kinds:
                raise ValueError("should not be true or false")
        elif tuple in kinds:
            return [_number(part) for part in _BETWEEN.split(value) if part]
        elif str not in kinds:
            return _number(value)
        return value

    @model_validator(mode="wrap")
    @classmethod
    def _explained(cls, data: Any, handler: ModelWrapValidatorHandler[Self]) -> Self:
        """Say each mistake here, where the setting's meaning is known."""
        try:
            return handler(data)
        except ValidationError as error:
            problems = [mistake(cls._message(it), *it["loc"], of=it) for it in _innermost(error)]
            raise ValidationError.from_exception_data(cls.__name__, problems) from None

    @classmethod
    def _message(cls, problem: Mapping[str, Any]) -> str:
        """Say one of pydantic's problems: the value, what was expected, what the setting means."""
        kind, location = problem["type"], problem["loc"]
        text = str(problem["msg"]).removeprefix("Value error, ").removesuffix(" after validation")
        if kind == "extra_forbidden":
            close = difflib.get_close_matches(str(location[-1]), cls.model_fields, n=1)
            meant = f"did you mean {close[0]}? " if close else ""
            return f" is unknown; {meant}Known here: {', '.join(cls.model_fields)}."
        if kind == "setting" or (kind == "value_error" and not text.startswith("should")):
            return text  # a rule between settings names them and their values itself
        field = cls.model_fields.get(str(location[0])) if location else None
        meaning = f" ({field.description})" if field and field.description else ""
        if kind == "missing":
            return f" is missing; add it.{meaning}"
        if kind in ("model_type", "dict_type"):
            text = "should be a group of 'key: value' settings"
        # without "Input", "String", "Tuple"
        return f" is {shown(problem['input'])}; it {text[text.find('should') :]}.{meaning}"


def mistake(message: str, *location: str | int, of: Any = None) -> InitErrorDetails:
    """Return a mistake in settings, whose message is said as it is."""
    kind = PydanticCustomError("setting", "{message}", {"message": message})
    return InitErrorDetails(type=kind, loc=location, input=of and of["input"])


def located(error: ValidationError) -> list[tuple[Location, str]]:
    """Return the location and a line for each mistake in settings."""
    lines = []
    for problem in _innermost(error):
        where = tuple(part for part in problem["loc"] if part != "[key]")
        text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in where)
        message = Settings._message(problem)
        between = ": " if text and not message.startswith(" ") else ""
        lines.append((where, f"{text.removeprefix('.')}{between}{message}"))
    return lines


def explained(error: ValidationError) -> list[str]:
    """Return a line for each mistake in settings."""
    return [line for _, line in located(error)]


def shown(value: object) -> str:
    """Show a value as YAML would, short enough for a message."""
    if value is None:
        return "null"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return textwrap.shorten(text, 80, placeholder=" ...")


def _innermost(error: ValidationError) -> list[Any]:
    """Return pydantic's problems; a list with a wrong item is reported as wrong itself, too."""
    problems = error.errors(include_url=False)
    outer = {problem["loc"][:n] for problem in problems for n in range(len(problem["loc"]))}
    return [problem for problem in problems if problem["loc"] not in outer]


def _types(annotation: object) -> set[object]:
    """Return the types that an annotation consists of."""
    inner = (_types(argument) for argument in get_args(annotation))
    return {annotation, get_origin(annotation)}.union(*inner)


def _number(text: str) -> int | float | str:
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


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
        name = section.get(cls.key)
        if not isinstance(name, str):  # a mistake in the name alone
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
        raise PydanticCustomError("setting", "{message}", {"message": str(error)}) from None


class MethodSettings(Described):
    """What the settings' section of every method has."""

    group: ClassVar[str] = plugins.METHODS
    key: ClassVar[str] = "method"

    method: Text | None = setting(
        None,
        "The method, or a class of your own, module:Class or file.py:Class; else the section's.",
    )


def _named(sections: object) -> object:
    """Put the name of each method's section into it, where it says none."""
    if isinstance(sections, list | tuple):
        expected = ", ".join(f"{name}: {{}}" for name in sections)
        raise ValueError(f"should be a section for each method, as in {{{expected}}}")
    if not isinstance(sections, Mapping):
        return sections
    filled = {name: {} if section is None else section for name, section in sections.items()}
    return merged({name: {"method": name} for name in sections}, filled)


def _options_by_name(schema: dict[str, Any]) -> None:
    """Say in a JSON schema which options a section has that is called by a method's name."""
    schema["properties"] = {
        name: {"propertyNames": {"enum": [*MethodSettings.model_of(name).model_fields]}}
        for name in plugins.names(plugins.METHODS)
    }


MethodSections = Annotated[
    dict[SectionName, SerializeAsAny[MethodSettings]],
    BeforeValidator(_named),
    Field(min_length=1, json_schema_extra=_options_by_name),
]
"""Methods by the names of their sections."""


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Put settings over others, group by group; what is no group takes the other's place."""
    both = {
        name: merged(base[name], value)
        for name, value in over.items()
        if isinstance(base.get(name), Mapping) and isinstance(value, Mapping)
    }
    return {**base, **over, **both}
