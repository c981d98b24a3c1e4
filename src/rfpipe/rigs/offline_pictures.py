"""Pictures as brackets of the patterns that they were to show: checked before any is used."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures import Header, picture_files, read_header, read_picture
from rfpipe.pictures.order import TURNS, Shown
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key
from rfpipe.rigs.offline import OfflineRig, Sheet
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY, SATURATION_FRACTION

Picture = tuple[Header, Path]

EXPOSURE_ERROR = 0.1
"""Share by which an exposure time may differ from the one set: cameras round 1/64 s to 1/60."""

SAME = 0.3
"""Two pictures are of one marker where they differ by less than this share of its opposite."""

MOST_SATURATED, LEAST_LIGHT = 0.01, 0.002
"""Largest saturated share of a picture's shortest exposure, and least light of the white picture's
longest one, of full scale."""


_NAMED = 4  # pictures that a message names


@dataclass(frozen=True, eq=False)
class Checked:
    """Pictures that fit what was to be shown.

    Attributes
    ----------
    rig : OfflineRig
    files, patterns : dict
        Files of each pattern's bracket, by exposure, ascending; fingerprints of the patterns; by
        key.
    notes : list of str
        What is to be known of them, but no reason to refuse them.
    """

    rig: OfflineRig
    files: dict[Key, tuple[Path, ...]]
    patterns: dict[Key, str]
    notes: list[str] = field(default_factory=list)

    def bracket(self, key: Key, pattern: NDArray[np.float32]) -> NDArray[Any] | None:
        """Return a pattern's frames; see `OfflineRig.bracket`."""
        if key not in self.files:
            return None
        if self.patterns[key] != fingerprint(np.asarray(pattern, np.float32)):
            raise CaptureError(
                f"{self.files[key][0]}: shows another pattern {key} than is asked for now, since "
                "settings or code changed. Write the patterns anew with 'rfpipe patterns', and "
                "take them"
            )
        return np.stack([_pixels(self.rig, path) for path in self.files[key]])


def check_pictures(
    rig: OfflineRig,
    sheet: Sheet,
    folder: Path,
    *,
    coaxial: bool,
    gamma: float,
    anyway: bool = False,
) -> Checked:
    """Check pictures against what was to be shown, and put them in order.

    Their names sort in the order of taking, a bracket's together. On a `coaxial` rig they are also
    compared with their patterns, of a projector of this `gamma`. With `anyway` pictures are taken
    that are too bright or dark, or don't seem to show their patterns. InputError where one can't be
    read; CaptureError names a wrong one, and says what to do.
    """
    files = picture_files(folder)
    step = len(sheet.exposures_s)
    expected = step * len(sheet.shown)
    pictures = [(_checked_header(rig, path), path) for path in files]
    is_timed = all(header.exposure_s is not None for header, _ in pictures)
    wrong, notes = list[str](), list[str]()
    if len(files) != expected:
        wrong.append(
            f"holds {len(files)} pictures; {len(sheet.shown)} patterns of {step} exposures each "
            f"make {expected}, as {sheet.folder} says. Check that the first and the last are "
            "there, none twice, and none of another series"
        )
        times = [header.exposure_s or 0 for header, _ in pictures]
        apart = np.abs(times / np.resize(times[:step], len(times)) - 1) if is_timed else np.zeros(1)
        if (apart > EXPOSURE_ERROR).any():
            name = pictures[int((apart > EXPOSURE_ERROR).argmax())][1].name
            wrong.append(f"From {name} on, exposures are out of step with the first ones")
    if step > 1 and not is_timed:
        notes.append(
            "not all pictures say their exposure time: each bracket is taken to go from the "
            "shortest to the longest"
        )
    brackets = []
    for shown, first in zip(sheet.shown, range(0, len(files) + 1 - step, step), strict=False):
        bracket = pictures[first : first + step]
        if is_timed and isinstance(rig.camera_sensor, CameraModel):
            bracket, fault = _by_exposure(bracket, sheet.exposures_s, shown.file)
            if fault:
                raise CaptureError(f"{folder}: {'. '.join([*wrong, fault])}")
        brackets.append(tuple(path for _, path in bracket))
    if len(brackets) < 3:
        raise CaptureError(f"{folder}: {'. '.join(wrong)}")
    taken = _Taken(rig, sheet, brackets, gamma)
    if wrong or not taken.has_markers:
        wrong.append(
            "the series doesn't begin with the marker and its opposite and end with the opposite, "
            "as it was to be shown: a picture is out of order, or these are of another series. "
            "Names are sorted by the numbers in them"
        )
        misplaced = taken.misplaced(coaxial=coaxial)[:1]
        raise CaptureError(f"{folder}: {'. '.join((wrong[:-1] or wrong) + misplaced)}")
    of_key = {
        shown.key: bracket
        for shown, bracket in zip(sheet.shown, brackets, strict=True)
        if shown.key is not None
    }
    wrong = _wrong_light(rig, of_key) + taken.misplaced(coaxial=coaxial)
    if wrong and not anyway:
        raise CaptureError(f"{folder}: {'; '.join(wrong)}. To take them all the same: --anyway")
    shown_as = {each.key: each.pattern for each in sheet.shown if each.key is not None}
    return Checked(rig, of_key, shown_as, notes + wrong)


