"""Offline rigs: patterns are written as a sheet of pictures, and brackets are read from files."""

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

from rfpipe.array_types import Float
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


MANIFEST = "patterns.json"
"""Manifest in the folder of a sheet."""

PICTURES = "pictures"
"""Folder in the folder of a sheet for the camera's pictures."""

RUN_PATHS = ("settings", "results")
"""Keys of the paths of the run's settings file and of its results' folder."""

_NAMES = {
    BLACK_LEVEL_KEY: "black",
    FLOODLIT_KEY: "white",
    SYMMETRY_KEY: "random",
    VERIFICATION_KEY: "verification",
}


class OfflineRig:
    """A projector and a camera that exchange files of pictures with rfpipe.

    Parameters
    ----------
    sensor : Sensor
    camera_shape, projector_shape : tuple of int
        Ray domains.
    channels : int
    layout : ProjectorLayout, optional
        Positions of the rays on the projector. None: each pixel is a ray.
    resampling : Resampling, optional
        Weights of camera pixels in each ray. None: each pixel is a ray.

    Attributes
    ----------
    bracket : callable or None
        ``bracket(key, pattern)`` returns the frames of a pattern, or None if there are no pictures
        of it; CaptureError if the pictures of this key show another pattern.

    Raises
    ------
    InputError
        When the shapes of the parts differ.
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
                    f"the {name} has {part.shape} rays, but the scene's settings have {shape}",
                    remedy="Set them to those of the calibration",
                )
        self.camera_sensor = sensor
        self.sensor = resampled_sensor(sensor, resampling)
        self.picture_shape = RayDomain(self.camera_shape).picture_shape
        if resampling is not None:
            self.picture_shape = resampling.camera_shape

    def capture(self, patterns: Float, keys: Sequence[Key]) -> NDArray[Any]:
        """Read the brackets of patterns; see `rfpipe.rigs.Rig.capture`.

        PicturesNeeded if there are no pictures of a pattern yet.
        """
        patterns = check_patterns(patterns, keys, self.projector_shape)
        shape = self.sensor.frame_shape(self.camera_shape, self.channels)
        frames = np.empty((len(patterns), *shape), self.sensor.frame_dtype)
        for index, (pattern, key) in enumerate(zip(patterns, keys, strict=True)):
            bracket = self.bracket and self.bracket(tuple(key), pattern)
            if bracket is None:
                raise PicturesNeeded(
                    f"the exposures of {picture_name(key)} are missing: write the patterns by "
                    "'rfpipe patterns', take the pictures, and read them by 'rfpipe import'"
                )
            frames[index] = bracket.reshape(shape)
        return frames

    def picture(self, pattern: Float) -> Float:
        """Convert a pattern to the projector's picture, (Hp, Wp); views are stacked vertically."""
        if self.layout is not None:
            return self.layout.picture(pattern)
        return np.reshape(pattern, RayDomain(self.projector_shape).picture_shape)

    def weights(self, picture: NDArray[Any]) -> Float:
        """Codes of the rays as fractions of 255, from a written `picture` (Hp, Wp, C)."""
        codes = np.asarray(picture[..., 0] / 255, np.float32)
        if self.layout is None:
            return codes
        weights = np.zeros(prod(self.projector_shape) + 1, np.float32)
        weights[self.layout.ray_of_pixel] = codes  # DARK is the last index
        return weights[:-1].reshape(RayDomain(self.projector_shape).picture_shape)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints and manifests: everything that affects a frame."""
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
    """Create the offline rig of a run's settings.

    InputError when calibration, corners and shapes are inconsistent, StoreError when the
    calibration can't be read.
    """
    layout = resampling = None
    if config.calibration is not None:
        known = load_calibration(Path(config.calibration))
        layout, resampling = known.layout, known.resampling
    if layout is None and config.projector_shape is not None:
        layout = ProjectorLayout.grid(config.projector_shape, projector_shape)
    if resampling is None and config.camera_corners is not None:
        assert config.picture_shape is not None  # validated by the model of the settings
        resampling = _within(config.camera_corners, camera_shape, config.picture_shape)
    return OfflineRig(
        sensor_from_config(camera), camera_shape, projector_shape, channels, layout, resampling
    )


def _within(corners: Any, shape: tuple[int, ...], picture_shape: tuple[int, int]) -> Resampling:
    """Create the resampling that averages the camera pixels whose centres lie on a ray."""
    from scipy.sparse import csr_array

    from rfpipe.photometry.resampling import Resampling, normalised

    layout = ProjectorLayout.within(corners, shape, picture_shape)
    ray, count = layout.ray_of_pixel.ravel(), layout.pixels_of_ray
    if not count.all():
        raise InputError(
            f"offline.camera_corners: {np.count_nonzero(count == 0)} of {prod(shape)} rays have "
            f"no pixel in pictures of {picture_shape}",
            remedy="check the corners, or take a smaller shape",
        )
    pixels, matrix_shape = np.flatnonzero(ray != DARK), (prod(shape), prod(picture_shape))
    ones = csr_array((np.ones(len(pixels)), (ray[pixels], pixels)), shape=matrix_shape)
    return Resampling(shape, picture_shape, normalised(ones))


class SheetPicture(BaseModel):
    """A picture of a sheet.

    Attributes
    ----------
    file : str
    key : tuple of int or None
        Key of the pattern, None for a marker.
    pattern : str
        Fingerprint of the pattern.
    """

    model_config = ConfigDict(frozen=True)

    file: str
    key: Key | None
    pattern: str


class Sheet(BaseModel):
    """A list of pictures to be displayed and captured before an acquisition can continue.

    Attributes
    ----------
    folder : Path
    about : dict
        Plain data: scene, method, level, and the paths of the settings file and of the results'
        folder, relative to the sheet's folder; see `run_paths`.
    exposures_s : tuple of float
        Exposures of each bracket, ascending, in seconds.
    picture_size : (int, int)
        Height and width of the camera's pictures.
    shown : tuple of SheetPicture
        Pictures in the order of display: a marker, its complement, the patterns, the complement.
    """

    model_config = ConfigDict(frozen=True)

    folder: Path
    about: dict[str, Any]
    exposures_s: tuple[float, ...]
    picture_size: tuple[int, int]
    shown: tuple[SheetPicture, ...]


def write_sheet(
    rig: OfflineRig,
    folder: Path,
    patterns: Iterable[tuple[Key, NDArray[np.float32]]],
    description: dict[str, Any],
    gamma: float,
) -> Sheet:
    """Write the pictures of the patterns, and last the manifest.

    The folder is created if necessary, and a different older sheet in it is replaced.

    Parameters
    ----------
    rig : OfflineRig
    folder : Path
    patterns : iterable of (key, pattern)
    description : dict
        Scene, method, level and paths; `Sheet.about`.
    gamma : float
        Gamma of the projector.

    Raises
    ------
    InputError
        When the folder has camera pictures of other patterns.
    StoreError
        When it can't be written.
    """
    # checkerboard of two by two fields
    height, width = rig.projector_shape[-2:]
    row, column = np.indices(rig.projector_shape)[-2:]
    marker = ((2 * row // height + 2 * column // width) % 2 == 0).astype(np.float32)
    complement = ("marker", None, 1 - marker)
    displayed: list[tuple[str, Key | None, Float]] = [("marker", None, marker), complement]
    displayed += [
        (_NAMES.get(key[0], "pattern"), key, np.asarray(pattern, np.float32))
        for key, pattern in patterns
    ]
    displayed.append(complement)
    sheet = Sheet(
        folder=folder,
        about=description,
        exposures_s=rig.camera_sensor.exposures,
        picture_size=rig.picture_shape,
        shown=tuple(
            SheetPicture(file=f"{index:04d}_{name}.png", key=key, pattern=fingerprint(pattern))
            for index, (name, key, pattern) in enumerate(displayed)
        ),
    )
    pictures = folder / PICTURES
    if (folder / MANIFEST).exists():
        is_complete = all((folder / picture.file).is_file() for picture in sheet.shown)
        if is_complete and _is_same(read_sheet(folder), sheet):
            _write_manifest(sheet)  # paths of the run may have changed
            return sheet
        if pictures.is_dir() and any(pictures.iterdir()):
            raise InputError(
                f"{pictures}: has pictures of previous patterns, which changed with the settings "
                "or the code",
                remedy="move them to another folder, then write the patterns again",
            )
    _clear(folder)
    for picture, (_, _, pattern) in zip(sheet.shown, displayed, strict=True):
        write_code_picture(folder / picture.file, rig.picture(pattern), gamma)
    _write_manifest(sheet)
    return sheet


def _clear(folder: Path) -> None:
    """Create a sheet's folder, or remove an older sheet from it; StoreError if that fails."""
    with storage_errors(folder, "making the sheet's folder", resumes=False):
        (folder / PICTURES).mkdir(parents=True, exist_ok=True)
        (folder / MANIFEST).unlink(missing_ok=True)
        for old in folder.glob("[0-9]*_*.png"):
            old.unlink()


