"""Numbers and sizes as text."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rfpipe.config import Config

import math
from typing import Any

from rfpipe.config import SceneConfig

__all__ = ["DASH", "TIMES", "number", "percent", "ray_size", "size"]

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


def size(*lengths: int) -> str:
    """Return the size of an image: height, width."""
    return f"{_JOINT}{TIMES}{_JOINT}".join(map(str, lengths))


def ray_size(scene: SceneConfig) -> str:
    """Return the size of a scene's ray domain: rows and columns of views before the image's."""
    return size(*(scene.views or ()), *scene.shape)


def wishes(config: Config) -> str:
    """Say what the methods were asked for: the option by which each trades patterns."""
    asked: dict[str, None] = {}
    for scene in config.scenes:
        for name, section in config.methods_of(scene).items():
            method = section.subject(name)
            if method.trades:
                value = section.options()[method.trades]
                words = f"{method.trades.replace('_', ' ')} {value:g}"
                own = config.scenes[scene].methods is not None
                asked[f"{name} {words}" + (f" ({scene.replace('_', ' ')})" if own else "")] = None
    return ", ".join(asked) or "no particular accuracy"
