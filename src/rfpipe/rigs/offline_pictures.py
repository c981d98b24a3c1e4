"""Pictures as brackets of the patterns that they were to show: checked before any is used."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures import Header, check_mosaic, picture_files, read_header, read_picture
from rfpipe.pictures.order import are_late, correlation, misplaced
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key
from rfpipe.rigs.check_pictures import thinned
from rfpipe.rigs.faults import late_fault, moved_fault
from rfpipe.rigs.offline import OfflineRig, Sheet
from rfpipe.rigs.offline_light import light_faults
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY, SATURATION_FRACTION, picture_name

Picture = tuple[Header, Path]
Float = NDArray[np.float32]

EXPOSURE_ERROR = 0.1
"""Share by which an exposure time may differ from the one set: cameras round 1/64 s to 1/60."""

SAME = 0.3
"""Two pictures are of one marker where they differ by less than this share of its opposite."""

MOVED = 0.4
"""Correlation from which on a picture of another marker is the same marker, moved."""

MOST_SATURATED, LEAST_LIGHT = 0.01, 0.002
"""Largest saturated share of a picture's shortest exposure, and least light of the white picture's
longest one, of full scale."""


@dataclass(frozen=True, eq=False)
class Checked:
    """Pictures that fit what was to be shown.

    Attributes
    ----------
    rig : OfflineRig
        With these pictures as its brackets.
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
                f"{self.files[key][0]}: shows another {picture_name(key)} than is asked for now, "
                "since settings or code changed. Write the patterns anew with 'rfpipe patterns', "
                "and take them"
            )
        return np.stack([_pixels(self.rig, path) for path in self.files[key]])


def check_pictures(
    rig: OfflineRig, sheet: Sheet, folder: Path, *, coaxial: bool, anyway: bool = False
) -> Checked:
    """Check pictures against what was to be shown, and put them in order.

    Their names sort in the order of taking, a bracket's together. On a `coaxial` rig they are also
    compared with their patterns. With `anyway` pictures are taken that are too bright or dark, or
    don't seem to show their patterns. InputError where one can't be read; CaptureError names a
    wrong one, and says what to do.
    """
    files = picture_files(folder)
    step = len(sheet.exposures_s)
    expected = step * len(sheet.shown)
    pictures = [(_checked_header(rig, path), path) for path in files]
    is_timed = all(header.exposure_s is not None for header, _ in pictures)
    notes = []
    if step > 1 and not is_timed:
        notes.append(
            "not all pictures say their exposure time: each bracket is taken to go from the "
            "shortest to the longest"
        )
    brackets: list[tuple[Path, ...]] = []
    for index, shown in enumerate(sheet.shown):
        bracket = pictures[step * index : step * (index + 1)]
        if is_timed and isinstance(rig.camera_sensor, CameraModel):
            bracket = _by_exposure(bracket, sheet.exposures_s, shown.file)
        brackets.append(tuple(path for _, path in bracket))
    if len(files) != expected:
        raise CaptureError(
            f"{folder}: holds {len(files)} pictures; {len(sheet.shown)} patterns of {step} "
            f"exposures each make {expected}, as {sheet.folder} says. Check that the first and "
            "the last are there, none twice, and none of another series"
        )
    light, frames = _read(rig, brackets)
    weights = np.stack(
        [rig.weights(read_picture(sheet.folder / shown.file).pixels) for shown in sheet.shown]
    )
    if are_late(weights, light, coaxial=coaxial):
        raise CaptureError(f"{folder}: {late_fault(1.0).text}. Then take the pictures again")
    _check_markers(light, folder)
    taken = [*zip(sheet.shown, brackets, strict=True)]
    of_key = {shown.key: bracket for shown, bracket in taken if shown.key is not None}
    patterns = {shown.key: shown.pattern for shown in sheet.shown if shown.key is not None}
    wrong = _wrong_light(rig, of_key)
    if not wrong and isinstance(rig.camera_sensor, CameraModel):
        faults = light_faults(sheet.shown, frames, rig.camera_sensor)
        wrong += [fault.text for fault in faults]
    if coaxial:
        wrong += misplaced(weights, [path.name for path, *_ in brackets], light)
    if wrong and not anyway:
        raise CaptureError(f"{folder}: {'; '.join(wrong)}. To take them all the same: --anyway")
    checked = Checked(rig, of_key, patterns, notes + wrong)
    rig.bracket = checked.bracket
    return checked


