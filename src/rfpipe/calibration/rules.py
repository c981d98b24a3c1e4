"""Rules by which calibration steps are judged: limits, messages and remedies."""

from __future__ import annotations

from typing import Literal, NamedTuple


class Rule(NamedTuple):
    """A sentence of a step's verdict, and the condition under which it applies.

    Attributes
    ----------
    step : str
    standing : {"good", "poor", "unknown", "note"}
        Standing that the rule gives to the step. A "good" rule applies where no "poor" or "unknown"
        one does; a "note" is added to the sentences of any standing.
    text : str
        Format string over the step's facts and ``limit``.
    fact : str
        Number that is compared; "" for a rule without a condition. The rule doesn't apply where the
        fact is missing or None.
    above, below : float or str, optional
        The rule applies where the fact is above or below this limit: a number, or the name of
        another fact.
    """

    step: str
    standing: Literal["good", "poor", "unknown", "note"]
    text: str
    fact: str = ""
    above: float | str | None = None
    below: float | str | None = None


RULES: tuple[Rule, ...] = (
    Rule(
        "latency",
        "good",
        "The camera receives a new picture {delay_ms:.0f} ms after it was drawn, in all of "
        "{trials} trials.",
    ),
    Rule(
        "latency",
        "poor",
        "{unsettled_seconds:g} s after a picture was drawn, the camera still doesn't receive "
        "it completely. Check whether the lamp flickers or changes with the picture (dynamic "
        "contrast, eco mode), switch that off, and calibrate again.",
        "unsettled_seconds",
        above=0,
    ),
    Rule(
        "latency",
        "poor",
        "The camera receives a new picture {delay_ms:.0f} ms after it was drawn, but the "
        "projector's driver waits for {settle_seconds:g} s only, so that frames show the "
        "previous picture. Set projector.options.settle_seconds to "
        "{proposed_settle_seconds:g}, or let the `show` of your own driver wait as long, and "
        "calibrate again.",
        "short_seconds",
        above=0,
    ),
    Rule(
        "steadiness",
        "good",
        "Gain, lamp and room are steady: {lit_pictures} check pictures of a pattern and its "
        "complement agree within {range:.2%}.",
    ),
    Rule(
        "steadiness",
        "unknown",
        "The camera doesn't see the projector's pattern; the step scene names the reason.",
        "is_seen",
        below=1,
    ),
    Rule(
        "scene",
        "good",
        "The projector lights {lit_share:.0%} of the picture; white would reach "
        "{brighter_level:.2g} times full scale at the longest exposure. Stripes of "
        "{stripes_pixels} projector pixels keep {focus_contrast:.0%} of their contrast.",
    ),
    Rule(
        "scene",
        "poor",
        "The all-off picture saturates {black_saturated_share:.0%} of the camera's pixels "
        "even at the shortest exposure, {shortest_s:.3g} s. Darken the room, and check that "
        "the projector is black when it is off.",
        "black_saturated_share",
        above=0.01,
    ),
    Rule(
        "scene",
        "poor",
        "{saturated_share:.1%} of the pixels that the projector lights are saturated even at "
        "the shortest exposure, {shortest_s:.3g} s. Take shorter exposures, as "
        "sensor.exposures: {proposed_exposures_s}, close the aperture, or dim the projector.",
        "overexposed_share",
        above=0.01,
    ),
    Rule(
        "scene",
        "poor",
        "Too dark: at the longest exposure, {longest_s:.3g} s, white reaches "
        "{brighter_level:.1%} of full scale in the bright parts; {limit:.0%} or more are "
        "required. Take longer exposures, or open the aperture.",
        "brighter_level",
        below=0.1,
    ),
    Rule(
        "scene",
        "poor",
        "The camera sees no stripes of the projector, at exposures of up to {longest_s:.3g} "
        "s. Check that the lamp is on and the lens cap off, that the camera sees the part of "
        "the scene that the projector lights, and that both are in focus. Then take much "
        "longer exposures, or open the aperture.",
        "is_stripeless",
        above=0,
    ),
    Rule(
        "scene",
        "poor",
        "The colours of the camera's mosaic are not in the order of the setting sensor.bayer,"
        " {bayer}: {bayer_evidence}. Set sensor.bayer to {bayer_orders}, and calibrate again.",
        "is_other_order",
        above=0,
    ),
    Rule(
        "scene",
        "note",
        "Dim: with sensor.exposures: {proposed_exposures_s}, {longer_times:,.0f} times as "
        "long, dark parts have {less_noise:.1f} times less noise, and methods take fewer "
        "patterns or reach a smaller error.",
        "longer_times",
        above=4,
    ),
    Rule(
        "scene",
        "note",
        "The light of the all-off picture limits exposures to {bearable_s:.2g} s; darken the "
        "room for longer ones.",
        "bearable_s",
        below="wanted_s",
    ),
    Rule(
        "scene",
        "note",
        "The projector's picture extends beyond the camera's view at the {edges} edge.",
        "edges_left",
        above=0,
    ),
    Rule(
        "dark",
        "good",
        "Black level {black_level_counts:.2f} counts; {hot_photosites} hot photosites are "
        "excluded.",
    ),
    Rule(
        "dark",
        "poor",
        "The room's light changes by {room_change_share:.1%} of the camera's range in "
        "{room_seconds:.2g} s: darken the room, cover windows and screens, and switch lamps "
        "off.",
        "room_change",
        above=1,
    ),
    Rule(
        "dark",
        "poor",
        "The black level, {black_level_counts:.1f} counts, is less than four standard "
        "deviations of the noise ({noise_counts:.2f} counts) above zero, so that dark counts "
        "are clipped and biased. Raise the camera's black level.",
        "headroom_deviations",
        below=4,
    ),
    Rule(
        "dark",
        "poor",
        "{hot_share:.2%} of the photosites are hot, more than {limit:.1%}: cool the camera, "
        "or use shorter exposures.",
        "hot_share",
        above=0.001,
    ),
    Rule(
        "dark",
        "poor",
        "The all-off picture isn't dark: at {longest_s:.3g} s it fills {filled_share:.0%} of "
        "the camera's range. Exposures of up to {bearable_s:.2g} s would be possible. With "
        "the lens cap on, run rfpipe calibrate with --step dark --again. If the light "
        "remains, it is dark current: cool the camera. If it disappears, black out the room, "
        "or lower the projector's brightness.",
        "filled_share",
        above=0.05,
    ),
    Rule(
        "linearity",
        "good",
        "{kind}: exposures agree within {deviation:.2%} beyond noise; the limit is "
        "{tolerance:.1%}.",
    ),
    Rule(
        "linearity",
        "unknown",
        "Exposures could not be compared. Take two or more exposures, a few times apart, with"
        " light between black and saturation.",
        "compared_levels",
        below=1,
    ),
    Rule(
        "linearity",
        "poor",
        "Not linear: exposures of the same light differ by up to {worst_deviation:.1%}, and a"
        " power law doesn't describe them with certainty. Switch the camera's gamma off. "
        "Check that the light is steady, that gain and exposure are not automatic, and that "
        "the exposure times in the settings are correct.",
        "deviation",
        above="tolerance",
    ),
    Rule(
        "light",
        "good",
        "{usable_codes} steps of light; code {code_of_half_light:.0f} gives half the light; "
        "the lamp drifted by {drift:+.2%}.",
    ),
    Rule(
        "light",
        "poor",
        "Too dark: full light is {over_noise:.0f} times a pixel's noise in the lit parts; "
        "{limit:.0f} times or more are required. Take the exposures that the step scene "
        "proposes, or open the aperture.",
        "over_noise",
        below=30,
    ),
    Rule(
        "light",
        "poor",
        "The light changed by {drift:+.2%} while the codes were shown, more than "
        "{tolerance:.1%}: let the lamp warm up, and calibrate again.",
        "drift_beyond_noise",
        above="tolerance",
    ),
    Rule(
        "light",
        "poor",
        "The light falls at code {falls_at_code}: switch off the projector's dynamic contrast"
        " and colour modes.",
        "falls_at_code",
        above=0,
    ),
    Rule(
        "light",
        "poor",
        "Only {usable_codes} codes differ: reset brightness and contrast.",
        "usable_codes",
        below=64,
    ),
    Rule(
        "transfer",
        "good",
        "Known well enough for the merge: {numbers}.",
    ),
    Rule(
        "transfer",
        "poor",
        "The variance deviates from photon noise by {misfit:.0%}; {numbers}. Check that the "
        "camera is linear, its gamma and noise reduction are off, and the light is steady.",
        "misfit",
        above=0.1,
    ),
    Rule(
        "transfer",
        "unknown",
        "Too few pairs to measure the noise within {limit:.0%}: {numbers}. Take more levels "
        "(calibrate.levels).",
        "known_within",
        above=0.1,
    ),
    Rule(
        "correspondence",
        "good",
        "{valid_share:.0%} of the camera's pixels are decoded, with a noise of "
        "{median_error_pixels:.3f} projector pixels.",
    ),
    Rule(
        "correspondence",
        "poor",
        "Only {valid_pixels} camera pixels see the projector's stripes. Check focus and "
        "exposures, and that the camera sees the part of the scene that the projector lights;"
        " or make the stripes wider than {period_pixels} pixels per period.",
        "valid_pixels",
        below=100,
    ),
    Rule(
        "correspondence",
        "poor",
        "Only {decoded_of_lit:.0%} of the camera's pixels that the projector lights are "
        "decoded; {limit:.0%} are required. The others are saturated, too dark or out of "
        "focus: correct exposures and focus first.",
        "decoded_of_lit",
        below=0.7,
    ),
    Rule(
        "correspondence",
        "poor",
        "{valid_share:.0%} of the camera's pixels are decoded, but their noise is "
        "{median_error_pixels:.2f} projector pixels, above {limit}: use longer exposures.",
        "median_error_pixels",
        above=0.1,
    ),
    Rule(
        "rays",
        "good",
        "{pixels_per_ray:.1f} camera pixels per ray, a leak of {leak:.2%}; the map fits within "
        "{map_rms_pixels:.2f} projector pixels per camera pixel, and its own error is "
        "{map_error_pixels:.3f}. The picture is blurred by {blur_pixels:.2f} camera pixels. "
        "The camera doesn't see {unseen_rays} rays, which stay dark.",
    ),
    Rule(
        "rays",
        "poor",
        "The camera doesn't see {unseen_rays:,} of {count:,} rays ({unseen_share:.0%}); "
        "{limit:.0%} are allowed. Turn the camera or its zoom until it sees the whole picture"
        " of the projector, or light a smaller part of the picture.",
        "unseen_share",
        above=0.02,
    ),
    Rule(
        "rays",
        "poor",
        "Rays are mixed: {leak:.1%} of other rays' light leaks into rays, and noise grows up "
        "to {largest_noise:.1f} times. The picture is blurred by {blur_pixels:.2f} camera "
        "pixels (standard deviation): focus camera and projector, or close the aperture. "
        "There are {pixels_per_ray:.1f} camera pixels per ray; 4 or more are required: use larger"
        " rays, or a longer lens.",
        "mixed",
        above=1,
    ),
    Rule(
        "rays",
        "poor",
        "The map from camera to projector has an error of {map_error_pixels:.2f} projector "
        "pixels, above {limit}: it isn't smooth, or blur hides the stripes. Check that the "
        "rig is coaxial and in focus.",
        "map_error_pixels",
        above=0.1,
    ),
    Rule(
        "symmetry",
        "good",
        "Good enough for symmetric photography.",
    ),
    Rule(
        "symmetry",
        "poor",
        "Not good enough for symmetric photography; dual photography doesn't need symmetry.",
        "least_error",
        above="tolerance",
    ),
    Rule(
        "symmetry",
        "unknown",
        "The noise is too large to decide: use more patterns, or longer exposures.",
        "most_error",
        above="tolerance",
    ),
    Rule(
        "symmetry",
        "note",
        "Asymmetry alone causes errors of {error_range} in relit pictures; {tolerance:.1%} "
        "are accepted.",
        "error",
        above=-1,
    ),
    Rule(
        "symmetry",
        "note",
        "The lamp's light changed by {drift:.1%}; the change is divided out.",
        "drift",
        above=0.01,
    ),
    Rule(
        "symmetry",
        "note",
        "Align the centres of both devices, and focus both; clean and shade the lens, and "
        "cover bright objects beside the scene, against flare; close the aperture against "
        "vignetting.",
        "least_error",
        above="tolerance",
    ),
)
