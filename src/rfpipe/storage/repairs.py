"""Repairs of damaged results: the files to remove, and the command that makes them again."""

from __future__ import annotations

import re
import shlex
from pathlib import Path
from typing import Literal, NamedTuple

from rfpipe.calibration.steps import STEPS
from rfpipe.rigs.calibrated import FACTS
from rfpipe.storage.base import VERIFICATION_FOLDER, VERIFICATION_MANIFEST
from rfpipe.storage.damage import with_followers
from rfpipe.storage.results import FILES
from rfpipe.storage.run_record import RUN_RECORD, rerun_command
from rfpipe.store.places import Place

RECORDING = "matrix.json"
"""Manifest of recorded light of a scene; its key ``pieces`` has the names of the stores."""

RunPart = Literal["acquisition", "level", "verification", "calibration", "recording", "report", ""]
"""Part of a run to which a manifest belongs."""

_LEVEL = re.compile(r"L\d\d+")
_PIECE = re.compile(r"(rows|columns)_\d{8}\.zarr")


class Repair(NamedTuple):
    """Repair of damaged results.

    Attributes
    ----------
    means : {"run", "calibrate", "restore"}
        The workflow, `rfpipe calibrate`, or a backup copy only.
    remove : tuple of Path
        Files to remove first, so that the workflow makes them again.
    cost : str
        Cost beyond computing time.
    """

    means: Literal["run", "calibrate", "restore"]
    remove: tuple[Path, ...] = ()
    cost: str = ""


RESTORE = Repair("restore")


class Finding(NamedTuple):
    """Damage of a store, manifest or file, and its repair."""

    path: Path | Place
    what: str
    repair: Repair


def is_acquisition(folder: Path) -> bool:
    """Test whether a folder has an acquisition: a transport's manifest, or levels."""
    return (folder / "transport.json").is_file() or any(map(is_level_name, folder.glob("L*/")))


def is_level_name(folder: Path) -> bool:
    """Test whether a folder has the name of a level of an acquisition."""
    return _LEVEL.fullmatch(folder.name) is not None


def part_of(manifest: Path) -> RunPart:
    """Return the part of a run to which a manifest belongs, by the files around it.

    Names don't suffice: a scene or method may have the name of a run's folder, such as `steps`.
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
    return [store.name for store in folder.glob("*.zarr")]


def repair_of(manifest: Path, damaged: Path | None = None) -> Repair:
    """Return the repair of a damaged manifest, or of a damaged file that it describes."""
    folder, part = manifest.parent, part_of(manifest)
    if part == "calibration":
        return Repair("calibrate", (manifest,), "the step is measured again, with the rig")
    if part == "recording":
        paths = [path for path in (manifest, damaged) if path is not None]
        return Repair("run", tuple(dict.fromkeys(paths)), "light of this scene is recorded again")
    if part == "verification":
        return Repair("run", (manifest, folder.with_name(VERIFICATION_MANIFEST)))
    if part == "report":  # the workflow's outputs are the page and the tables
        return Repair("run", (damaged or manifest, folder / "index.html"))
    return _repair_of_level(manifest) if part == "level" else Repair("run", (manifest,))


def _repair_of_level(manifest: Path) -> Repair:
    """Return the repair of a damaged level of an acquisition."""
    folder, cost = manifest.parent, ""
    removed = tuple(with_followers(manifest))
    if manifest.stem == "capture":
        cost = (
            "undamaged pictures are kept; the damaged patterns are captured again, so the scene "
            "must be as it was"
        )
    elif manifest.stem == "merge" and (folder / "capture.zarr" / "dropped.json").exists():
        removed = tuple(sorted(folder.parent.glob("L*")))
        cost = (
            "the brackets were dropped after their merge (capture.keep_raw): ALL patterns are "
            "captured again. A copy of the folder, if there is one, is better"
        )
    return Repair("run", (*removed, folder.with_name("transport.json")), cost)


def command_for(finding: Finding) -> str:
    """Return the shell command that repairs a finding; "" if only a copy does."""
    if finding.repair.means == "restore":
        return ""
    path = Path(str(finding.path)).absolute()
    if finding.repair.means == "calibrate":
        step = path.parent.name == "steps"
        output = str(path.parents[1] if step else path.parent)
        command = shlex.join(["rfpipe", "calibrate", "RIG.yaml", "--output", output])
    else:
        command = rerun_command(_results_of(path))
    removed = shlex.join(map(str, finding.repair.remove))
    return f"rm -rf {removed} && {command}" if removed else command


def _results_of(path: Path) -> Path:
    """Return the folder of results to which a file belongs: the one with `RUN_RECORD`."""
    for folder in path.parents:
        if (folder / RUN_RECORD).is_file() or any(map(is_acquisition, folder.glob("*/*/"))):
            return folder
    return path.parent
