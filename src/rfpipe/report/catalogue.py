"""Catalogue: a page with every acquisition of a run, its state and its numbers."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from rfpipe.blocks import RayDomain
from rfpipe.errors import RfpipeError
from rfpipe.report.inputs import seconds_spent
from rfpipe.report.page import rendered
from rfpipe.report.targets import ending_of, missed_target_texts
from rfpipe.report.text import ray_size
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.picture_counts import captured_pictures
from rfpipe.store import StoreLock, manifest_or_empty
from rfpipe.store.files import write_atomically
from rfpipe.transport.base import last_estimate

if TYPE_CHECKING:
    from rfpipe.config import Config

CATALOGUE = Path("catalogue") / "index.html"
"""Path of the page in the folder of results."""

AcquisitionState = Literal["failed", "running", "stopped", "waiting", "done"]
_STATES: tuple[AcquisitionState, ...] = ("failed", "running", "stopped", "waiting", "done")

_ERROR = re.compile(r"^\d{4}-\d\d-\d\d [\d:,]+ ERROR (.*)$", re.MULTILINE)
_MAX_REASON_LENGTH = 400
"""Characters of an error message that the page shows."""

_TAIL_BYTES = 65_536
"""Bytes at the end of a log that are searched for errors."""

_THUMBNAIL_PIXELS = 96
_WHITE_PERCENTILE = 99.5


def write_catalogue(settings: Config, results: Path) -> dict[str, int]:
    """Write the page that lists every acquisition of a run.

    Parameters
    ----------
    settings : Config
    results : Path
        Folder of results. The page is its ``catalogue/index.html``, in a folder with thumbnails.

    Returns
    -------
    dict
        Number of acquisitions in each state.
    """
    begun = {folder.parents[1].name for folder in results.glob("*/*/L00")}
    rows = [_row(settings, results, *names) for names in settings.acquisitions]
    counts = Counter(row["state"] for row in rows)
    page = rendered(
        "catalogue.html.j2",
        title=Path(settings.collection).stem if settings.collection else settings.title,
        rows=rows,
        annotations=list(dict.fromkeys(key for row in rows for key in row["annotations"])),
        shown={
            name: any(row[name] not in (None, "") for row in rows)
            for name in ("error", "indirect", "estimate", "verified", "rig")
        },
        former_scenes=sorted(begun - {*settings.scenes}),
        states=[(state, counts[state]) for state in _STATES if counts[state]],
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
    )
    write_atomically(results / CATALOGUE, page.encode())
    return {state: counts[state] for state in _STATES}


def _row(settings: Config, results: Path, scene: str, method: str) -> dict[str, Any]:
    folder, scene_settings = results / scene / method, settings.scenes[scene]
    state, reason = state_of(folder)
    view, log = f"report/view/{scene}_{method}.html", last_log(folder)
    picture = (results / CATALOGUE).with_name(f"{scene}_{method}.png")
    numbers = _numbers(folder, settings.capture.seconds_per_pattern)
    return {
        "scene": scene,
        "method": method,
        "state": state,
        "reason": reason,
        "order": _STATES.index(state),
        "kind": scene_settings.kind,
        "rays": ray_size(scene_settings),
        "rig": scene_settings.rig or "",
        "annotations": scene_settings.about,
        "picture": picture.name if write_thumbnail(folder, picture) else None,
        "view": f"../{view}" if (results / view).exists() else None,
        "log": f"../{log.relative_to(results).as_posix()}" if log else None,
        "missed": _missed(folder, numbers),
        **numbers,
    }


class AcquisitionProgress(NamedTuple):
    """State of an acquisition.

    Attributes
    ----------
    state : {"failed", "running", "stopped", "waiting", "done"}
    reason : str
        Error message of a failed acquisition; process and captured levels of a running or stopped
        one.
    """

    state: AcquisitionState
    reason: str = ""


def state_of(folder: Path) -> AcquisitionProgress:
    """Return the state of the acquisition in a folder; a missing folder is waiting."""
    if not folder.exists():
        return AcquisitionProgress("waiting")
    holder = StoreLock.holder(folder)
    if holder is not None:
        return AcquisitionProgress("running", f"process {holder}: {_reached(folder)}")
    if (folder / "transport.json").exists():
        return AcquisitionProgress("done")
    return _ended(folder)


def _modified(path: Path) -> int:
    try:
        return path.stat().st_mtime_ns
    except OSError:
        return 0


def last_log(folder: Path) -> Path | None:
    """Return the newest log of an acquisition or its stages; None without logs."""
    logs = [*folder.glob("*.log"), *folder.glob("L[0-9][0-9]/*.log")]
    return max(logs, key=_modified, default=None)


def _reached(folder: Path) -> str:
    """Describe the last captured level."""
    done = sorted(folder.glob("L[0-9][0-9]/capture.json"))
    return f"level {int(done[-1].parent.name[1:])} is captured" if done else "nothing captured yet"


def _ended(folder: Path) -> AcquisitionProgress:
    """Return the state of an acquisition without a transport, from its last log.

    A job that ends by an error logs it with the level ERROR, an interrupted job logs a warning.
    """
    try:
        with (last_log(folder) or folder / "acquire.log").open("rb") as file:
            file.seek(max(0, file.seek(0, 2) - _TAIL_BYTES))
            errors = _ERROR.findall(file.read().decode(errors="replace"))
    except OSError:
        begun = any(folder.iterdir())
        return (
            AcquisitionProgress("stopped", _reached(folder))
            if begun
            else AcquisitionProgress("waiting")
        )
    if not errors:
        return AcquisitionProgress("stopped", _reached(folder))
    return AcquisitionProgress("failed", errors[-1][:_MAX_REASON_LENGTH])


def _numbers(folder: Path, seconds_per_picture: float) -> dict[str, Any]:
    """Return the numbers of an acquisition, None where they are missing or damaged.

    Returns
    -------
    dict
        ``patterns``; ``pictures`` on the rig so far, for all purposes; ``seconds`` on the rig and
        of processing; ``nbytes`` of the stored transport.
        ``error``, ``estimate`` and ``verified``: mean relative errors of relit pictures: against
        the truth, as the method estimated it, and against verification pictures. ``indirect``: mean
        error of their indirect light against the truth.
    """
    acquired, relit = (
        manifest_or_empty(folder / "transport.json"),
        manifest_or_empty(folder / "relight.json"),
    )
    files = [path.stat().st_size for path in (folder / "transport.zarr").rglob("*.*")]
    return {
        "patterns": acquired.get("patterns"),
        "pictures": _pictures(folder),
        "seconds": _seconds(folder, seconds_per_picture),
        "nbytes": sum(files) if files else None,
        "error": relit.get("mean_error"),
        "indirect": relit.get("mean_indirect"),
        "estimate": last_estimate(acquired.get("levels", [])).get("estimated_error"),
        "verified": manifest_or_empty(folder / "verification.json").get("mean_error"),
    }


def _pictures(folder: Path) -> int | None:
    """Return the number of pictures on the rig; None where captures are missing or damaged."""
    try:
        return captured_pictures(FolderStorage(folder)).total or None
    except (RfpipeError, KeyError):
        return None


def _seconds(folder: Path, seconds_per_picture: float) -> float | None:
    """Return the seconds of capture and processing; None where captures are missing or damaged."""
    try:
        seconds = seconds_spent(folder, seconds_per_picture).total
    except (RfpipeError, KeyError):
        return None
    return None if math.isnan(seconds) else seconds


def _missed(folder: Path, numbers: Mapping[str, Any]) -> list[str]:
    """Return a sentence for each target that an acquisition missed."""
    acquired = manifest_or_empty(folder / "transport.json")
    last = last_estimate(acquired.get("levels", []))
    has_truth = numbers["error"] is not None
    row = {
        **acquired.get("options", {}),
        **last,
        "mean_error": numbers["error"] if has_truth else numbers["verified"],
        "mean_indirect": numbers["indirect"],
        "verified": "truth" if has_truth else "verification pictures",
    }
    reason = ending_of(acquired.get("levels", []))
    return [*missed_target_texts(row, reason, by_few_pictures=not has_truth)]


def write_thumbnail(folder: Path, picture: Path) -> bool:
    """Write the floodlit image of an acquisition as a small PNG, unless it is up to date.

    Parameters
    ----------
    folder : Path
        ``results/{scene}/{method}``.
    picture : Path
        Path of the PNG.

    Returns
    -------
    bool
        Whether there is such a picture.
    """
    from rfpipe.pictures.images import resized, write_image
    from rfpipe.references.reference_images import read_floodlit

    merged = _modified(folder / "L00/merge.json")
    if not merged or _modified(picture) > merged:
        return bool(merged)
    try:
        floodlit = read_floodlit(FolderStorage(folder))[0]
    except (RfpipeError, KeyError):
        return False
    # a light field is represented by its middle view
    domain = RayDomain(floodlit.shape[:-1])
    views = floodlit.reshape(domain.views, *domain.image_shape, floodlit.shape[-1])
    height, width = domain.image_shape
    step = max(1.0, max(height, width) / _THUMBNAIL_PIXELS)
    shape = max(1, round(height / step)), max(1, round(width / step))
    image = resized(np.nan_to_num(views[domain.views // 2]), shape)
    white = float(np.percentile(image, _WHITE_PERCENTILE))
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_image(picture, image, white if white > 0 else 1.0)
    return True
