"""Numbers, sizes and verdicts as text."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

from rfpipe.config import SceneSettings
from rfpipe.rigs.calibrated import STANDINGS, VERDICTS_KEY
from rfpipe.text import percent as decimals

ERROR = (
    "Error: norm of the difference, relative to the norm of the picture or half that of a typical "
    "picture, whichever is larger"
)
"""Definition of the error of a relit picture, for captions."""

DASH = "\N{EN DASH}"

STANDING_COLOURS = {
    "good": "#2f7d36",
    "NOT GOOD": "#c62828",
    "can't tell": "#d99a00",
    "NOT MEASURED": "#7b1f1f",
}
"""Colours of the verdicts, by their texts."""


def number(value: Any, form: str = ",.0f", scale: float = 1.0) -> str:
    """Return a scaled number as text; a dash for None and NaN."""
    if value is None or not math.isfinite(value):
        return DASH
    return format(value * scale, form)


def rounded_percent(value: Any) -> str:
    """Return a fraction in per cent, with two decimals or more below 10 %; a dash for None."""
    is_small = value is not None and value < 0.1
    return decimals(value) if is_small and math.isfinite(value) else number(value, ".0f", 100)


def indirect_percent(value: Any) -> str:
    """Return an error of indirect light in per cent; "none" for a scene without indirect light."""
    return "none" if value == 0 else rounded_percent(value)


def fixed(digits: int) -> Callable[[Any], str]:
    """Return a formatter of numbers with this number of decimals."""
    return partial(number, form=f",.{digits}f")


def rig_standing(rig: Mapping[str, Any]) -> str:
    """Return the worst verdict of a rig's calibration, or the kind of a rig without devices."""
    if rig.get("kind") != "devices":
        return str(rig.get("kind", DASH))
    verdicts = {step["standing"] for step in (rig.get(VERDICTS_KEY) or {}).values()}
    return next((STANDINGS[it] for it in reversed(STANDINGS) if it in verdicts), "no calibration")


def setting_text(value: Any) -> str:
    """Return a setting's value as in YAML."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def words(name: Any) -> str:
    """Return a name from settings or tables as words."""
    return str(name).replace("_", " ")


def size(*lengths: int) -> str:
    """Return the size of an image: height, width."""
    return "\N{NO-BREAK SPACE}\N{MULTIPLICATION SIGN}\N{NO-BREAK SPACE}".join(map(str, lengths))


def ray_size(scene: SceneSettings) -> str:
    """Return the size of a projector's rays, views first, and of the camera's if it differs."""
    if not scene.is_coaxial:
        return f"{size(*scene.ray_shape)} to {size(*scene.camera_ray_shape)}"
    views = scene.view_grid if scene.is_light_field else ()
    return size(*views, *scene.ray_shape[-2:])
