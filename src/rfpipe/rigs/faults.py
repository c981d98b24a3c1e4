"""Faults of a rig: what each is called, from which size on it matters, and what to do about it.

Calibration, capture and offline import estimate a fault from different pictures, and describe it
by the functions of this module. Sizes are relative: of the light, of the projector's white picture
for light of the room, and of the picture's norm for motion.

========= ======================================================================================
kind      change between pictures of one pattern
========= ======================================================================================
late      a picture shows the previous pattern
room      light is added, also where the pattern is dark
moved     the picture changes its shape
gain      all exposures of a bracket change by one factor, at random
flicker   exposures of a bracket change independently, the short ones most
unsteady  gain, or flicker, or drift: too few exposures or pictures show which
drift     all exposures change by one factor, slowly
========= ======================================================================================
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

Kind = Literal["late", "room", "moved", "gain", "flicker", "unsteady", "drift"]

GAIN_CHANGES = "gain changes from picture to picture"
RIG_MOVED = "the rig or the scene moved"
EMPTY_QUEUE = (
    "empty the camera's queue before each bracket, such as by single-frame triggers in place of a "
    "running stream; or, where the display is slow, wait longer for it (the projector's "
    "settle_seconds: step latency of `rfpipe calibrate` measures its delay)"
)
AUTOMATIC_OFF = (
    "switch automatic gain, exposure, brightness and white balance off, in the camera and in its "
    "driver"
)
WHOLE_PERIODS = (
    "take exposures of whole periods, multiples of 1/100 s where mains have 50 Hz, of 1/120 s "
    "where they have 60 Hz"
)
WARM_UP = "let the lamp warm up, half an hour or more"

SIGNIFICANCE = 6.0
"""Standard errors beyond which a change is more than noise. Over 100 clean simulated calibrations
and 60 captures the largest was 3.9 of gains and black pictures, 1.9 of room light, and 6.5 of the
ratios of exposures, which only matter beside a significant change of gain."""


class Limits(NamedTuple):
    """Relative changes that are accepted.

    Attributes
    ----------
    light : float
        Of the light that gain and lamp multiply.
    room : float
        Of the room's light, relative to the white picture's. It is in all pictures, and others are
        dim beside the white one.
    moved : float
        Of a picture's shape, beyond brightness and noise, relative to its norm.
    """

    light: float
    room: float
    moved: float


CALIBRATION = Limits(light=0.01, room=0.002, moved=0.05)
"""Of a calibration's looks. Half a pixel of motion makes 0.15 of the shape of their fields."""

CAPTURE = Limits(light=0.02, room=0.01, moved=0.02)
"""Of an acquisition. Half a pixel makes 1 of the shape of its fine random pattern, a lamp whose
light changes in parts of the image at most 0.002."""

OFFLINE = Limits(light=0.03, room=0.006, moved=0.05)
"""Of pictures that are taken elsewhere: shutters and lenses repeat their exposure within 2 %."""

NOTED = Limits(light=0.005, room=0.005, moved=0.02)
"""Of an acquisition: smaller changes aren't logged."""


class Fault(NamedTuple):
    """A fault of a rig.

    Attributes
    ----------
    kind : str
    size : float
        Relative change of light or picture.
    change : str
        What is wrong, such as "the room's light changes by 2.00% of ...".
    remedy : str
        What to do.
    """

    kind: Kind
    size: float
    change: str
    remedy: str

    @property
    def text(self) -> str:
        """Change and remedy, as the end of a sentence."""
        return f"{self.change}: {self.remedy}"

    @property
    def sentence(self) -> str:
        """Change and remedy, from a capital letter to a full stop."""
        return f"{self.text[0].upper()}{self.text[1:]}."

    def exceeds(self, limits: Limits) -> bool:
        """Test whether it is larger than accepted."""
        limit = {"room": limits.room, "moved": limits.moved}.get(self.kind, limits.light)
        return self.size > limit


def late_fault(share: float, sign: str = "") -> Fault:
    """Return the fault of frames of the picture before.

    Parameters
    ----------
    share : float
        Share of the pictures that have it.
    sign : str
        What shows it, such as "a longer exposure is darker".
    """
    change = "the camera's frames are of the picture before"
    return Fault("late", share, f"{change} ({sign})" if sign else change, EMPTY_QUEUE)


def room_fault(size: float, period: str) -> Fault:
    """Return the fault of room light that changes by `size` in a period such as "in 20 s"."""
    return Fault(
        "room",
        size,
        f"the room's light changes by {size:.2%} of the white picture's {period}",
        "darken the room, cover windows and screens, and switch lamps off",
    )


def moved_fault(size: float) -> Fault:
    """Return the fault of a picture that differs by `size` from an earlier one of its pattern."""
    return Fault(
        "moved",
        size,
        f"{RIG_MOVED}, as the picture of the same pattern differs by {size:.1%} from an earlier "
        "one, and not in brightness",
        "fix camera, projector and scene in place, and check the projector's cable and menu, as "
        "its picture may be mirrored, scaled, cut off or dark in a part",
    )


def gain_fault(size: float) -> Fault:
    """Return the fault of a gain that changes from picture to picture by `size`."""
    return Fault("gain", size, f"the camera's {GAIN_CHANGES}, by {size:.1%}", AUTOMATIC_OFF)


def flicker_fault(size: float, exposures: Sequence[float]) -> Fault:
    """Return the fault of a lamp whose flicker changes exposures (E,) by up to `size`."""
    at_50 = ", ".join(f"{each:g}" for each in whole_periods(exposures, 100))
    at_60 = ", ".join(f"{each:.3g}" for each in whole_periods(exposures, 120))
    return Fault(
        "flicker",
        size,
        f"the lamp flickers, so that exposures differ by up to {size:.1%}, the short ones most",
        f"take exposures of whole periods, as the camera's exposures: [{at_50}] where mains have "
        f"50 Hz, [{at_60}] where they have 60 Hz; or a lamp without flicker",
    )


def unsteady_fault(size: float) -> Fault:
    """Return the fault of light that changes by `size`, where one exposure can't say why."""
    return Fault(
        "unsteady",
        size,
        f"the camera's {GAIN_CHANGES}, or the lamp flickers, by {size:.1%}",
        f"first {AUTOMATIC_OFF}. If that changes nothing, {WHOLE_PERIODS}. A bracket of two "
        "exposures, a few times apart, shows which it is",
    )


def ends_fault(change: float) -> Fault:
    """Return the fault of light that changed by `change` from the first picture to the last."""
    return Fault(
        "unsteady",
        abs(change),
        f"the light changed by {change:+.1%} from the first picture to the last",
        f"where the lamp drifts, {WARM_UP}; where the camera's gain or exposure is automatic, "
        "switch that off",
    )


def drift_fault(change: float, duration: str) -> Fault:
    """Return the fault of a lamp whose light changed by `change` in a time such as "20 s"."""
    text = f"the lamp's light changed by {change:+.1%} in {duration}"
    return Fault("drift", abs(change), text, WARM_UP)


def whole_periods(exposures: Sequence[float], hertz: float) -> list[float]:
    """Return the multiples of a period that are next to exposures, ascending and all different."""
    periods: list[int] = []
    for exposure in sorted(exposures):
        least = periods[-1] + 1 if periods else 1
        periods.append(max(least, round(exposure * hertz)))
    return [number / hertz for number in periods]


def is_whole_period(exposure: float) -> bool:
    """Test whether an exposure has whole periods of flicker at 100 Hz and at 120 Hz."""
    return all(abs(exposure * hertz - round(exposure * hertz)) < 0.02 for hertz in (100, 120))
