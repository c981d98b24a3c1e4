"""Sections of settings that describe themselves, checked by the models of what they set up."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Any, TypeVar, cast

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from rfpipe.config.base import Described, MethodSettings
from rfpipe.errors import InputError

__all__ = [
    "check_methods_of_scenes",
    "check_pages",
    "method_sections",
    "methods_of_scene",
    "no_list",
    "parse_described",
    "parse_sections",
]

_D = TypeVar("_D", bound=Described)
_T = TypeVar("_T")

Overrides = Mapping[str, Mapping[str, Any] | None] | None
"""A scene's methods, with the options that differ from the run's; None for all as they are."""


def parse_described(kind: type[_D], name: str | None, section: object) -> _D:
    """Check the settings of one section.

    Parameters
    ----------
    kind : type of Described
    name : str or None
        The name that counts where the section itself says none.
    section : mapping or None
        None has no settings, and is all defaults.

    Raises
    ------
    ValidationError
        When they are wrong, or nothing goes by that name.
    """
    if isinstance(section, kind):
        return section
    named = kind.name_in(section) or name
    if named is None:
        return kind.model_validate(section)  # says that the name is missing
    try:
        model = kind.model_of(named)
    except InputError as error:
        problem = PydanticCustomError("unknown_name", "{message}", {"message": str(error)})
        details = InitErrorDetails(type=problem, loc=(), input=named)
        raise ValidationError.from_exception_data(kind.key, [details]) from None
    return model.model_validate({} if section is None else section)


def parse_sections(sections: Mapping[str, Any], parse: Callable[[str, Any], _T]) -> dict[str, _T]:
    """Check sections by name; all that is wrong in any of them is said, with its place.

    Raises
    ------
    ValidationError
    """
    found: dict[str, _T] = {}
    problems: list[InitErrorDetails] = []
    for name, section in sections.items():
        try:
            found[name] = parse(name, section)
        except ValidationError as error:
            problems += [_placed(problem, name) for problem in error.errors(include_url=False)]
    if problems:
        raise ValidationError.from_exception_data("settings", problems)
    return found


def _placed(problem: Any, name: str) -> InitErrorDetails:
    """Put a problem one level deeper, under a section's name."""
    location = (name, *problem["loc"])
    kind = problem["type"]
    if kind in ("unknown_name", "value_error"):
        text = problem["msg"].removeprefix("Value error, ")
        own = PydanticCustomError(cast(Any, kind), "{message}", {"message": text})
        return InitErrorDetails(type=own, loc=location, input=problem["input"])
    context = problem.get("ctx", {})
    return InitErrorDetails(type=kind, loc=location, input=problem["input"], ctx=context)


def method_sections(methods: Any) -> dict[str, MethodSettings]:
    """Check the methods of a run: a section each, by the method's name.

    Raises
    ------
    ValidationError, ValueError
    """
    if not isinstance(no_list(methods), Mapping):
        raise ValueError("should be a group of sections, one for each method")
    return parse_sections(methods, _method_section)


def no_list(methods: object) -> object:
    """Return methods as they are; raise ValueError for a list, as they stood once."""
    if isinstance(methods, list | tuple):
        sections = ", ".join(f"{name}: {{}}" for name in methods)
        raise ValueError(f"should be a section for each method, as in {{{sections}}}")
    return methods


def methods_of_scene(
    methods: Mapping[str, MethodSettings], own: Overrides
) -> dict[str, MethodSettings]:
    """Return the methods of a scene, with their options.

    Parameters
    ----------
    methods : mapping of str to MethodSettings
        Those of the run.
    own : mapping or None
        The scene's own.
    """
    if own is None:
        return dict(methods)
    run = {name: section.model_dump(exclude_unset=True) for name, section in methods.items()}
    return method_sections({name: {**run.get(name, {}), **(own[name] or {})} for name in own})


def check_methods_of_scenes(
    methods: Mapping[str, MethodSettings], scenes: Mapping[str, Overrides]
) -> None:
    """Raise ValidationError where a scene's methods are wrong, with all such places."""

    def of_scene(_name: str, own: Overrides) -> object:
        return parse_sections({"methods": own}, lambda _, it: methods_of_scene(methods, it))

    parse_sections({"scenes": scenes}, lambda _, all_of_them: parse_sections(all_of_them, of_scene))


def check_pages(acquisitions: Iterable[tuple[str, str]]) -> None:
    """Raise ValueError where two acquisitions, scene and method, would share a page's name."""
    first: dict[str, tuple[str, str]] = {}
    for scene, method in acquisitions:
        page = f"{scene}_{method}"
        other, by = first.setdefault(page, (scene, method))
        if other != scene:
            raise ValueError(
                f"scenes.{scene} should be called otherwise, or its method: by {method} its page "
                f"would be {page}, as that of {other} by {by} is"
            )


def _method_section(name: str, section: object) -> MethodSettings:
    return parse_described(MethodSettings, name, section)
