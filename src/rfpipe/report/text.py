"""Numbers and sizes as text."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from rfpipe.config import Config, SceneSettings

__all__ = ["DASH", "TIMES", "fixed", "number", "percent", "ray_size", "size", "wishes", "words"]

DASH = "\N{EN DASH}"
TIMES = "\N{MULTIPLICATION SIGN}"
_JOINT = "\N{NO-BREAK SPACE}"


def number(value: Any, form: str = ",.0f", scale: float = 1.0) -> str:
    """Return a number, scaled, as text; a dash for none."""
    if value is None or not math.isfinite(value):
        return DASH
    return format(value * scale, form)


def percent(value: Any) -> str:
    """Return a fraction in per cent, to a hundredth below ten; a dash for none."""
    small = value is not None and value < 0.1
    return number(value, ".2f" if small else ".0f", 100)


def fixed(digits: int, scale: float = 1.0) -> Callable[[Any], str]:
    """Return `number` with so many digits behind the point, of numbers times `scale`."""
    return partial(number, form=f",.{digits}f", scale=scale)


def words(name: Any) -> str:
    """Return a name of the settings or of a table as words."""
    return str(name).replace("_", " ")


def wishes(config: Config) -> str:
    """Say what the methods were asked for: the option by which each trades patterns."""
    asked: dict[str, None] = {}
    for scene in config.scenes:
        for name, section in config.methods_of(scene).items():
            method = section.subject
            if method.trades:
                value = section.options()[method.trades]
                own = config.scenes[scene].methods is not None
                of_scene = f" ({words(scene)})" if own else ""
                asked[f"{words(name)} {words(method.trades)} {value:g}{of_scene}"] = None
    return ", ".join(asked) or "no particular accuracy"


def size(*lengths: int) -> str:
    """Return the size of an image: height, width."""
    return f"{_JOINT}{TIMES}{_JOINT}".join(map(str, lengths))


def ray_size(scene: SceneSettings) -> str:
    """Return the size of a projector's rays: rows and columns of views before the image's.

    With that of the camera's rays, where it differs.
    """
    if not scene.is_coaxial:
        return f"{size(*scene.ray_shape)} to {size(*scene.camera_ray_shape)}"
    views = scene.view_grid if scene.is_light_field else ()
    return size(*views, *scene.ray_shape[-2:])
