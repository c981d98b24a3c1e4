"""What is to be shown next: pictures for the projector, and a manifest that names them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError, StoreError
from rfpipe.keys import BLACK_LEVEL_KEY, FLOODLIT_KEY, SYMMETRY_KEY
from rfpipe.pictures import write_code_picture
from rfpipe.provenance import fingerprint
from rfpipe.rigs.base import Key
from rfpipe.rigs.offline.rig import OfflineRig
from rfpipe.store import read_manifest, write_manifest

MANIFEST = "patterns.json"
"""Beside the pictures that it names."""

_NAMES = {BLACK_LEVEL_KEY: "black", FLOODLIT_KEY: "white", SYMMETRY_KEY: "random"}


@dataclass(frozen=True)
class Shown:
    """A picture to show, and to take a bracket of.

    Attributes
    ----------
    file : str
        Its name in the folder.
    key : tuple of int, or None
        The pattern's key; None of a marker.
    pattern : str
        Fingerprint of its weights.
    """

    file: str
    key: Key | None
    pattern: str


@dataclass(frozen=True)
class Sheet:
    """All that is to be shown before an acquisition can go on.

    Attributes
    ----------
    folder : Path
    about : dict
        Plain data: settings file, results' folder, scene, method, level.
    exposures_s : tuple of float
        Of each bracket, ascending, in seconds.
    picture_size : (int, int)
        Height and width of the pictures to be taken.
    shown : tuple of Shown
        In the order of showing.
    """

    folder: Path
    about: dict[str, Any]
    exposures_s: tuple[float, ...]
    picture_size: tuple[int, int]
    shown: tuple[Shown, ...]

    @property
    def has_markers(self) -> bool:
        """Whether it begins with a marker and its opposite, and ends with the opposite."""
        return bool(self.shown) and self.shown[0].key is None

    @property
    def patterns(self) -> int:
        """Patterns to show, markers left out."""
        return sum(each.key is not None for each in self.shown)


def write_sheet(
    rig: OfflineRig,
    folder: Path,
    asked: Iterable[tuple[Key, NDArray[np.float32]]],
    about: dict[str, Any],
    *,
    gamma: float,
    markers: bool,
) -> Sheet:
    """Write the pictures of patterns that are asked for, and last the manifest.

    Parameters
    ----------
    rig : OfflineRig
    folder : Path
        Made where it isn't there; an older sheet in it is replaced.
    asked : iterable of (key, pattern)
    about : dict
    gamma : float
        Of the projector.
    markers : bool
        Whether marker frames stand before and after.

    Raises
    ------
    StoreError
        When the folder can't be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / MANIFEST).unlink(missing_ok=True)
        for old in folder.glob("[0-9]*_*.png"):
            old.unlink()
    except OSError as error:
        raise StoreError(f"{folder}: can't be written: {error.strerror}") from error
    shown: list[Shown] = []

    def show(name: str, key: Key | None, pattern: NDArray[np.float32]) -> None:
        file = f"{len(shown):04d}_{name}.png"
        write_code_picture(folder / file, rig.picture(pattern), gamma)
        shown.append(Shown(file, key, fingerprint(pattern)))

    # two by two fields of light and dark
    height, width = rig.projector_shape[-2:]
    row, column = np.indices(rig.projector_shape)[-2:]
    marker = ((2 * row // height + 2 * column // width) % 2 == 0).astype(np.float32)
    if markers:
        show("marker", None, marker)
        show("marker", None, 1 - marker)
    for key, pattern in asked:
        show(_NAMES.get(key[0], "pattern"), key, np.asarray(pattern, np.float32))
    if markers:
        show("marker", None, 1 - marker)
    exposures = tuple(rig.camera_sensor.exposures)
    sheet = Sheet(folder, about, exposures, rig.picture_shape, tuple(shown))
    facts = asdict(sheet)
    del facts["folder"]
    write_manifest(folder / MANIFEST, facts)
    return sheet


def read_sheet(folder: Path) -> Sheet:
    """Read a sheet.

    Raises
    ------
    InputError
        When there is none in the folder.
    IntegrityError
        When its manifest is damaged.
    """
    if not (folder / MANIFEST).is_file():
        raise InputError(
            f"{folder}: holds no {MANIFEST}; give the folder that 'rfpipe patterns' wrote, with "
            "the pictures taken in its folder 'pictures', or named by --pictures"
        )
    facts = read_manifest(folder / MANIFEST)
    shown = tuple(
        Shown(each["file"], each["key"] and tuple(each["key"]), each["pattern"])
        for each in facts["shown"]
    )
    height, width = facts["picture_size"]
    return Sheet(folder, facts["about"], tuple(facts["exposures_s"]), (height, width), shown)
