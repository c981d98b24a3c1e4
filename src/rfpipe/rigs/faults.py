"""Faults of a rig: names, limits, and remedies.

Calibration, capture and offline import detect a fault in different pictures, and describe it by the
functions of this module. Sizes are relative: to the light; for light of the room, to the
projector's white picture; for motion, to the picture's norm.

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

FaultKind = Literal["late", "room", "moved", "gain", "flicker", "unsteady", "drift"]

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
"""Standard errors beyond which a change is significant. In 100 simulated calibrations and 60
captures without faults, the largest changes were 3.9 standard errors for gains and black pictures,
1.9 for room light, and 6.5 for the ratios of exposures, which are used after a significant change
of gain only."""


class AcceptedChanges(NamedTuple):
    """Relative changes that are accepted.

    Attributes
    ----------
    light : float
        Change by gain or lamp, relative to the light.
    room : float
        Change of the room's light, relative to the white picture. The limit is small since room
        light is added to all pictures, and most are darker than the white one.
    moved : float
        Change of a picture's shape beyond brightness and noise, relative to its norm.
    """

    light: float
    room: float
    moved: float


CALIBRATION = AcceptedChanges(light=0.01, room=0.002, moved=0.05)
"""Limits for a calibration's check pictures. Motion by half a pixel changes them by 0.15."""

CAPTURE = AcceptedChanges(light=0.02, room=0.01, moved=0.02)
"""Limits for an acquisition. Motion by half a pixel changes its fine random pattern by 1; a lamp
whose light changes in parts of the image, by at most 0.002."""

OFFLINE = AcceptedChanges(light=0.03, room=0.006, moved=0.05)
"""Limits for offline pictures: shutters and lenses repeat their exposure within 2 %."""

NOTED = AcceptedChanges(light=0.005, room=0.005, moved=0.02)
"""Limits for an acquisition below which changes aren't logged."""


class Fault(NamedTuple):
    """A fault of a rig.

    Attributes
    ----------
    kind : str
    size : float
        Relative change of light or picture.
    change : str
        Description, such as "the room's light changes by 2.00% of ...".
    remedy : str
    """

    kind: FaultKind
    size: float
    change: str
    remedy: str

    @property
    def text(self) -> str:
        """Change and remedy, for the end of a sentence."""
        return f"{self.change}: {self.remedy}"

    @property
    def sentence(self) -> str:
        """Change and remedy as a complete sentence."""
        return f"{self.text[0].upper()}{self.text[1:]}."

    def exceeds(self, limits: AcceptedChanges) -> bool:
        """Test whether the fault is larger than accepted."""
        limit = {"room": limits.room, "moved": limits.moved}.get(self.kind, limits.light)
        return self.size > limit


def late_fault(share: float, sign: str = "") -> Fault:
    """Describe frames that show the previous picture.

    Parameters
    ----------
    share : float
        Share of the pictures with this fault.
    sign : str
        Evidence, such as "a longer exposure is darker".
    """
    change = "the camera's frames show the previous picture"
    return Fault("late", share, f"{change} ({sign})" if sign else change, EMPTY_QUEUE)


def room_fault(size: float, period: str) -> Fault:
    """Describe room light that changes by `size` in a period such as "in 20 s"."""
    return Fault(
        "room",
        size,
        f"the room's light changes by {size:.2%} of the white picture's {period}",
        "darken the room, cover windows and screens, and switch lamps off",
    )


def moved_fault(size: float) -> Fault:
    """Describe a picture that differs by `size` from an earlier one of the same pattern."""
    return Fault(
        "moved",
        size,
        f"{RIG_MOVED}: a picture differs by {size:.1%} from an earlier one of the same pattern, "
        "and not in brightness only",
        "fix camera, projector and scene in place, and check the projector's cable and menu, since "
        "its picture may be mirrored, scaled, cut off or partly dark",
    )


def gain_fault(size: float) -> Fault:
    """Describe a gain that changes from picture to picture by `size`."""
    return Fault("gain", size, f"the camera's {GAIN_CHANGES}, by {size:.1%}", AUTOMATIC_OFF)


def flicker_fault(size: float, exposures: Sequence[float]) -> Fault:
    """Describe a lamp whose flicker changes exposures (E,) by up to `size`."""
    at_50 = ", ".join(f"{seconds:g}" for seconds in whole_periods(exposures, 100))
    at_60 = ", ".join(f"{seconds:.3g}" for seconds in whole_periods(exposures, 120))
    return Fault(
        "flicker",
        size,
        f"the lamp flickers, so that exposures differ by up to {size:.1%}, the short ones most",
        f"take exposures of whole periods, as the camera's exposures: [{at_50}] where mains have "
        f"50 Hz, [{at_60}] where they have 60 Hz; or a lamp without flicker",
    )


def unsteady_fault(size: float) -> Fault:
    """Describe light that changes by `size`, where one exposure can't show the cause."""
    return Fault(
        "unsteady",
        size,
        f"the camera's {GAIN_CHANGES}, or the lamp flickers, by {size:.1%}",
        f"first {AUTOMATIC_OFF}. If that changes nothing, {WHOLE_PERIODS}. A bracket of two "
        "exposures, a few times apart, shows the cause",
    )


def ends_fault(change: float) -> Fault:
    """Describe light that changed by `change` from the first picture to the last."""
    return Fault(
        "unsteady",
        abs(change),
        f"the light changed by {change:+.1%} from the first picture to the last",
        f"where the lamp drifts, {WARM_UP}; where the camera's gain or exposure is automatic, "
        "switch that off",
    )


def drift_fault(change: float, duration: str) -> Fault:
    """Describe a lamp whose light changed by `change` in a time such as "20 s"."""
    text = f"the lamp's light changed by {change:+.1%} in {duration}"
    return Fault("drift", abs(change), text, WARM_UP)


def whole_periods(exposures: Sequence[float], hertz: float) -> list[float]:
    """Round exposures to multiples of the period 1 / `hertz`, ascending and all different."""
    periods: list[int] = []
    for exposure in sorted(exposures):
        least = periods[-1] + 1 if periods else 1
        periods.append(max(least, round(exposure * hertz)))
    return [number / hertz for number in periods]


def is_whole_period(exposure: float) -> bool:
    """Test whether an exposure is a multiple of the periods of flicker at 100 Hz and 120 Hz."""
    return all(abs(exposure * hertz - round(exposure * hertz)) < 0.02 for hertz in (100, 120))
