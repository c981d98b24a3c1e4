"""Pictures as brackets of the patterns that they were to show: checked before any is used."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.keys import BLACK_LEVEL_KEY, FLOODLIT_KEY
from rfpipe.photometry.camera import CameraModel
from rfpipe.pictures import Header, picture_files, read_header, read_picture
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key
from rfpipe.rigs.offline.markers import first_bracket
from rfpipe.rigs.offline.rig import OfflineRig
from rfpipe.rigs.offline.sheet import Sheet
from rfpipe.units import SATURATION_FRACTION

__all__ = ["Checked", "check_pictures"]

# By so much of it an exposure time may differ from the one set: cameras round 1/64 s to 1/60.
_EXPOSURE_ERROR = 0.1
# Of the floodlit picture, what may be saturated in the shortest exposure, and the least that its
# longest one has to be above the black one, of full scale.
_MOST_SATURATED, _LEAST_LIGHT = 0.01, 0.002
_KEPT_PICTURES = 8


@dataclass(frozen=True, eq=False)
class Checked:
    """Pictures that fit what was to be shown; an `rfpipe.rigs.offline.Brackets`.

    Attributes
    ----------
    rig : OfflineRig
    files : dict
        The files of each pattern's bracket, by exposure, ascending.
    patterns : dict
        Fingerprints of the patterns, by key.
    notes : list of str
        What is to be known of them, but no reason to refuse them.
    """

    rig: OfflineRig
    files: dict[Key, tuple[Path, ...]]
    patterns: dict[Key, str]
    notes: list[str] = field(default_factory=list)

    def bracket(self, key: Key, pattern: NDArray[np.float32]) -> NDArray[Any] | None:
        """Return a pattern's frames; see `rfpipe.rigs.offline.Brackets`."""
        if key not in self.files:
            return None
        if self.patterns[key] != fingerprint(np.asarray(pattern, np.float32)):
            raise CaptureError(
                f"{self.files[key][0]}: shows another pattern {key} than is asked for now, since "
                "settings or code changed. Write the patterns anew with 'rfpipe patterns', and "
                "take them"
            )
        return np.stack([_pixels(self.rig, path) for path in self.files[key]])


def check_pictures(rig: OfflineRig, sheet: Sheet, folder: Path, *, anyway: bool = False) -> Checked:
    """Check pictures against what was to be shown, and put them in order.

    Parameters
    ----------
    rig : OfflineRig
    sheet : Sheet
    folder : Path
        Of the pictures, whose names sort in the order of taking, a bracket's together.
    anyway : bool
        Whether pictures that are too bright or too dark are taken, too.

    Raises
    ------
    InputError
        When a picture can't be read.
    CaptureError
        When their number, size, channels, bits, exposure times or order is wrong, or the floodlit
        one is saturated or dark: names the picture, and says what to do.
    """
    files = picture_files(folder)
    step = len(sheet.exposures_s)
    expected = step * len(sheet.shown)
    if len(files) < expected or (len(files) > expected and not sheet.has_markers):
        raise CaptureError(
            f"{folder}: holds {len(files)} pictures; {len(sheet.shown)} patterns of {step} "
            f"exposures each make {expected}, as {sheet.folder} says. Check that the first and "
            "the last are there, and none twice"
        )
    headers = [_checked_header(rig, path) for path in files]
    first = 0
    if sheet.has_markers:
        firsts = _firsts(rig, headers, sheet, len(files) - expected + 1)
        first = _first(rig, files, expected, step, folder, firsts)
    notes = []
    if len(files) > expected:
        notes.append(f"{len(files) - expected} pictures before or after the markers are left out")
    chosen = range(first, first + expected, step)
    found: dict[Key, tuple[Path, ...]] = {}
    timed = all(header.exposure_s is not None for header in headers[first : first + expected])
    if step > 1 and not timed:
        notes.append(
            "not all pictures say their exposure time: each bracket is taken to go from the "
            "shortest to the longest"
        )
    for start, shown in zip(chosen, sheet.shown, strict=True):
        some = list(zip(headers[start : start + step], files[start : start + step], strict=True))
        if timed and isinstance(rig.camera_sensor, CameraModel):
            some = _by_exposure(some, sheet.exposures_s, shown.file)
        if shown.key is not None:
            found[shown.key] = tuple(path for _, path in some)
    patterns = {shown.key: shown.pattern for shown in sheet.shown if shown.key is not None}
    checked = Checked(rig, found, patterns, notes)
    wrong = _brightness(checked, sheet)
    if wrong and not anyway:
        raise CaptureError(f"{folder}: {'; '.join(wrong)}. To take them all the same: --anyway")
    notes += wrong
    return checked


def _firsts(rig: OfflineRig, headers: list[Header], sheet: Sheet, most: int) -> list[int]:
    """Return the pictures at which the series may begin: with the exposures of a bracket."""
    step = len(sheet.exposures_s)
    found = []
    for first in range(most):
        seconds = [header.exposure_s or 0 for header in headers[first : first + step]]
        following = [header.exposure_s or 0 for header in headers[first + step : first + 2 * step]]
        is_timed = all(seconds) and isinstance(rig.camera_sensor, CameraModel)
        if not is_timed or (
            _are(seconds, sheet.exposures_s) and _are(following, sheet.exposures_s)
        ):
            found.append(first)
    # none: the messages about single brackets tell more
    return found or list(range(most))


