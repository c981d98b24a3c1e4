"""Linear light of listed pictures, averaged over squares of pixels.

Pictures are read twice, one at a time: once for the pixels that saturate in any of them, once for
their light. A pixel that saturates anywhere is unknown in all pictures, so that the same pixels are
averaged in each.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from tqdm import tqdm

from rfpipe.array_types import Bools, Float
from rfpipe.errors import InputError
from rfpipe.fitting.binning import Bins, bin_image, binned_shape, count_known, proposed_bins
from rfpipe.fitting.black import black_scale
from rfpipe.fitting.folder import Listing, default_curve, list_pictures
from rfpipe.fitting.patterns import light_of, linear_light
from rfpipe.fitting.series import Series
from rfpipe.photometry.camera import are_saturated
from rfpipe.pictures import check_raw_mosaic, encoding_note, relative_exposures
from rfpipe.pictures.files import Header, Part
from rfpipe.units import SATURATION_FRACTION
from rfpipe.weights import Curve, curve_slope

if TYPE_CHECKING:
    from rfpipe.photometry import CameraModel
    from rfpipe.photometry.sensor import BracketMerge

Bracket = Sequence[Part]

MOST_SATURATED = 0.01
"""Share of saturated pixels above which a note is given."""


@dataclass(frozen=True)
class PatternLight:
    """Linear light of one pattern, averaged over squares of pixels.

    Attributes
    ----------
    radiance : ndarray of float32, shape (h, w, C)
    variance : ndarray of float32, shape (h, w, C)
        Mean variance of the pixels of each square.
    """

    radiance: Float
    variance: Float


class Development(Protocol):
    """Way from files to linear light."""

    def saturated(self, brackets: Iterator[Bracket]) -> Bools:
        """Return the pixels that saturate in any of the pictures, bool (H, W)."""

    def light(self, bracket: Bracket, known: Bools, side: int) -> PatternLight:
        """Return the light of one pattern, averaged over the known pixels of squares."""


def read_series(
    folder: Path,
    *,
    lights: tuple[int, int] | None = None,
    patterns: str | None = None,
    camera: CameraModel | None = None,
    black: Path | None = None,
    ambient: Path | None = None,
    transfer: Curve | None = None,
    camera_bin: int | None = None,
    projector_bin: int | None = None,
    memory_gib: float = 2.0,
    progress: bool = False,
) -> Series:
    """Read pictures and their patterns.

    Parameters
    ----------
    folder, lights, patterns, black, ambient
        As for `rfpipe.fitting.folder.list_pictures`. Pictures without light are subtracted.
    camera : CameraModel, optional
        Model of the camera, by which brackets are merged, with their variance. By default pictures
        are light, one exposure of each pattern, divided by their files' exposures.
    transfer : {"linear", "srgb"}, optional
        Transfer curve of integers in pictures, and in pictures of patterns.
    camera_bin, projector_bin : int, optional
        Side in pixels of the squares that are averaged, at least 1. By default as small as
        `memory_gib` allows; single lights are not averaged.
    memory_gib : float
        Memory that the fit may take, in GiB.
    progress : bool
        Whether to show a bar.

    Returns
    -------
    Series
        Its ``notes`` describe saturated pixels, bins, and files that may not be meant so.

    Raises
    ------
    InputError
        When a picture can't be read or holds NaN, or number, size or channels don't fit together.
    """
    exposures = len(camera.exposures) if camera else 1
    curve = transfer or default_curve(folder)
    listing = list_pictures(
        folder, lights=lights, patterns=patterns, exposures=exposures, black=black, ambient=ambient,
        curve=curve, develop_raw=camera is None,
    )  # fmt: skip
    parts = [part for bracket in listing.brackets for part in bracket]
    header = _common_header(parts)
    chosen = None if curve == "linear" and transfer is None else curve
    note = encoding_note([part.header for part in parts], [*map(str, parts)], chosen)
    bins, notes = _bins(listing, header, (camera_bin, projector_bin), memory_gib)
    notes = [*listing.notes, *([note] if note else []), *notes]
    weights = _binned_patterns(listing, bins.projector)
    lit: Bools = np.asarray(weights.any(axis=(1, 2)))
    brackets = [listing.brackets[int(index)] for index in np.flatnonzero(lit)]
    unlit = [listing.brackets[int(index)] for index in np.flatnonzero(~lit)]
    development = _development(listing, unlit, camera, curve)

    def with_progress(label: str) -> Iterator[Bracket]:
        return iter(tqdm(brackets, label, unit="picture", disable=None if progress else True))

    known = ~development.saturated(with_progress("saturated pixels"))
    if not known.any():
        raise InputError(f"{folder}: every pixel saturates in some picture; expose shorter")
    if (share := 1 - known.mean()) > MOST_SATURATED:
        notes.append(_saturation_note(share, known.size))
    if listing.mask is not None:
        known &= _mask(listing.mask, header)
    radiance, variance = _binned_light(development, with_progress("light"), known, bins.camera)
    if known.any() and np.mean(radiance[..., np.isfinite(variance[0, 0])]) <= 0:
        raise InputError(
            f"{folder}: the pictures are darker than those without light, which are subtracted; "
            "check that no black or ambient picture has another exposure or shows white light"
        )
    return Series(
        binned_shape(header.size, bins.camera),
        binned_shape(listing.patterns.shape, bins.projector),
        weights[lit],
        radiance,
        variance,
        [bracket[0].name for bracket in brackets],
        listing.directions,
        listing.validation[lit],
        tuple(notes),
    )


def _development(
    listing: Listing, unlit: Sequence[Bracket], camera: CameraModel | None, curve: Curve
) -> Development:
    """Return the conversion of pictures to light: merged brackets with a camera's model."""
    if camera is not None:
        return MergedBrackets.of(listing, unlit, camera)
    return SingleExposures.of(listing, unlit, curve)


