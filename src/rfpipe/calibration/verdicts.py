"""Verdicts on a rig: what each number may be, and what to do where it isn't."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.calibrated import STANDINGS

Standing = Literal["good", "poor", "unknown", "failed"]
Facts = Mapping[str, Any]


class Verdict(NamedTuple):
    """Whether a step's measurement is good enough.

    Attributes
    ----------
    standing : {"good", "poor", "unknown", "failed"}
        unknown: the noise is larger than what is judged. failed: there is no measurement.
    text : str
        The numbers, the reason and the remedy.
    """

    standing: Standing
    text: str

    def __str__(self) -> str:
        """Return both as a person reads them."""
        return f"{STANDINGS[self.standing]}. {self.text}"


@dataclass(frozen=True)
class Findings:
    """Result of a step.

    Attributes
    ----------
    verdict : Verdict
    facts : mapping
        Plain data: numbers with their standard errors.
    arrays : mapping of str to ndarray
        What the rig, later steps and the report's pictures need.
    """

    verdict: Verdict
    facts: Facts = field(default_factory=dict)
    arrays: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @classmethod
    def of(
        cls, step: str, facts: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]
    ) -> Findings:
        """Judge what a step measured."""
        plain = {
            name: value.item() if isinstance(value, np.generic) else value
            for name, value in facts.items()
        }
        return cls(verdict_of(step, plain), plain, arrays)

    def __getitem__(self, name: str) -> Any:
        """Return the array or the fact of a name."""
        return self.arrays[name] if name in self.arrays else self.facts[name]


# A row: step, standing and, but for the sentence of a good step, the fact with its limit, a number
# or another fact. A fact that is missing is not judged. A note is added to whatever the verdict is.
_TABLE = """
latency good: A picture is seen {delay_ms:.0f} ms after it was drawn, in all of {trials} trials.
latency poor unsettled_seconds > 0: Even {unsettled_seconds:g} s after a picture was drawn, the
    camera didn't see it wholly. Does the lamp flicker, or change with the picture (dynamic
    contrast, eco mode)? Switch that off, and calibrate again.
latency poor short_seconds > 0: A picture is seen {delay_ms:.0f} ms after it was drawn, but the
    projector's driver waits for {settle_seconds:g} s: frames are taken of the picture before. Set
    projector.options.settle_seconds to {proposed_settle_seconds:g}, or let a `show` of your own
    wait as long, and calibrate again.
steadiness good: Gain, lamp and room are steady: {lit_pictures} check pictures of a pattern and its
    complement agree within {range:.2%}.
steadiness unknown is_seen < 1: The projector's pattern is not seen; the step scene says why.
scene good: The projector lights {lit_share:.0%} of the picture; white would reach
    {brighter_level:.2g} times full scale at the longest exposure. Stripes of {stripes_pixels}
    projector pixels keep {focus_contrast:.0%} of their contrast.
scene poor black_saturated_share > 0.01: The all-off picture itself saturates
    {black_saturated_share:.0%} of the camera's pixels at the shortest exposure, {shortest_s:.3g} s:
    darken the room, or the projector is not black when it is off.
scene poor overexposed_share > 0.01: {saturated_share:.1%} of the pixels that the projector lights
    are saturated even at the shortest exposure, {shortest_s:.3g} s. Take shorter exposures, as
    sensor.exposures: {proposed_exposures_s}, close the aperture, or dim the projector.
scene poor brighter_level < 0.1: Too dark: at the longest exposure, {longest_s:.3g} s, white reaches
    {brighter_level:.1%} of full scale where it is bright; {limit:.0%} or more are wanted. Take
    longer exposures, or open the aperture.
scene poor is_stripeless > 0: No stripes of the projector are seen, at {longest_s:.3g} s at most. Is
    the lamp on, the lens cap off, does the camera see what the projector lights, are both in focus?
    Then take much longer exposures, or open the aperture.
scene poor is_other_order > 0: The colours of the camera's mosaic lie in another order than
    sensor.bayer, {bayer}, says: {bayer_evidence}. Set sensor.bayer to {bayer_orders}, and calibrate
    again.
scene note longer_times > 4: Dim: with sensor.exposures: {proposed_exposures_s},
    {longer_times:,.0f} times as long, dark parts have {less_noise:.1f} times less noise, and
    methods take fewer patterns or end at a smaller error.
scene note bearable_s < wanted_s: The all-off picture's light bears exposures up to {bearable_s:.2g}
    s; darken the room for longer ones.
scene note edges_left > 0: It leaves the camera's view at the {edges} edge.
dark good: Black level {black_level_counts:.2f} counts; {hot_photosites} hot photosites left out.
dark poor room_change > 1: The room's light changes by {room_change_share:.1%} of the camera's range
    in {room_seconds:.2g} s: darken the room, cover windows and screens, and switch lamps off.
dark poor headroom_deviations < 4: The black level, {black_level_counts:.1f} counts, is less than
    four times the noise ({noise_counts:.2f}) above zero: darkness is cut off and biased. Raise the
    camera's black level.
dark poor hot_share > 0.001: {hot_share:.2%} of the photosites are hot, more than {limit:.1%}: cool
    the camera or use shorter exposures.
dark poor filled_share > 0.05: The all-off picture isn't dark: at {longest_s:.3g} s it takes
    {filled_share:.0%} of the camera's range; exposures up to {bearable_s:.2g} s would bear it. With
    the lens cap on, run rfpipe calibrate with --step dark --again. If it stays, it is dark current:
    cool the camera. If not, black out the room, or lower the projector's brightness.