def _check_markers(light: Float, folder: Path) -> None:
    """Check that a series begins with marker and opposite, and ends with the opposite."""
    marker, opposite, last = light[[0, 1, -1]]
    if np.linalg.norm(opposite - last) < SAME * np.linalg.norm(marker - last):
        return
    if correlation(opposite, last) > MOVED > correlation(marker, last):
        change = float(np.linalg.norm(opposite - last) / max(float(np.linalg.norm(opposite)), 1e-9))
        raise CaptureError(
            f"{folder}: {moved_fault(change).text}. Between the second picture and the last, which "
            "show the same pattern. Then take the pictures again"
        )
    raise CaptureError(
        f"{folder}: the series doesn't begin with the marker and its opposite and end with the "
        "opposite, as it was to be shown: a picture is out of order, or these are of another "
        "series. Names are sorted by the numbers in them"
    )


def _read(
    rig: OfflineRig, brackets: list[tuple[Path, ...]]
) -> tuple[Float, list[NDArray[np.float32]]]:
    """Return the pictures' light on the rays, (K, H, W), and some photosites of each frame."""
    shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
    level = getattr(rig.camera_sensor, "black_level_counts", 0)
    merge = rig.sensor.merging(np.full(shape, level, np.float32))
    light, frames = [], []
    for paths in brackets:
        bracket = np.stack([_pixels(rig, path) for path in paths])
        light.append(merge(bracket.reshape(1, *shape)).radiance.sum(axis=-1))
        frames.append(thinned(bracket))
    picture_shape = RayDomain(rig.camera_shape).picture_shape
    return np.reshape(light, (len(light), *picture_shape)), frames


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
    if isinstance(rig.camera_sensor, CameraModel):
        check_mosaic(path, header, rig.camera_sensor.bayer)
    channels = 1 if _is_mosaic(rig) else rig.channels
    if header.channels != channels:
        raise CaptureError(
            f"{path}: has {header.channels} channels; expected {channels}. Set the scene's "
            "channels, and camera.bayer for a raw file's colour mosaic"
        )
    return header


def _by_exposure(bracket: list[Picture], exposures: tuple[float, ...], name: str) -> list[Picture]:
    """Sort a bracket by its exposure times, which have to be those that were set."""
    ordered = sorted(bracket, key=lambda each: each[0].exposure_s or 0)
    for (header, path), expected in zip(ordered, exposures, strict=False):
        seconds = header.exposure_s or 0
        if abs(seconds - expected) > EXPOSURE_ERROR * expected:
            times = ", ".join(f"{each.exposure_s:g}" for each, _ in ordered)
            raise CaptureError(
                f"{path}: was exposed for {seconds:g} s; the bracket of {name} ({times} s) should "
                f"have {', '.join(f'{each:g}' for each in exposures)} s, as camera.exposures says. "
                "A picture may be missing before it, or be there twice"
            )
    return ordered


def _wrong_light(rig: OfflineRig, files: dict[Key, tuple[Path, ...]]) -> list[str]:
    """Return the faults of the pictures' light."""
    sensor = rig.camera_sensor
    if not isinstance(sensor, CameraModel):
        return []
    wrong, top = [], SATURATION_FRACTION * sensor.white_level
    if sensor.bits > 8:
        counts = reduce(np.union1d, (_pixels(rig, bracket[-1]) for bracket in files.values()))
        step = np.gcd.reduce(np.diff(counts)) if len(counts) > 16 else 0  # few tell nothing
        if counts[-1] <= 255 <= sensor.white_level >> 6 or step > sensor.white_level >> 8:
            wrong.append(
                f"these are counts of 8 bits; camera.bits says {sensor.bits}. Save pictures of 16 "
                "bits, linear and not developed, or set camera.bits and black_level_counts"
            )
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
    pixels, sensor = read_picture(path).pixels, rig.camera_sensor
    if isinstance(sensor, CameraModel):
        if (largest := int(pixels.max(initial=0))) > sensor.white_level:
            raise CaptureError(
                f"{path}: holds {largest} counts; full scale of camera.bits {sensor.bits} is "
                f"{sensor.white_level}. Set camera.bits to those of the file: to 16 where it has "
                "counts shifted to 16 bits, and camera.black_level_counts accordingly"
            )
        pixels = pixels.astype(np.uint16, copy=False)  # camera.bits is at most 16
    elif not np.isfinite(pixels).all():
        raise CaptureError(f"{path}: holds NaN or infinity; light is finite. Take it again")
    return pixels[..., 0] if _is_mosaic(rig) else pixels


def _is_mosaic(rig: OfflineRig) -> bool:
    return getattr(rig.camera_sensor, "bayer", None) is not None