@dataclass(frozen=True)
class SingleExposures:
    """Pictures with one exposure per pattern.

    Attributes
    ----------
    curve : {"linear", "srgb"}
    divisors : dict of str to ndarray of float64, shape (1,) or (3,)
        Exposure times the intensity of the light, by the picture's name.
    black : ndarray of float32, shape (H, W, C), or None
        Light of pictures without light, over their exposures.
    """

    curve: Curve
    divisors: dict[str, NDArray[np.float64]]
    black: Float | None

    @classmethod
    def of(cls, listing: Listing, unlit: Sequence[Bracket], curve: Curve) -> SingleExposures:
        """Compute the divisors and the black picture of a listing; `unlit` show black patterns."""
        parts = [part for (part,) in listing.brackets]
        names = [str(part) for part in parts]
        exposures = relative_exposures([part.header for part in parts], names)
        exposure_of = dict(zip(names, exposures, strict=True))
        divisors = exposures[:, None]
        if listing.intensities is not None:
            intensities = listing.intensities.astype(np.float64)
            if parts[0].header.channels == 1:
                intensities = intensities.mean(axis=1, keepdims=True)
            divisors = divisors * intensities
        dark = [linear_light(part, curve) / exposure_of[str(part)] for (part,) in unlit]
        for (part,) in listing.dark:
            scale = black_scale(part.header, parts[0].header, (str(part), str(parts[0])))
            dark.append(linear_light(part, curve) * scale / exposures[0])
        black: Any = np.mean(dark, axis=0, dtype=np.float64) if dark else None
        return cls(curve, dict(zip(names, divisors, strict=True)), black)

    def saturated(self, brackets: Iterator[Bracket]) -> Bools:
        """Return the pixels whose count is about the files' largest number in any picture."""
        highest: Any = 0
        white: float = 1
        for (part,) in brackets:
            picture = part.read()
            highest, white = np.maximum(highest, picture.pixels), picture.white
            if picture.header.kind == "light":
                white = np.inf
        return np.asarray((highest >= np.ceil(SATURATION_FRACTION * white)).any(axis=-1))

    def light(self, bracket: Bracket, known: Bools, side: int) -> PatternLight:
        """Return a picture's light over its exposure; its variance is due to rounding."""
        (part,) = bracket
        divisor, picture = self.divisors[str(part)], part.read()
        light = bin_image(light_of(picture, self.curve, str(part)), side, known)
        radiance = light / divisor
        if self.black is not None:
            radiance -= bin_image(self.black, side, known)
        step = 0.0 if picture.header.kind == "light" else 1 / picture.white
        rounding = np.square(curve_slope(light, self.curve) * step / divisor) / 12
        return PatternLight(radiance.astype(np.float32), rounding.astype(np.float32))


@dataclass(frozen=True)
class MergedBrackets:
    """Brackets of a known camera.

    Attributes
    ----------
    frame_shape : tuple of int
        Of one bracket, (E, H, W[, C]).
    merge : callable
        Merges brackets (B, E, H, W[, C]).
    """

    frame_shape: tuple[int, ...]
    merge: BracketMerge

    @classmethod
    def of(cls, listing: Listing, unlit: Sequence[Bracket], camera: CameraModel) -> MergedBrackets:
        """Prepare the merge of a listing's brackets, by the mean of its pictures without light.

        `unlit` show black patterns.
        """
        part = listing.brackets[0][0]
        header = part.header
        if header.kind != "counts":
            raise InputError(f"{part}: holds light; the settings' camera counts")
        check_raw_mosaic(part.file, header, camera.bayer)
        shape = camera.frame_shape(header.size, header.channels if camera.bayer is None else 3)
        for dark in listing.dark:
            black_scale(dark[0].header, header, (str(dark[0]), str(part)))
        frames = [_frames(bracket, shape) for bracket in (*unlit, *listing.dark)]
        black: Any = np.full(shape, camera.black_level_counts, np.float32)
        if frames:
            black = np.mean(frames, axis=0, dtype=np.float64)
        return cls(shape, camera.bracket_merge(black.astype(np.float32), max(1, len(frames))))

    def saturated(self, brackets: Iterator[Bracket]) -> Bools:
        """Return the pixels that saturate in all exposures of any bracket."""
        masks = [are_saturated(*self._merged(bracket)).any(axis=-1) for bracket in brackets]
        return np.asarray(np.logical_or.reduce(masks))

    def light(self, bracket: Bracket, known: Bools, side: int) -> PatternLight:
        """Return the merged light of a bracket, with its variance."""
        return PatternLight(*(bin_image(image, side, known) for image in self._merged(bracket)))

    def _merged(self, bracket: Bracket) -> tuple[Float, Float]:
        merged = self.merge(_frames(bracket, self.frame_shape)[None])
        return np.atleast_3d(merged.radiance[0]), np.atleast_3d(merged.variance[0])


