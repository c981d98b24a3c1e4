"""Validation of offline pictures, and their assignment to patterns as brackets."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache, reduce
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import CaptureError
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures import Header, check_raw_mosaic, picture_files, read_header, read_picture
from rfpipe.pictures.order import are_late, correlation, misplaced
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key
from rfpipe.rigs.check_pictures import thinned
from rfpipe.rigs.faults import late_fault, moved_fault
from rfpipe.rigs.offline import OfflineRig, Sheet
from rfpipe.rigs.offline_light import light_faults
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY, SATURATION_FRACTION, picture_name

PictureFile = tuple[Header, Path]

EXPOSURE_ERROR = 0.1
"""Accepted relative error of an exposure time: cameras round 1/64 s to 1/60."""

SAME_MARKER = 0.3
"""Two pictures show the same marker if they differ by less, relative to marker and complement."""

MOVED = 0.4
"""Correlation above which a differing picture shows the same marker after a motion."""

MOST_SATURATED, LEAST_LIGHT = 0.01, 0.002
"""Largest saturated share of a picture's shortest exposure, and least light of the white picture's
longest exposure relative to full scale."""


@dataclass(frozen=True, eq=False)
class ValidPictures:
    """Pictures that agree with a sheet.

    Attributes
    ----------
    rig : OfflineRig
        Rig whose brackets are these pictures.
    files : dict
        Files of each pattern's bracket by ascending exposure, by key.
    patterns : dict
        Fingerprints of the patterns, by key.
    notes : list of str
        Remarks that don't prevent the use of the pictures.
    """

    rig: OfflineRig
    files: dict[Key, tuple[Path, ...]]
    patterns: dict[Key, str]
    notes: list[str] = field(default_factory=list)

    def bracket(self, key: Key, pattern: NDArray[np.float32]) -> NDArray[Any] | None:
        """Read a pattern's frames; see `OfflineRig.bracket`."""
        if key not in self.files:
            return None
        if self.patterns[key] != fingerprint(np.asarray(pattern, np.float32)):
            raise CaptureError(
                f"{self.files[key][0]}: shows a previous version of {picture_name(key)}, which "
                "changed with the settings or the code",
                remedy="Write the patterns again with 'rfpipe patterns', and take their pictures",
            )
        return np.stack([_pixels(self.rig, path) for path in self.files[key]])


def validate_pictures(
    rig: OfflineRig, sheet: Sheet, folder: Path, *, coaxial: bool, anyway: bool = False
) -> ValidPictures:
    """Compare pictures with a sheet, and make them the brackets of the rig.

    Parameters
    ----------
    rig : OfflineRig
    sheet : Sheet
    folder : Path
        Pictures; their names sort in the order of capture.
    coaxial : bool
        Whether camera and projector share their rays; pictures are compared with patterns then.
    anyway : bool
        Whether to accept pictures that are too bright or dark, or seem to show other patterns.

    Raises
    ------
    InputError
        When a picture can't be read.
    CaptureError
        When the pictures disagree with the sheet.
    """
    brackets, notes = _brackets_of(rig, sheet, folder)
    light, frames = _read(rig, brackets)
    weights = np.stack(
        [rig.weights(read_picture(sheet.folder / shown.file).pixels) for shown in sheet.shown]
    )
    if are_late(weights, light, coaxial=coaxial):
        raise CaptureError(f"{folder}: {late_fault(1.0).text}. Then take the pictures again")
    _check_markers(light, folder)
    pairs = [*zip(sheet.shown, brackets, strict=True)]
    files = {shown.key: bracket for shown, bracket in pairs if shown.key is not None}
    patterns = {shown.key: shown.pattern for shown in sheet.shown if shown.key is not None}
    faults = _exposure_faults(rig, files)
    if not faults and isinstance(rig.camera_sensor, CameraModel):
        faults += [fault.text for fault in light_faults(sheet.shown, frames, rig.camera_sensor)]
    if coaxial:
        faults += misplaced(weights, [path.name for path, *_ in brackets], light)
    if faults and not anyway:
        raise CaptureError(f"{folder}: {'; '.join(faults)}. To use them nevertheless: --anyway")
    pictures = ValidPictures(rig, files, patterns, notes + faults)
    rig.bracket = pictures.bracket
    return pictures


