"""Reference brackets that several acquisitions share: taken once, used by all.

Dark frames are the rig's, whatever stands before it; the floodlit ones are a scene's, by whatever
method it is acquired.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import LockedError
from rfpipe.provenance import fingerprint
from rfpipe.stages.capturing.brackets import Brackets
from rfpipe.stages.capturing.shown import Keys
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.store import FrameStore, StoreLock

__all__ = ["FOLDER", "Shared", "take_shared"]

FOLDER = "references"
"""In the folder of results."""

Shared = Literal["none", "black", "all"]

_POLL_SECONDS = 0.2
_log = logging.getLogger(__name__)


def take_shared(
    share: Shared, folder: AcquisitionFolder, references: Brackets, black: int, batch: int
) -> None:
    """Fill reference brackets that are missing with shared ones; take those where there are none.

    Parameters
    ----------
    share : {"none", "black", "all"}
        "black": the all-off brackets, of all acquisitions by the same rig; "all": the all-on ones
        of the same scene as well.
    folder : AcquisitionFolder
        ``results/{scene}/{method}``.
    references : Brackets
        The acquisition's: `black` brackets all off, then those all on.
    black : int
    batch : int
        Patterns shown, then stored, at a time.

    Raises
    ------
    RfpipeError
        As `Brackets.capture`, `Brackets.settle`.
    """
    rig = {name: it for name, it in references.shown["rig"].items() if name != "scene"}
    layout = list(references.rig.camera_shape), references.rig.channels
    parts: list[tuple[str, int, int, dict[str, Any]]] = [("black", 0, black, {})]
    if share == "all":
        scene = {"scene": references.shown["rig"].get("scene"), "name": folder.path.parent.name}
        parts.append(("floodlit", black, references.count, scene))
    for name, first, last, of in parts if share != "none" else ():
        shown = {"shared": name, "count": last - first, "rig": rig, "layout": layout, **of}
        place = folder.path.parents[1] / FOLDER / f"{name}_{fingerprint(shown)[:12]}.zarr"
        _fill(references, place, shown, first, last, batch)


def _fill(
    references: Brackets, place: Path, shown: dict[str, Any], first: int, last: int, batch: int
) -> None:
    """Copy shared brackets over the missing ones of ``first:last``."""
    missing = _missing_of(references, first, last)
    if not missing:
        return

    def patterns(begin: int, end: int) -> tuple[NDArray[np.float32], Keys]:
        return references.patterns(first + begin, first + end)

    shared = Brackets(
        references.rig, place, f"{shown['shared']} brackets for all", last - first, shown, patterns
    )
    with _waiting_for(place.with_suffix(".taking")):
        shared.settle("recapture")
        if shared.count_missing():
            shared.capture(batch)
    with FrameStore.open(place) as taken, references.opened() as frames:
        for begin, end in missing:
            for item in range(begin, end, batch):
                stop = min(item + batch, end)
                frames.write(item, taken.read(item - first, stop - first))
    _log.info(
        "reference brackets: %d of %d are shared (%s)", last - first, references.count, place.name
    )


def _missing_of(references: Brackets, first: int, last: int) -> list[tuple[int, int]]:
    """Return the runs of brackets within ``first:last`` that aren't captured yet."""
    runs = [(max(a, first), min(b, last)) for a, b in references.missing(references.count)]
    return [(a, b) for a, b in runs if a < b]


@contextmanager
def _waiting_for(path: Path) -> Iterator[None]:
    """Hold a lock, once whoever takes the same brackets has taken them."""
    lock = StoreLock(path)
    while True:
        try:
            lock.acquire()
            break
        except LockedError:
            time.sleep(_POLL_SECONDS)
    try:
        yield
    finally:
        lock.release()
