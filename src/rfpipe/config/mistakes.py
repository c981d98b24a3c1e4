"""Mistakes in settings: pydantic's problems as one line each, with location, value and remedy.

A mistake has one of two kinds. The message of ``ABOUT_SETTING`` continues the setting's location
(``camera.bits`` "is 99; it should be at most 16."); that of ``RULE`` is a sentence about several
settings.
"""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Literal

from pydantic import ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import InitErrorDetails, PydanticCustomError

from rfpipe.errors import InputError, UnsuitableValueError
from rfpipe.text import did_you_mean

Location = tuple[str | int, ...]
"""Names and indices from the outermost section to a setting."""

MistakeKind = Literal["about_setting", "rule_between_settings"]

ABOUT_SETTING: MistakeKind = "about_setting"
RULE: MistakeKind = "rule_between_settings"

_EXPECTATIONS = {
    "greater_than": "be above {gt}",
    "greater_than_equal": "be at least {ge}",
    "less_than": "be below {lt}",
    "less_than_equal": "be at most {le}",
    "multiple_of": "be a multiple of {multiple_of}",
    "finite_number": "be a finite number",
    "int_type": "be an integer",
    "int_parsing": "be an integer",
    "int_from_float": "be an integer",
    "float_type": "be a number",
    "float_parsing": "be a number",
    "bool_type": "be true or false",
    "bool_parsing": "be true or false",
    "string_type": "be a text",
    "string_too_short": "have at least {min_length} characters",
    "string_pattern_mismatch": "match the pattern {pattern}",
    "literal_error": "be {expected}",
    "list_type": "be a list",
    "tuple_type": "be a list",
    "too_short": "have at least {min_length} entries",
    "too_long": "have at most {max_length} entries",
    "model_type": "be a group of 'key: value' settings",
    "dict_type": "be a group of 'key: value' settings",
}
"""Completions of "it should ..." by the type of pydantic's problem, with its context."""


def mistake(
    message: str, *location: str | int, kind: MistakeKind = RULE, value: object = None
) -> InitErrorDetails:
    """Return a mistake at a location, for `ValidationError.from_exception_data`."""
    error = PydanticCustomError(kind, "{message}", {"message": message})
    return InitErrorDetails(type=error, loc=location, input=value)


def mistake_error(
    message: str, *location: str | int, kind: MistakeKind = RULE, value: object = None
) -> ValidationError:
    """Return a ValidationError with one mistake at a location, to be raised in a validator."""
    problem = mistake(message, *location, kind=kind, value=value)
    return ValidationError.from_exception_data("settings", [problem])


def relocated(problem: Mapping[str, Any], fields: Mapping[str, FieldInfo], *outer: str) -> Any:
    """Return one of pydantic's problems as a mistake in a section at a location `outer`."""
    kind, message = describe(problem, fields)
    return mistake(message, *outer, *problem["loc"], kind=kind, value=problem["input"])


def describe(
    problem: Mapping[str, Any], fields: Mapping[str, FieldInfo]
) -> tuple[MistakeKind, str]:
    """Return kind and message of one of pydantic's problems in a model with these fields."""
    type_, location = problem["type"], problem["loc"]
    context = problem.get("ctx", {})
    if type_ in (ABOUT_SETTING, RULE):
        return type_, str(problem["msg"])
    if type_ == "extra_forbidden":
        remedy = f"{did_you_mean(str(location[-1]), fields)} Known here: {', '.join(fields)}."
        return ABOUT_SETTING, f"is unknown; {remedy.strip()}"
    cause = context.get("error")
    if type_ == "value_error" and not isinstance(cause, UnsuitableValueError):
        return RULE, str(cause)
    field = fields.get(str(location[0])) if location else None
    meaning = f" ({field.description})" if field and field.description else ""
    if type_ == "missing":
        return ABOUT_SETTING, f"is missing; add it.{meaning}"
    if isinstance(cause, UnsuitableValueError):
        expected = f"it should {cause}"
    elif type_ in _EXPECTATIONS:
        limits = {name: _without_zero_decimals(limit) for name, limit in context.items()}
        expected = f"it should {_EXPECTATIONS[type_].format(**limits)}"
    else:
        expected = str(problem["msg"])
    return ABOUT_SETTING, f"is {yaml_text(problem['input'])}; {expected}.{meaning}"


def _without_zero_decimals(value: object) -> object:
    return int(value) if isinstance(value, float) and value.is_integer() else value


def located_mistakes(error: ValidationError) -> list[tuple[Location, str]]:
    """Return the location of each mistake and a line that begins with it."""
    lines = []
    for problem in innermost(error):
        location = tuple(part for part in problem["loc"] if part != "[key]")
        name = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
        kind, message = describe(problem, {})
        separator = ": " if name and kind == RULE else " " if name else ""
        lines.append((location, f"{name.removeprefix('.')}{separator}{message}"))
    return lines


def mistake_lines(error: ValidationError) -> list[str]:
    """Return a line for each mistake in settings."""
    return [line for _, line in located_mistakes(error)]


def innermost(error: ValidationError) -> list[Any]:
    """Return pydantic's problems without those of lists and groups around another problem."""
    problems = error.errors(include_url=False)
    outer = {problem["loc"][:n] for problem in problems for n in range(len(problem["loc"]))}
    return [problem for problem in problems if problem["loc"] not in outer]


@contextmanager
def input_errors_as_mistakes() -> Iterator[None]:
    """Turn an InputError in a validator into a mistake in the settings."""
    try:
        yield
    except InputError as error:
        raise PydanticCustomError(RULE, "{message}", {"message": str(error)}) from None


def yaml_text(value: object) -> str:
    """Return a value about as YAML writes it, in at most 80 characters."""
    if value is None:
        return "null"
    text = str(value).lower() if isinstance(value, bool) else repr(value)
    return textwrap.shorten(text, 80, placeholder=" ...")
