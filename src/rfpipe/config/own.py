"""Settings of a run that are others for a scene, or for the scenes before one rig."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

OWN_TO_SCENES = frozenset(
    {
        "camera",
        "capture",
        "merge",
        "normalization",
        "offline",
        "resources",
        "seed",
        "storage",
        "verification",
    }
)
"""Groups of a run's settings that a scene may have of its own."""

_OF_THE_RUN = {
    ("capture", "rig"): "a whole run is simulated, or it isn't",
    ("resources", "jobs"): "a whole run has jobs of one kind",
    ("resources", "captures"): "a whole run has its rig in one place",
    ("storage", "keep_at"): "a whole run is kept in one place",
}


def check_own(settings: Mapping[str, Any]) -> None:
    """Raise ValidationError for settings that only a whole run can have."""
    for name in settings:
        if name not in OWN_TO_SCENES:
            known = ", ".join(sorted(OWN_TO_SCENES))
            raise _wrong(f"can't be set for a scene; expected settings among {known}", name)
    for (group, option), why in _OF_THE_RUN.items():
        found = settings.get(group)
        if isinstance(found, Mapping) and option in found:
            raise _wrong(f"can't be set for a scene: {why}", group, option)


def _wrong(message: str, *location: str) -> ValidationError:
    problem = PydanticCustomError("value_error", "{message}", {"message": message})
    details = InitErrorDetails(type=problem, loc=location, input=None)
    return ValidationError.from_exception_data("settings", [details])


def merged(base: Mapping[str, Any], over: Mapping[str, Any]) -> dict[str, Any]:
    """Put settings over others, group by group; what is no group takes the other's place."""
    found = dict(base)
    for name, value in over.items():
        below = found.get(name)
        both = isinstance(below, Mapping) and isinstance(value, Mapping)
        found[name] = merged(below, value) if both and below is not None else value
    return found
