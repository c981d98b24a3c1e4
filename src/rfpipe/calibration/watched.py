"""Progress inside a step of a calibration: its pictures are counted as the projector shows them."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from rfpipe.rigs.devices import Projector

__all__ = ["Counts", "Progress", "WatchedProjector"]


class Counts(Protocol):
    """Something that counts what is done."""

    def advance(self, patterns: int) -> None:
        """Count so many more."""


Progress = Callable[[str, int], AbstractContextManager[Counts]]
"""Makes one for a name and a total, such as `rfpipe.stages.jobs.progress.Progress`."""


class WatchedProjector:
    """A projector whose pictures are counted; everything else is the projector's own.

    Parameters
    ----------
    projector : Projector
    counts : Counts
    """

    def __init__(self, projector: Projector, counts: Counts) -> None:
        self._projector = projector
        self._counts = counts

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        return self._projector.shape

    def show(self, picture: NDArray[np.float32]) -> None:
        """Show a picture, and count it."""
        self._projector.show(picture)
        self._counts.advance(1)

    def __getattr__(self, name: str) -> Any:
        """Return what else the projector has, such as `undisturbed`."""
        return getattr(self._projector, name)

    def describe(self) -> dict[str, Any]:
        """Describe the projector."""
        return self._projector.describe()

    def close(self) -> None:
        """Give the display back."""
        self._projector.close()