def _brackets_of(
    rig: OfflineRig, sheet: Sheet, folder: Path
) -> tuple[list[tuple[Path, ...]], list[str]]:
    """Assign the files in a folder to the pictures of a sheet; also return notes."""
    files = picture_files(folder)
    step = len(sheet.exposures_s)
    pictures = [(_checked_header(rig, path), path) for path in files]
    is_timed = all(header.exposure_s is not None for header, _ in pictures)
    notes = []
    if step > 1 and not is_timed:
        notes.append(
            "not all pictures state their exposure time: each bracket is assumed to go from the "
            "shortest to the longest exposure"
        )
    brackets: list[tuple[Path, ...]] = []
    for index, shown in enumerate(sheet.shown):
        bracket = pictures[step * index : step * (index + 1)]
        if is_timed and isinstance(rig.camera_sensor, CameraModel):
            bracket = _by_exposure(bracket, sheet.exposures_s, shown.file)
        brackets.append(tuple(path for _, path in bracket))
    expected = step * len(sheet.shown)
    if len(files) != expected:
        raise CaptureError(
            f"{folder}: has {len(files)} pictures; {sheet.folder} has {len(sheet.shown)} patterns "
            f"of {step} exposures, which need {expected}",
            remedy="Check that the first and the last picture are present, and that no picture "
            "is doubled or from another series",
        )
    return brackets, notes


def _check_markers(light: Float, folder: Path) -> None:
    """Check that a series begins with marker and complement, and ends with the complement."""
    marker, complement, last = light[[0, 1, -1]]
    if np.linalg.norm(complement - last) < SAME_MARKER * np.linalg.norm(marker - last):
        return
    if correlation(complement, last) > MOVED > correlation(marker, last):
        norm = max(float(np.linalg.norm(complement)), 1e-9)
        change = float(np.linalg.norm(complement - last) / norm)
        raise CaptureError(
            f"{folder}: {moved_fault(change).text}. The second and the last picture, which show "
            "the same pattern, differ. Then take the pictures again"
        )
    raise CaptureError(
        f"{folder}: the series doesn't begin with the marker and its complement, or doesn't end "
        "with the complement: a picture is out of order, or belongs to another series",
        remedy="Check the files' names, which are sorted by their numbers",
    )


def _read(
    rig: OfflineRig, brackets: list[tuple[Path, ...]]
) -> tuple[Float, list[NDArray[np.float32]]]:
    """Merge the pictures to light on the rays, (K, H, W), and sample photosites of each frame."""
    shape = rig.sensor.frame_shape(rig.camera_shape, rig.channels)
    level = rig.camera_sensor.black_level_counts
    merge = rig.sensor.bracket_merge(np.full(shape, level, np.float32))
    light, frames = [], []
    for paths in brackets:
        bracket = np.stack([_pixels(rig, path) for path in paths])
        light.append(merge(bracket.reshape(1, *shape)).radiance.sum(axis=-1))
        frames.append(thinned(bracket))
    picture_shape = RayDomain(rig.camera_shape).picture_shape
    return np.reshape(light, (len(light), *picture_shape)), frames


def _checked_header(rig: OfflineRig, path: Path) -> Header:
    """Read a picture's header; check kind, size and channels against the camera's settings."""
    header = read_header(path)
    is_counts = isinstance(rig.camera_sensor, CameraModel)
    if header.kind != ("counts" if is_counts else "light"):
        raise CaptureError(
            f"{path}: has {header.kind}, but the settings' camera is "
            f"{'a camera of counts' if is_counts else 'null, exact radiance'}. Give "
            + ("TIFF, PNG or raw files, or" if is_counts else "EXR files of linear light, or")
            + f" set camera to {'null' if is_counts else 'its numbers'}"
        )
    if header.size != rig.picture_shape:
        raise CaptureError(
            f"{path}: is {header.size[0]} x {header.size[1]} pixels (height x width); expected "
            f"{rig.picture_shape[0]} x {rig.picture_shape[1]}",
            remedy="Set the positions of the rays in the picture by offline.calibration, or by "
            "offline.picture_shape and offline.camera_corners",
        )
    if isinstance(rig.camera_sensor, CameraModel):
        check_raw_mosaic(path, header, rig.camera_sensor.bayer)
    channels = 1 if _is_mosaic(rig) else rig.channels
    if header.channels != channels:
        raise CaptureError(
            f"{path}: has {header.channels} channels; expected {channels}",
            remedy="Set the scene's channels, and camera.bayer for a raw file's colour mosaic",
        )
    return header


