"""The raw frames of a level, which may have been dropped after their merge."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from rfpipe.errors import StaleStoreError
from rfpipe.stages.aside import differing
from rfpipe.stages.folder import AcquisitionFolder
from rfpipe.store import FrameStore

__all__ = ["RawFrames"]

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RawFrames:
    """Whether what a stage makes of raw frames can be made again, and what to do if not.

    Parameters
    ----------
    folder : AcquisitionFolder
    level : int
    part : str
        Name of their store.
    """

    folder: AcquisitionFolder
    level: int
    part: str

    @cached_property
    def dropped(self) -> bool:
        """Whether they were dropped."""
        return FrameStore.open(self.folder.store(self.level, self.part)).dropped

    def must_be_there(self, why: str) -> None:
        """Raise StaleStoreError if they were dropped; `why` says what they are needed for."""
        if self.dropped:
            raise StaleStoreError(
                f"{self.folder.store(self.level, self.part)}: the raw exposures were dropped after "
                f"their merge (capture.keep_raw is false), and {why}. {self._advice}"
            )

    def must_be_unchanged(self, old: dict[str, Any], new: dict[str, Any]) -> None:
        """Say that what old code made is kept, or raise StaleStoreError where settings changed."""
        if old != new:
            self.must_be_there(
                f"what they were merged with changed ({differing(old, new)}): restore it"
            )
        _log.warning(
            "%s: merged by other code than today's and kept, since the raw exposures were "
            "dropped. %s",
            self.folder.store(self.level, self.part), self._advice,
        )  # fmt: skip

    @property
    def _advice(self) -> str:
        path = self.folder.path
        return (
            "To capture all levels again, remove the capture.json, capture.zarr and reference.zarr "
            f"of {path}/L*, then run again"
        )