class _Taken:
    """Pictures of a sheet as light on the rays: all that there are, the markers first."""

    def __init__(
        self, rig: OfflineRig, sheet: Sheet, brackets: list[tuple[Path, ...]], gamma: float
    ) -> None:
        self.rig, self.brackets = rig, brackets
        self.shown = sheet.shown[: len(brackets)]
        paths = (sheet.folder / shown.file for shown in self.shown)
        self.patterns = np.stack([rig.weights(read_picture(path).pixels, gamma) for path in paths])
        dark = [
            self.frames(index)
            for index, shown in enumerate(self.shown)
            if shown.key and shown.key[0] == BLACK_LEVEL_KEY
        ]
        black = np.full(self.frames(0).shape, getattr(rig.camera_sensor, "black_level_counts", 0))
        if dark:  # one of several may be lit
            black = np.sum(dark, axis=0) - (np.max(dark, axis=0) if len(dark) > 1 else 0)
            black = black / max(1, len(dark) - 1)
        self.merge = rig.sensor.merging(black.astype(np.float32), max(1, len(dark) - 1))
        both = [self.merged(index) for index in range(len(brackets))]
        self.light, self.variance = (np.stack(part) for part in zip(*both, strict=True))

    def frames(self, index: int, turn: str = "") -> NDArray[Any]:
        """Return a bracket (E, ...), its pictures turned as one of `TURNS` says."""
        return np.stack([TURNS[turn](_pixels(self.rig, path)) for path in self.brackets[index]])

    def merged(self, index: int, turn: str = "") -> NDArray[np.float64]:
        """Return light and variance of a picture, (2, H, W); nothing where it doesn't fit."""
        height, width = RayDomain(self.rig.camera_shape).picture_shape
        frames = self.frames(index, turn)
        if frames.shape[1:3] != self.rig.picture_shape:
            return np.zeros((2, height, width))
        shape = self.rig.sensor.frame_shape(self.rig.camera_shape, self.rig.channels)
        found = self.merge(frames.reshape(1, *shape))
        of_rays = np.stack([found.radiance[0], found.variance[0]]).sum(axis=-1, dtype=np.float64)
        return np.asarray(np.nan_to_num(of_rays, posinf=0)).reshape(2, height, width)

    @property
    def has_markers(self) -> bool:
        """Whether the last picture is as the second, and not as the first."""

        def apart(one: int) -> float:
            rest = np.square(self.light[one] - self.light[-1])
            return float(np.sqrt(max((rest - self.variance[one] - self.variance[-1]).sum(), 0)))

        return apart(1) < SAME * apart(0)

    def misplaced(self, *, coaxial: bool) -> list[str]:
        """Say which pictures don't show their patterns, the first ones of many."""
        rest = slice(2, None)
        names, white = [shown.file for shown in self.shown[rest]], self.light[:2].sum(axis=0)
        pictures = Shown(self.patterns[rest], names, self.light[rest], self.variance[rest], white)
        found = pictures.impossible()
        placed = coaxial and pictures.misplaced(lambda turn, k: self.merged(k + 2, turn)[0])
        found |= placed or pictures.repeated()
        if len(found) > 1 and len(set(found.values())) == 1 and "when it is" in found[min(found)]:
            each = found[min(found)].replace("fits when it is", "fit when they are")
            advice = "say by offline.camera_corners which corner is the projector's upper left one"
            return [f"all pictures {each}. Turn them, or {advice}"]
        said = [
            f"{self.brackets[index + 2][0].name}, of {names[index]}, {found[index]}"
            for index in sorted(found)
        ]
        return [*said[:_NAMED], *([f"and {len(said) - _NAMED} more"] if said[_NAMED:] else [])]