def _are(seconds: list[float], exposures: tuple[float, ...]) -> bool:
    """Tell whether exposure times are those of a bracket, in any order."""
    return all(
        abs(found - expected) <= _EXPOSURE_ERROR * expected
        for found, expected in zip(sorted(seconds), exposures, strict=True)
    )


def _first(
    rig: OfflineRig,
    files: list[Path],
    expected: int,
    step: int,
    folder: Path,
    firsts: list[int],
) -> int:
    """Find the series among the pictures by its markers."""

    @lru_cache(maxsize=3 * (len(files) - expected + 1))
    def image(start: int) -> NDArray[Any]:
        frames = (_pixels(rig, path) for path in files[start : start + step])
        light: NDArray[Any] = np.stack([_small(frame) for frame in frames]).sum(axis=0)
        return light

    return first_bracket(image, len(files), expected, step, str(folder), firsts)


def _small(frame: NDArray[Any]) -> NDArray[np.float32]:
    """Return a picture in so many fields as tell a marker, in the mean."""
    rows, columns = frame.shape[:2]
    down, across = max(1, rows // 64), max(1, columns // 64)
    cut = frame[: rows // down * down, : columns // across * across].astype(np.float32)
    fields = cut.reshape(rows // down, down, columns // across, across, -1)
    small: NDArray[np.float32] = fields.mean(axis=(1, 3, 4))
    return small


def _checked_header(rig: OfflineRig, path: Path) -> Header:
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
    bracket: list[tuple[Header, Path]], exposures: tuple[float, ...], name: str
) -> list[tuple[Header, Path]]:
    """Sort a bracket by its exposure times, which have to be those that were set."""
    ordered = sorted(bracket, key=lambda each: each[0].exposure_s or 0)
    for (header, path), expected in zip(ordered, exposures, strict=True):
        found = header.exposure_s or 0
        if abs(found - expected) > _EXPOSURE_ERROR * expected:
            times = ", ".join(f"{each.exposure_s:g}" for each, _ in ordered)
            raise CaptureError(
                f"{path}: was exposed for {found:g} s; the bracket of {name} ({times} s) should "
                f"have {', '.join(f'{each:g}' for each in exposures)} s, as camera.exposures says. "
                "A picture may be missing before it, or be there twice"
            )
    return ordered


def _brightness(checked: Checked, sheet: Sheet) -> list[str]:
    """Say what is wrong with the light of the pictures."""
    sensor = checked.rig.camera_sensor
    if not isinstance(sensor, CameraModel):
        return []
    wrong = []
    top = SATURATION_FRACTION * sensor.white_level
    saturated = [
        sheet_file
        for sheet_file, key in ((each.file, each.key) for each in sheet.shown)
        if key is not None
        and float((_pixels(checked.rig, checked.files[key][0]) >= top).mean()) > _MOST_SATURATED
    ]
    if saturated:
        more = f" and {len(saturated) - 1} more" if len(saturated) > 1 else ""
        wrong.append(
            f"the pictures of {saturated[0]}{more} have over {_MOST_SATURATED:.0%} of their pixels "
            f"saturated in the shortest exposure, {sensor.exposures[0]:g} s: add a shorter one, or "
            "dim the projector"
        )
    white, black = (FLOODLIT_KEY, 0), (BLACK_LEVEL_KEY, 0)
    if white in checked.files and black in checked.files:
        lit, dark = (_pixels(checked.rig, checked.files[key][-1]).mean() for key in (white, black))
        if lit - dark < _LEAST_LIGHT * sensor.white_level:
            wrong.append(
                f"the white picture's longest exposure has {lit - dark:.1f} counts of light on "
                "average: lens cap, projector, or a longer exposure"
            )
    return wrong


@lru_cache(maxsize=_KEPT_PICTURES)
def _pixels(rig: OfflineRig, path: Path) -> NDArray[Any]:
    """Read a picture as a frame of the rig's camera, (H, W, C), or (H, W) of a mosaic."""
    picture = read_picture(path)
    sensor = rig.camera_sensor
    if isinstance(sensor, CameraModel):
        largest = int(picture.pixels.max(initial=0))
        if largest > sensor.white_level:
            raise CaptureError(
                f"{path}: holds {largest} counts; full scale of camera.bits {sensor.bits} is "
                f"{sensor.white_level}. {_advice_on_bits(picture.pixels, sensor)}"
            )
    elif not np.isfinite(picture.pixels).all():
        raise CaptureError(f"{path}: holds NaN or infinity; light is finite. Take it again")
    return picture.pixels[..., 0] if _is_mosaic(rig) else picture.pixels


def _advice_on_bits(pixels: NDArray[Any], sensor: CameraModel) -> str:
    """Say what may have become of counts that are larger than full scale."""
    shift = 16 - sensor.bits
    if not (pixels & np.uint16(2**shift - 1)).any():
        return (
            f"All counts are multiples of {2**shift}: the file has them shifted to 16 bits. Set "
            f"camera.bits to 16, and camera.black_level_counts to {2**shift} times what it is"
        )
    return "Set camera.bits to those of the file"


def _is_mosaic(rig: OfflineRig) -> bool:
    return getattr(rig.camera_sensor, "bayer", None) is not None
