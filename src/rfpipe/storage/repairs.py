"""Remedies of damaged results: the files to remove, and the command that makes them again."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Literal, NamedTuple

from rfpipe.calibration.steps import STEPS
from rfpipe.rigs.calibrated import FACTS
from rfpipe.storage.base import VERIFICATION_FOLDER, VERIFICATION_MANIFEST
from rfpipe.storage.files import FILES, with_followers
from rfpipe.storage.run_record import RUN_RECORD, rerun_command
from rfpipe.store.places import Place

RECORDING = "matrix.json"
"""Manifest of light that a scene recorded: it names the stores beside it by its key ``pieces``."""

Part = Literal["acquisition", "level", "verification", "calibration", "recording", "report", ""]
"""Part of a run that a folder of manifests is."""

_LEVEL = re.compile(r"L\d\d+")
_PIECE = re.compile(r"(rows|columns)_\d{8}\.zarr")


class Mend(NamedTuple):
    """Remedy of a finding: the workflow, `rfpipe calibrate`, or a copy alone.

    Attributes
    ----------
    how : {"run", "calibrate", "restore"}
    remove : tuple of Path
        Removed first, so that the workflow notices that something is missing.
    cost : str
        Costs beyond some computing.
    """

    how: Literal["run", "calibrate", "restore"]
    remove: tuple[Path, ...] = ()
    cost: str = ""


RESTORE = Mend("restore")


class Finding(NamedTuple):
    """Damage of a store, manifest or file, and its remedy."""

    path: Path | Place
    what: str
    mend: Mend


def is_acquisition(folder: Path) -> bool:
    """Test whether a folder holds an acquisition: a transport's manifest, or levels."""
    return (folder / "transport.json").is_file() or any(map(is_level_name, folder.glob("L*/")))


def is_level_name(folder: Path) -> bool:
    """Test whether a folder is called as a level of an acquisition."""
    return _LEVEL.fullmatch(folder.name) is not None


def part_of(manifest: Path) -> Part:
    """Return the part of a run to which a manifest belongs, by the files around it.

    A scene or method may have any name, also that of a folder of a run: `recorded`, `steps`.
    """
    folder = manifest.parent
    if is_acquisition(folder):
        return "acquisition"
    if is_acquisition(folder.parent):
        if is_level_name(folder):
            return "level"
        if folder.name == VERIFICATION_FOLDER:
            return "verification"
    if manifest.name == RECORDING or any(map(_PIECE.fullmatch, _names(folder))):
        return "recording"
    if manifest.name == FACTS or (folder.name == "steps" and manifest.stem in STEPS):
        return "calibration"
    return "report" if manifest.name == FILES else ""


def _names(folder: Path) -> list[str]:
    return [each.name for each in folder.glob("*.zarr")]


def mend_of(manifest: Path, damaged: Path | None = None) -> Mend:
    """Return the remedy of damage to a manifest, or to a file that it is about."""
    folder, part = manifest.parent, part_of(manifest)
    if part == "calibration":
        return Mend("calibrate", (manifest,), "the step is measured again, with the rig")
    if part == "recording":
        gone = [path for path in (manifest, damaged) if path is not None]
        return Mend("run", tuple(dict.fromkeys(gone)), "light of this scene is recorded again")
    if part == "verification":
        return Mend("run", (manifest, folder.with_name(VERIFICATION_MANIFEST)))
    if part == "report":  # the workflow knows of the page and of the tables
        return Mend("run", (damaged or manifest, folder / "index.html"))
    return _mend_of_level(manifest) if part == "level" else Mend("run", (manifest,))


def _mend_of_level(manifest: Path) -> Mend:
    """Return the remedy of damage to a level of an acquisition."""
    folder, cost = manifest.parent, ""
    gone = tuple(with_followers(manifest))
    if manifest.stem == "capture":
        cost = (
            "what is whole stays; the damaged patterns are shown again, so the scene must stand as "
            "it did"
        )
    elif manifest.stem == "merge" and (folder / "capture.zarr" / "dropped.json").exists():
        gone = tuple(sorted(folder.parent.glob("L*")))
        cost = (
            "the raw exposures were dropped after their merge (capture.keep_raw): ALL patterns are "
            "taken again. A copy of the folder, if there is one, is better"
        )
    return Mend("run", (*gone, folder.with_name("transport.json")), cost)


def command_for(finding: Finding) -> str:
    """Return the shell command that mends a finding; none where only a copy does."""
    if finding.mend.how == "restore":
        return ""
    path = Path(str(finding.path)).absolute()
    if finding.mend.how == "calibrate":
        step = path.parent.name == "steps"
        output = str(path.parents[1] if step else path.parent)
        again = shlex.join(["rfpipe", "calibrate", "RIG.yaml", "--output", output])
    else:
        again = rerun_command(_results_of(path))
    gone = shlex.join(map(str, finding.mend.remove))
    return f"rm -rf {gone} && {again}" if gone else again


def _results_of(path: Path) -> Path:
    """Return the results to which a damaged file belongs: the folder that has `RUN_RECORD`."""
    for folder in path.parents:
        if (folder / RUN_RECORD).is_file() or any(map(is_acquisition, folder.glob("*/*/"))):
            return folder
    return path.parent