def _checked_header(rig: OfflineRig, path: Path) -> Header:
    """Return a picture's header, of the kind, size and channels of the settings' camera."""
    header = read_header(path)
    is_counts = isinstance(rig.camera_sensor, CameraModel)
    if header.kind != ("counts" if is_counts else "light"):
        raise CaptureError(
            f"{path}: holds {header.kind}, but the settings' camera is "
            f"{'a camera of counts' if is_counts else 'null, exact radiance'}. Give "
            + ("TIFF, PNG or raw files, or" if is_counts else "EXR files of linear light, or")
            + f" set camera to {'null' if is_counts else 'its numbers'}"
        )
    if header.size != rig.picture_shape:
        raise CaptureError(
            f"{path}: is {header.size[0]} x {header.size[1]} pixels (height x width); expected "
            f"{rig.picture_shape[0]} x {rig.picture_shape[1]}. Where the rays lie in the picture "
            "is said by offline.calibration, or offline.picture_shape and offline.camera_corners"
        )
    channels = 1 if _is_mosaic(rig) else rig.channels
    if header.channels != channels:
        raise CaptureError(
            f"{path}: has {header.channels} channels; expected {channels}. Set the scene's "
            "channels, and camera.bayer for a raw file's colour mosaic"
        )
    return header


def _by_exposure(
    bracket: list[Picture], exposures: tuple[float, ...], name: str
) -> tuple[list[Picture], str]:
    """Sort a bracket by its exposure times; say which of them isn't as it was set, if any."""
    ordered = sorted(bracket, key=lambda each: each[0].exposure_s or 0)
    for (header, path), expected in zip(ordered, exposures, strict=True):
        seconds = header.exposure_s or 0
        if abs(seconds - expected) > EXPOSURE_ERROR * expected:
            times = ", ".join(f"{each.exposure_s:g}" for each, _ in ordered)
            return ordered, (
                f"{path.name} was exposed for {seconds:g} s; the bracket of {name} ({times} s) "
                f"should have {', '.join(f'{each:g}' for each in exposures)} s, as "
                "camera.exposures says. A picture may be missing before it, or be there twice"
            )
    return ordered, ""


def _wrong_light(rig: OfflineRig, files: dict[Key, tuple[Path, ...]]) -> list[str]:
    """Return the faults of the pictures' light."""
    sensor = rig.camera_sensor
    if not isinstance(sensor, CameraModel):
        return []
    wrong, top = [], SATURATION_FRACTION * sensor.white_level
    if sensor.bits >= 14 and max(_pixels(rig, each[-1]).max() for each in files.values()) <= 255:
        wrong.append(f"holds no counts above 255, as of 8 bits; camera.bits says {sensor.bits}")
    shortest = [bracket[0] for bracket in files.values()]
    saturated = [
        path.name for path in shortest if (_pixels(rig, path) >= top).mean() > MOST_SATURATED
    ]
    if saturated:
        more = f" and {len(saturated) - 1} more" if len(saturated) > 1 else ""
        wrong.append(
            f"{saturated[0]}{more} have over {MOST_SATURATED:.0%} of their pixels saturated in the "
            f"shortest exposure, {sensor.exposures[0]:g} s: add a shorter one, or dim the projector"
        )
    white, black = (FLOODLIT_KEY, 0), (BLACK_LEVEL_KEY, 0)
    if white in files and black in files:
        lit, dark = (_pixels(rig, files[key][-1]).mean() for key in (white, black))
        if lit - dark < LEAST_LIGHT * sensor.white_level:
            wrong.append(
                f"the white picture's longest exposure has {lit - dark:.1f} counts of light on "
                "average: lens cap, projector, or a longer exposure"
            )
    return wrong


@lru_cache(maxsize=8)
def _pixels(rig: OfflineRig, path: Path) -> NDArray[Any]:
    """Read a picture as a frame of the rig's camera, (H, W, C), or (H, W) of a mosaic."""
    picture, sensor = read_picture(path), rig.camera_sensor
    pixels = picture.pixels
    if isinstance(sensor, CameraModel):
        if (largest := int(pixels.max(initial=0))) > sensor.white_level:
            raise CaptureError(
                f"{path}: holds {largest} counts; full scale of camera.bits {sensor.bits} is "
                f"{sensor.white_level}. Set camera.bits to those of the file: to 16 where it has "
                "counts shifted to 16 bits, and camera.black_level_counts accordingly"
            )
        if sensor.bits > 8 and (picture.bits == 8 or _step(pixels) > sensor.white_level >> 8):
            raise CaptureError(
                f"{path}: holds counts of 8 bits; camera.bits says {sensor.bits}. Save pictures of "
                "16 bits, linear and not developed, or set camera.bits and black_level_counts"
            )
    elif not np.isfinite(pixels).all():
        raise CaptureError(f"{path}: holds NaN or infinity; light is finite. Take it again")
    return pixels[..., 0] if _is_mosaic(rig) else pixels


def _step(pixels: NDArray[Any]) -> int:
    """Return what divides the counts' differences, as far as some pixels tell; 0 of few counts."""
    flat = pixels.ravel()
    counts = np.unique(flat[:: max(1, flat.size // 4096)])
    return int(np.gcd.reduce(np.diff(counts))) if len(counts) > 8 else 0


def _is_mosaic(rig: OfflineRig) -> bool:
    return getattr(rig.camera_sensor, "bayer", None) is not None
