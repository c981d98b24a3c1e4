"""What the settings' models share."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

__all__ = ["Extent", "MethodName", "Settings", "Tolerance", "each_once"]

MethodName = Literal[
    "brute_force", "compressive", "dual", "hadamard", "low_rank", "near_far", "symmetric"
]
Extent = Annotated[int, Field(ge=1, le=4096)]
Tolerance = Annotated[float, Field(gt=0, lt=1)]


class Settings(BaseModel):
    """Base of all settings: unknown keys are errors, values can't change, numbers are finite."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @field_validator("*", mode="before")
    @classmethod
    def _no_truth_value_as_number(cls, value: object, info: ValidationInfo) -> object:
        # pydantic would read true as 1, and YAML reads a bare yes or on as true
        name = info.field_name
        if isinstance(value, bool) and name and cls.model_fields[name].annotation is not bool:
            raise ValueError("should not be true or false")
        return value


def each_once(methods: tuple[MethodName, ...]) -> tuple[MethodName, ...]:
    """Return methods if none is named twice; else raise ValueError."""
    if len(set(methods)) < len(methods):
        raise ValueError("should name each method once")
    return methods