def _common_header(parts: Sequence[Part]) -> Header:
    """Return the header that all pictures share, up to their exposure; else InputError."""
    first = parts[0].header
    for part in parts:
        if not part.header.matches(first):
            raise InputError(
                f"{part}: has {_described(part.header)}; {parts[0]} has {_described(first)}. "
                "All pictures should be alike"
            )
    return first


def _described(header: Header) -> str:
    """Return size, channels and kind of a picture in words."""
    height, width = header.size
    mosaic = f", mosaic {header.mosaic}" if header.mosaic else ""
    return f"{height} x {width} pixels, {header.channels} channels of {header.kind}{mosaic}"


def _bins(
    listing: Listing, header: Header, wishes: tuple[int | None, int | None], memory_gib: float
) -> tuple[Bins, list[str]]:
    """Return the bins of a listing, and a note where they were chosen."""
    samples = len(listing.brackets) * (header.channels + 1)
    shapes = header.size, listing.patterns.shape
    proposed = proposed_bins(*shapes, samples, memory_gib * 2**30)
    if listing.are_single_lights:
        proposed = Bins(proposed.camera if listing.directions is None else 1, 1)
    bins = Bins(wishes[0] or proposed.camera, wishes[1] or proposed.projector)
    for option, side, size in (
        ("camera-bin", bins.camera, header.size), ("projector-bin", bins.projector, shapes[1])
    ):  # fmt: skip
        if side > 1 and 2 * side > min(size):
            raise InputError(
                f"--{option} {side}: leaves fewer than two squares of {size[0]} x {size[1]} pixels "
                f"a side; expected at most {max(min(size) // 2, 1)}"
            )
    chosen = [
        f"{title} are averaged over {side} x {side} pixels (--{option} chooses another size)"
        for title, option, wish, side in (
            ("pictures", "camera-bin", wishes[0], bins.camera),
            ("patterns", "projector-bin", wishes[1], bins.projector),
        )
        if wish is None and side > 1
    ]
    limit = f", so that the fit stays within {memory_gib:g} GiB (--memory-gib)"
    return bins, [", ".join(chosen) + limit] if chosen else []


def _binned_patterns(listing: Listing, side: int) -> Float:
    """Return all patterns, (K, 1, N), or (K, 3, N) where any is coloured."""
    patterns = [bin_image(read(), side) for read in listing.patterns.readers]
    coloured = any(pattern.ndim == 3 for pattern in patterns)
    shape = (*patterns[0].shape[:2], 3 if coloured else 1)
    stack = np.stack([np.broadcast_to(np.atleast_3d(pattern), shape) for pattern in patterns])
    if coloured and not np.ptp(stack, axis=-1).any():
        stack = stack[..., :1]
    return np.ascontiguousarray(np.moveaxis(stack.reshape(len(stack), -1, stack.shape[-1]), -1, 1))


def _binned_light(
    development: Development, brackets: Iterator[Bracket], known: Bools, side: int
) -> tuple[Float, Float]:
    """Return the light of all brackets and its variance, (K, C, M); unknown is infinite."""
    count = count_known(known, side)
    radiance, variance = [], []
    for bracket in brackets:
        light = development.light(bracket, known, side)
        radiance.append(_planar(light.radiance))
        spread = light.variance / np.maximum(count, 1)[..., None]
        variance.append(_planar(np.where(count[..., None] > 0, spread, np.inf)))
    return np.stack(radiance), np.stack(variance)


def _saturation_note(share: float, size: int) -> str:
    return (
        f"{share:.0%} of the camera's {size:,} pixels are saturated in some picture and count as "
        "unknown: expose shorter, or take brackets (--settings)"
    )


def _mask(part: Part, header: Header) -> Bools:
    """Return the pixels of a mask, bool (H, W): those above half of its maximum."""
    pixels = part.read().pixels.max(axis=-1)
    if pixels.shape != header.size:
        raise InputError(f"{part}: is a mask of {pixels.shape} pixels; pictures have {header.size}")
    return np.asarray(pixels > np.max(pixels) / 2)


def _frames(bracket: Bracket, shape: tuple[int, ...]) -> NDArray[Any]:
    """Return the raw counts of a bracket, (E, H, W[, C])."""
    return np.stack([part.read().pixels for part in bracket]).astype(np.uint16).reshape(shape)


def _planar(image: Float) -> Float:
    """Return (C, M) of (H, W, C)."""
    return np.ascontiguousarray(image.reshape(-1, image.shape[-1]).T, np.float32)
