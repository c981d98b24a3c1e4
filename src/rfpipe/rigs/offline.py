"""Rigs without a cable: a sheet of pictures goes out, and brackets come back as pictures."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from math import prod
from pathlib import Path, PurePosixPath, PureWindowsPath
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError, PicturesNeeded
from rfpipe.output import storage_errors
from rfpipe.photometry.camera import sensor_from_config
from rfpipe.photometry.sensor import Sensor
from rfpipe.pictures import write_code_picture
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key, check_patterns
from rfpipe.rigs.calibrated import load_calibration, resampled_sensor
from rfpipe.rigs.layout import DARK, ProjectorLayout
from rfpipe.store import read_manifest, write_manifest
from rfpipe.units import (
    BLACK_LEVEL_KEY,
    FLOODLIT_KEY,
    SYMMETRY_KEY,
    VERIFICATION_KEY,
    picture_name,
)

if TYPE_CHECKING:
    from rfpipe.config import CameraConfig, OfflineConfig
    from rfpipe.photometry.resampling import Resampling

Float = NDArray[np.float32]

MANIFEST = "patterns.json"
"""Beside the pictures that it names."""

PICTURES = "pictures"
"""Folder beside a sheet's patterns for what is taken of them."""

RUN_PATHS = ("settings", "results")
"""Keys of a sheet's paths: of the run's settings file and of its results' folder."""

_NAMES = {
    BLACK_LEVEL_KEY: "black",
    FLOODLIT_KEY: "white",
    SYMMETRY_KEY: "random",
    VERIFICATION_KEY: "verification",
}