linearity good: {kind}: exposures agree within {deviation:.2%} beyond noise, {tolerance:.1%}
    allowed.
linearity unknown compared_levels < 1: Exposures could not be compared: it takes two or more, a few
    times apart, of light between black and saturated.
linearity poor deviation > tolerance: Not linear: exposures of the same light differ by up to
    {worst_deviation:.1%}, and no power law surely describes them. Switch the camera's gamma off.
    Is the light steady, are gain and exposure not automatic, and are the exposure times true?
light good: {usable_codes} steps of light; half the light is code {code_of_half_light:.0f}; the lamp
    drifted by {drift:+.2%}.
light poor over_noise < 30: Too dark: full light is {over_noise:.0f} times a pixel's noise where it
    shows at all; {limit:.0f} times or more are wanted. Take the exposures that the step scene
    proposes, or open the aperture.
light poor drift_beyond_noise > tolerance: The light changed by {drift:+.2%} while the codes were
    shown, more than {tolerance:.1%}: let the lamp warm up, and calibrate again.
light poor falls_at_code > 0: Light falls at code {falls_at_code}: switch off the projector's
    dynamic contrast and colour modes.
light poor usable_codes < 64: Only {usable_codes} codes differ: reset brightness and contrast.
transfer good: Known well enough for the merge: {numbers}.
transfer poor misfit > 0.1: The variance misses that of photons by {misfit:.0%}; {numbers}. Is the
    camera linear, its gamma and noise reduction off, the light steady?
transfer unknown known_within > 0.1: Too few pairs to know the noise within {limit:.0%}: {numbers}.
    Take more levels (calibrate.levels).
correspondence good: {valid_share:.0%} of the camera's pixels are decoded, with a noise of
    {median_error_pixels:.3f} projector pixels.
correspondence poor valid_pixels < 100: Only {valid_pixels} camera pixels see the projector's
    stripes. Check focus, that the camera sees what the projector lights, and the exposures; or make
    the stripes wider than {period_pixels} pixels a period.
correspondence poor decoded_of_lit < 0.7: Only {decoded_of_lit:.0%} of the camera's pixels that the
    projector lights are decoded; {limit:.0%} are wanted. They are saturated, too dark or out of
    focus: mend exposures and focus first.
correspondence poor median_error_pixels > 0.1: {valid_share:.0%} of the camera's pixels are decoded,
    but their noise is {median_error_pixels:.2f} projector pixels, above {limit}: use longer
    exposures.
rays good: {pixels_a_ray:.1f} camera pixels a ray, a leak of {leak:.2%}; the map fits within
    {map_rms_pixels:.2f} projector pixels a camera pixel, its own error is {map_error_pixels:.3f}.
    The picture is blurred by {blur_pixels:.2f} camera pixels. {unseen_rays} rays are not seen, and
    stay dark.
rays poor unseen_share > 0.02: {unseen_rays:,} of {count:,} rays are not seen ({unseen_share:.0%});
    {limit:.0%} are allowed. Turn the camera or its zoom until all of the projector's picture is in
    its view, or light less of it.
rays poor mixed > 1: Rays are mixed: {leak:.1%} of other rays' light leaks into rays, and noise
    grows up to {largest_noise:.1f} times. The picture is blurred by {blur_pixels:.2f} camera pixels
    (standard deviation): focus camera and projector, or close the aperture. There are
    {pixels_a_ray:.1f} camera pixels a ray; 4 or more are wanted: use larger rays, or a longer lens.
rays poor map_error_pixels > 0.1: The map from camera to projector is known to
    {map_error_pixels:.2f} projector pixels only, above {limit}: it is no smooth one, or blur drowns
    the stripes. Is the rig coaxial, and in focus?
symmetry good: Good enough for symmetric photography.
symmetry poor least_error > tolerance: Not good enough for symmetric photography; dual photography
    doesn't need symmetry.
symmetry unknown most_error > tolerance: The noise can't tell: use more patterns, or longer
    exposures.
symmetry note error > -1: Asymmetry alone makes errors of {error_range} in relit pictures,
    {tolerance:.1%} accepted.
symmetry note drift > 0.01: The lamp's light changed by {drift:.1%}, which is divided out.
symmetry note least_error > tolerance: Align the devices' centres, and focus both; clean and shade
    the lens, and cover what is bright beside the scene, against flare; close the aperture against
    vignetting.
"""


def with_error(value: float, error: float, number: str) -> str:
    """Return a number with its standard error, or a bound where the error is the larger one.

    `number` is the format of both, as in "{:.3g} electrons".
    """
    if error < abs(value):
        return f"{number.format(value)} +- {number.format(error)}"
    return f"at most {number.format(abs(value) + 2 * error)}"


def verdict_of(step: str, facts: Facts) -> Verdict:
    """Judge the facts of a step by the table's rows."""
    said: dict[str, list[tuple[str, float]]] = {"poor": [], "unknown": [], "good": [], "note": []}
    for row in re.split(r"\n(?=\S)", _TABLE.strip()):
        head, _, text = row.partition(": ")
        name, standing, *rule = head.split()
        if name != step:
            continue
        limit = 0.0
        if rule:
            fact, sign, bound = rule
            value, limit = facts.get(fact), facts[bound] if bound in facts else float(bound)
            if value is None or not (value > limit if sign == ">" else value < limit):
                continue
        said[standing].append((" ".join(text.split()), limit))
    result: Standing = "poor" if said["poor"] else "unknown" if said["unknown"] else "good"
    sentences = said[result] + said["note"]
    return Verdict(result, " ".join(t.format_map({**facts, "limit": x}) for t, x in sentences))