def _by_exposure(
    bracket: list[PictureFile], exposures: tuple[float, ...], name: str
) -> list[PictureFile]:
    """Sort a bracket by its exposure times, and compare them with the settings."""
    ordered = sorted(bracket, key=lambda picture: picture[0].exposure_s or 0)
    for (header, path), expected in zip(ordered, exposures, strict=False):
        seconds = header.exposure_s or 0
        if abs(seconds - expected) > EXPOSURE_ERROR * expected:
            times = ", ".join(f"{picture.exposure_s:g}" for picture, _ in ordered)
            expected_times = ", ".join(f"{exposure:g}" for exposure in exposures)
            raise CaptureError(
                f"{path}: was exposed for {seconds:g} s; the bracket of {name} ({times} s) should "
                f"have {expected_times} s, the setting camera.exposures",
                remedy="Check whether a picture before it is missing or doubled",
            )
    return ordered


def _exposure_faults(rig: OfflineRig, files: dict[Key, tuple[Path, ...]]) -> list[str]:
    """Find wrong bit depths, saturated pictures and missing light."""
    sensor = rig.camera_sensor
    if not isinstance(sensor, CameraModel):
        return []
    faults, top = [], SATURATION_FRACTION * sensor.white_level
    if sensor.bits > 8:
        counts = reduce(np.union1d, (_pixels(rig, bracket[-1]) for bracket in files.values()))
        step = np.gcd.reduce(np.diff(counts)) if len(counts) > 16 else 0  # too few are no evidence
        if counts[-1] <= 255 <= sensor.white_level >> 6 or step > sensor.white_level >> 8:
            faults.append(
                f"the pictures have counts of 8 bits, but camera.bits is {sensor.bits}. Save "
                "pictures of 16 bits, linear and not developed, or set camera.bits and "
                "black_level_counts"
            )
    shortest = [bracket[0] for bracket in files.values()]
    saturated = [
        path.name for path in shortest if (_pixels(rig, path) >= top).mean() > MOST_SATURATED
    ]
    if saturated:
        more = f" and {len(saturated) - 1} more" if len(saturated) > 1 else ""
        faults.append(
            f"{saturated[0]}{more}: more than {MOST_SATURATED:.0%} of the pixels are saturated in "
            f"the shortest exposure, {sensor.exposures[0]:g} s: add a shorter one, or dim the "
            "projector"
        )
    white, black = (FLOODLIT_KEY, 0), (BLACK_LEVEL_KEY, 0)
    if white in files and black in files:
        lit, dark = (_pixels(rig, files[key][-1]).mean() for key in (white, black))
        if lit - dark < LEAST_LIGHT * sensor.white_level:
            faults.append(
                f"the white picture's longest exposure has {lit - dark:.1f} counts of light on "
                "average: check lens cap and projector, or take longer exposures"
            )
    return faults


@lru_cache(maxsize=8)
def _pixels(rig: OfflineRig, path: Path) -> NDArray[Any]:
    """Read a picture as a frame of the rig's camera, (H, W, C), or (H, W) of a mosaic."""
    pixels, sensor = read_picture(path).pixels, rig.camera_sensor
    if isinstance(sensor, CameraModel):
        if (largest := int(pixels.max(initial=0))) > sensor.white_level:
            raise CaptureError(
                f"{path}: has {largest} counts; full scale of camera.bits {sensor.bits} is "
                f"{sensor.white_level}",
                remedy="Set camera.bits to the bits of the file, which are 16 if counts are "
                "shifted to 16 bits, and camera.black_level_counts accordingly",
            )
        pixels = pixels.astype(np.uint16, copy=False)  # camera.bits is at most 16
    elif not np.isfinite(pixels).all():
        raise CaptureError(f"{path}: has NaN or infinity; light is finite", remedy="Take it again")
    return pixels[..., 0] if _is_mosaic(rig) else pixels


def _is_mosaic(rig: OfflineRig) -> bool:
    return rig.camera_sensor.bayer is not None