class OfflineRig:
    """A projector and a camera at the other end of a folder of pictures.

    `layout` says where the rays lie on the projector, `resampling` how the camera's pictures become
    images on its rays; without them each pixel is a ray. InputError where the parts don't fit.

    Attributes
    ----------
    bracket : callable or None
        ``bracket(key, pattern)`` returns the frames of a pattern, or None where it wasn't taken;
        CaptureError where those of this key are of another pattern.
    """

    seconds_per_pattern = 0.0

    def __init__(
        self,
        sensor: Sensor,
        camera_shape: tuple[int, ...],
        projector_shape: tuple[int, ...],
        channels: int,
        layout: ProjectorLayout | None = None,
        resampling: Resampling | None = None,
    ) -> None:
        self.camera_shape, self.projector_shape = tuple(camera_shape), tuple(projector_shape)
        self.channels, self.layout = channels, layout
        self.bracket: Callable[[Key, Float], NDArray[Any] | None] | None = None
        for name, part, shape in (
            ("layout", layout, self.projector_shape),
            ("resampling", resampling, self.camera_shape),
        ):
            if part is not None and part.shape != shape:
                raise InputError(
                    f"the {name} is of {part.shape} rays; the scene's settings say {shape}. Set "
                    "them to those of the calibration"
                )
        self.camera_sensor = sensor
        self.sensor = resampled_sensor(sensor, resampling)
        self.picture_shape = RayDomain(self.camera_shape).picture_shape
        if resampling is not None:
            self.picture_shape = resampling.camera_shape

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Return the brackets that were taken of patterns; see `rfpipe.rigs.Rig.capture`.

        PicturesNeeded where those of some pattern are still to be taken.
        """
        patterns = check_patterns(patterns, keys, self.projector_shape)
        shape = self.sensor.frame_shape(self.camera_shape, self.channels)
        frames = np.empty((len(patterns), *shape), self.sensor.frame_dtype)
        for index, (pattern, key) in enumerate(zip(patterns, keys, strict=True)):
            taken = self.bracket and self.bracket(tuple(key), pattern)
            if taken is None:
                raise PicturesNeeded(
                    f"the exposures of {picture_name(key)} are still to be taken: 'rfpipe "
                    "patterns' writes what to show, 'rfpipe import' reads what was taken"
                )
            frames[index] = taken.reshape(shape)
        return frames

    def picture(self, pattern: Float) -> Float:
        """Return the projector's picture of a pattern, (Hp, Wp): views one above the other."""
        if self.layout is not None:
            return self.layout.picture(pattern)
        return np.reshape(pattern, RayDomain(self.projector_shape).picture_shape)

    def weights(self, picture: NDArray[Any]) -> Float:
        """Return the rays' share of full code, 0 to 1, in a `picture` that was written."""
        codes = np.asarray(picture[..., 0] / 255, np.float32)
        if self.layout is None:
            return codes
        found = np.zeros(prod(self.projector_shape) + 1, np.float32)
        found[self.layout.ray_of_pixel] = codes  # DARK is the last index
        return found[:-1].reshape(RayDomain(self.projector_shape).picture_shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: all that shapes a frame."""
        return {
            "kind": "offline",
            "layout": None if self.layout is None else self.layout.describe(),
            "camera_shape": list(self.camera_shape),
            "projector_shape": list(self.projector_shape),
            "channels": self.channels,
            "sensor": self.sensor.describe(),
        }


def offline_rig(
    config: OfflineConfig,
    camera: CameraConfig | None,
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    channels: int,
) -> OfflineRig:
    """Return the offline rig of a run's settings.

    InputError where calibration, corners and shapes don't fit together, StoreError where the
    calibration can't be read.
    """
    layout = resampling = None
    if config.calibration is not None:
        known = load_calibration(Path(config.calibration))
        layout, resampling = known.layout, known.resampling
    if layout is None and config.projector_shape is not None:
        layout = ProjectorLayout.grid(config.projector_shape, projector_shape)
    if resampling is None and config.camera_corners is not None:
        assert config.picture_shape is not None  # the settings' model sees to it
        resampling = _within(config.camera_corners, camera_shape, config.picture_shape)
    return OfflineRig(
        sensor_from_config(camera), camera_shape, projector_shape, channels, layout, resampling
    )


def _within(corners: Any, shape: tuple[int, ...], picture_shape: tuple[int, int]) -> Resampling:
    """Return the resampling to means of the camera's pixels whose middles lie on a ray."""
    from scipy.sparse import csr_array

    from rfpipe.photometry.resampling import Resampling, normalised

    layout = ProjectorLayout.within(corners, shape, picture_shape)
    ray, count = layout.ray_of_pixel.ravel(), layout.pixels_of_ray
    if not count.all():
        raise InputError(
            f"offline.camera_corners: {np.count_nonzero(count == 0)} of {prod(shape)} rays have no "
            f"pixel in pictures of {picture_shape}; check the corners, or take a smaller shape"
        )
    pixels, whole = np.flatnonzero(ray != DARK), (prod(shape), prod(picture_shape))
    ones = csr_array((np.ones(len(pixels)), (ray[pixels], pixels)), shape=whole)
    return Resampling(shape, picture_shape, normalised(ones))


class Shown(BaseModel):
    """A picture to show: its file, its pattern's key (None: a marker), its fingerprint."""

    model_config = ConfigDict(frozen=True)

    file: str
    key: Key | None
    pattern: str


class Sheet(BaseModel):
    """All that is to be shown before an acquisition can go on.

    Attributes
    ----------
    folder : Path
    about : dict
        Plain data: scene, method, level, and the paths of the settings file and of the results'
        folder, relative to the sheet's folder; see `run_paths`.
    exposures_s : tuple of float
        Of each bracket, ascending, in seconds.
    picture_size : (int, int)
        Height and width of the pictures to be taken.
    shown : tuple of Shown
        In the order of showing: a marker and its opposite, the patterns, the opposite again.
    """

    model_config = ConfigDict(frozen=True)

    folder: Path
    about: dict[str, Any]
    exposures_s: tuple[float, ...]
    picture_size: tuple[int, int]
    shown: tuple[Shown, ...]


def write_sheet(
    rig: OfflineRig,
    folder: Path,
    asked: Iterable[tuple[Key, NDArray[np.float32]]],
    about: dict[str, Any],
    gamma: float,
) -> Sheet:
    """Write the pictures of patterns that are asked for, and last the manifest.

    The folder is made where it isn't there, and an older sheet in it replaced, unless it is the
    same; `gamma` is the projector's. InputError where the folder holds pictures of other patterns
    already, StoreError where it can't be written.
    """
    # two by two fields of light and dark
    height, width = rig.projector_shape[-2:]
    row, column = np.indices(rig.projector_shape)[-2:]
    marker = ((2 * row // height + 2 * column // width) % 2 == 0).astype(np.float32)
    opposite = ("marker", None, 1 - marker)
    patterns: list[tuple[str, Key | None, Float]] = [("marker", None, marker), opposite]
    patterns += [
        (_NAMES.get(key[0], "pattern"), key, np.asarray(each, np.float32)) for key, each in asked
    ]
    patterns.append(opposite)
    sheet = Sheet(
        folder=folder,
        about=about,
        exposures_s=rig.camera_sensor.exposures,
        picture_size=rig.picture_shape,
        shown=tuple(
            Shown(file=f"{index:04d}_{name}.png", key=key, pattern=fingerprint(pattern))
            for index, (name, key, pattern) in enumerate(patterns)
        ),
    )
    pictures = folder / PICTURES
    if (folder / MANIFEST).exists():
        is_whole = all((folder / each.file).is_file() for each in sheet.shown)
        if is_whole and _is_same(read_sheet(folder), sheet):
            _write_manifest(sheet)  # the run may lie elsewhere now
            return sheet
        if pictures.is_dir() and any(pictures.iterdir()):
            raise InputError(
                f"{pictures}: holds pictures of patterns that aren't asked for any more, since "
                "settings or code changed; move them away, then write the patterns again"
            )
    _clear(folder)
    for each, (_, _, pattern) in zip(sheet.shown, patterns, strict=True):
        write_code_picture(folder / each.file, rig.picture(pattern), gamma)
    _write_manifest(sheet)
    return sheet


def _clear(folder: Path) -> None:
    """Make a sheet's folder, or remove an older sheet from it; StoreError where that fails."""
    with storage_errors(folder, "making the sheet's folder", resumes=False):
        (folder / PICTURES).mkdir(parents=True, exist_ok=True)
        (folder / MANIFEST).unlink(missing_ok=True)
        for old in folder.glob("[0-9]*_*.png"):
            old.unlink()


def later_sheets(sheet: Sheet) -> list[Sheet]:
    """Sheets beside a sheet of the same acquisition's later levels."""
    beside = [path.parent for path in sheet.folder.absolute().parent.glob(f"*/{MANIFEST}")]
    sheets = [read_sheet(sheet.folder.parent / folder.name) for folder in sorted(beside)]
    level, names = sheet.about["level"], ("scene", "method", *RUN_PATHS)
    return [
        later
        for later in sheets
        if later.about["level"] > level
        and all(later.about[name] == sheet.about[name] for name in names)
    ]


def remove_sheet(sheet: Sheet) -> bool:
    """Remove a sheet and its folder, unless pictures were taken of it; return whether it is gone.

    StoreError where it can't be removed.
    """
    pictures = sheet.folder / PICTURES
    if pictures.is_dir() and any(pictures.iterdir()):
        return False
    _clear(sheet.folder)
    with suppress(OSError):  # files that aren't the sheet's stay, in their folder
        pictures.rmdir()
        sheet.folder.rmdir()
    return True


def _is_same(previous: Sheet, sheet: Sheet) -> bool:
    """Test whether sheets differ at most in the paths of their run."""
    paths = {name: sheet.about[name] for name in RUN_PATHS}
    return previous.model_copy(update={"about": previous.about | paths}) == sheet


def _write_manifest(sheet: Sheet) -> None:
    write_manifest(sheet.folder / MANIFEST, sheet.model_dump(mode="json", exclude={"folder"}))


def relative_to_sheet(path: Path, folder: Path) -> str:
    """Path of a file or folder of a run as the run's sheet in a folder has it: relative to it.

    Sheet and run can then be copied or renamed together. Raises InputError if they lie on
    different drives, between which there is no relative path.
    """
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError as error:
        raise InputError(f"{folder}: {error}; write the patterns to the drive of {path}") from None


def run_paths(sheet: Sheet) -> tuple[Path, Path]:
    """Absolute paths of the settings file and of the results' folder of a sheet's run.

    Raises
    ------
    InputError
        If one of them is not there, or the sheet has an absolute path, as sheets of early versions
        do: it would be that of another run where this one is a copy.
    """
    again = "write the patterns again with 'rfpipe patterns', which keeps their pictures"
    paths = []
    for name, is_there in zip(RUN_PATHS, (Path.is_file, Path.is_dir), strict=True):
        path = sheet.about[name]
        if PurePosixPath(path).is_absolute() or PureWindowsPath(path).is_absolute():
            raise InputError(
                f"{sheet.folder / MANIFEST}: has the absolute path {path} of the {name}, which are "
                f"another run's where this one was copied; {again}"
            )
        place = Path(os.path.normpath(sheet.folder.absolute() / path))
        if not is_there(place):
            raise InputError(
                f"{sheet.folder / MANIFEST}: the run's {name} should be at {path}, relative to the "
                f"sheet's folder, but {place} is not there. Copy or move sheet and run together, "
                f"or {again}"
            )
        paths.append(place)
    return paths[0], paths[1]


def read_sheet(folder: Path) -> Sheet:
    """Read a sheet; InputError where there is none, IntegrityError where it is damaged."""
    if not (folder / MANIFEST).is_file():
        raise InputError(
            f"{folder}: holds no {MANIFEST}; give the folder that 'rfpipe patterns' wrote, with "
            "the pictures taken in its folder 'pictures', or named by --pictures"
        )
    return Sheet.model_validate({**read_manifest(folder / MANIFEST), "folder": folder})