def later_sheets(sheet: Sheet) -> list[Sheet]:
    """Read the sheets of later levels of the same acquisition, from the same parent folder."""
    folders = [path.parent for path in sheet.folder.absolute().parent.glob(f"*/{MANIFEST}")]
    sheets = [read_sheet(sheet.folder.parent / folder.name) for folder in sorted(folders)]
    level, names = sheet.about["level"], ("scene", "method", *RUN_PATHS)
    return [
        later
        for later in sheets
        if later.about["level"] > level
        and all(later.about[name] == sheet.about[name] for name in names)
    ]


def remove_sheet(sheet: Sheet) -> bool:
    """Remove a sheet and its folder, unless it has camera pictures; return whether it was removed.

    StoreError if that fails.
    """
    pictures = sheet.folder / PICTURES
    if pictures.is_dir() and any(pictures.iterdir()):
        return False
    _clear(sheet.folder)
    with suppress(OSError):  # a folder with other files is kept
        pictures.rmdir()
        sheet.folder.rmdir()
    return True


def _is_same(previous: Sheet, sheet: Sheet) -> bool:
    """Test whether sheets are equal except for the paths of their run."""
    paths = {name: sheet.about[name] for name in RUN_PATHS}
    return previous.model_copy(update={"about": previous.about | paths}) == sheet


def _write_manifest(sheet: Sheet) -> None:
    write_manifest(sheet.folder / MANIFEST, sheet.model_dump(mode="json", exclude={"folder"}))


def relative_to_sheet(path: Path, folder: Path) -> str:
    """Path of a run's file or folder relative to a sheet's folder.

    Sheet and run can be copied or moved together. InputError if they are on different drives, which
    have no relative path.
    """
    try:
        return Path(os.path.relpath(path.absolute(), folder.absolute())).as_posix()
    except ValueError as error:
        raise InputError(
            f"{folder}: {error}", remedy=f"write the patterns to the drive of {path}"
        ) from None


def run_paths(sheet: Sheet) -> tuple[Path, Path]:
    """Absolute paths of the settings file and of the results' folder of a sheet's run.

    Raises
    ------
    InputError
        If one of them doesn't exist, or the sheet has an absolute path, which would belong to
        another run after a copy.
    """
    remedy = "write the patterns again with 'rfpipe patterns', which keeps their pictures"
    paths = []
    for name, exists in zip(RUN_PATHS, (Path.is_file, Path.is_dir), strict=True):
        path = sheet.about[name]
        if PurePosixPath(path).is_absolute() or PureWindowsPath(path).is_absolute():
            raise InputError(
                f"{sheet.folder / MANIFEST}: has the absolute path {path} of the {name}, which may "
                f"belong to another run; {remedy}"
            )
        place = Path(os.path.normpath(sheet.folder.absolute() / path))
        if not exists(place):
            raise InputError(
                f"{sheet.folder / MANIFEST}: the run's {name} at {path}, relative to the sheet's "
                f"folder, is missing: {place} doesn't exist",
                remedy=f"Copy or move sheet and run together, or {remedy}",
            )
        paths.append(place)
    return paths[0], paths[1]


def read_sheet(folder: Path) -> Sheet:
    """Read a sheet; InputError if there is none, IntegrityError if it is damaged."""
    if not (folder / MANIFEST).is_file():
        raise InputError(
            f"{folder}: has no {MANIFEST}",
            remedy="give the folder that 'rfpipe patterns' wrote, and put the camera's pictures "
            "into its folder 'pictures', or give theirs by --pictures",
        )
    return Sheet.model_validate({**read_manifest(folder / MANIFEST), "folder": folder})
