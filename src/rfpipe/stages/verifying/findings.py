"""What a check finds, and what mends it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from rfpipe.store.places import Place

__all__ = ["Checked", "Finding", "Mend"]

How = Literal["run", "calibrate", "restore"]


@dataclass(frozen=True)
class Mend:
    """What mends a finding.

    Attributes
    ----------
    how : {"run", "calibrate", "restore"}
        By the workflow, by `rfpipe calibrate`, or from a copy: nothing here makes it anew.
    remove : tuple of Path
        What has to go first, so that the workflow sees that something is missing.
    cost : str
        What it takes, where that is more than some computing.
    """

    how: How
    remove: tuple[Path, ...] = ()
    cost: str = ""


@dataclass(frozen=True)
class Finding:
    """Something that is wrong.

    Attributes
    ----------
    path : Path or Place
    what : str
    mend : Mend
    """

    path: Path | Place
    what: str
    mend: Mend


@dataclass
class Checked:
    """What was checked, and what is wrong with it.

    Attributes
    ----------
    findings : list of Finding
    notes : list of str
        What isn't wrong, but worth a word.
    stores, manifests, files : int
        How many of each were checked.
    bytes : int
        Read for it.
    seen : set of Path
        Stores and manifests that need no further look.
    """

    findings: list[Finding] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    stores: int = 0
    manifests: int = 0
    files: int = 0
    bytes: int = 0
    seen: set[Path] = field(default_factory=set)
    progress: Callable[[int], object] = lambda _: None

    def wrong(self, path: Path | Place, what: str, mend: Mend) -> None:
        """Add a finding."""
        self.findings.append(Finding(path, what, mend))

    def read(self, nbytes: int) -> None:
        """Count bytes as read."""
        self.bytes += nbytes
        self.progress(nbytes)

    def removals(self) -> list[Path]:
        """Return all that has to go before the workflow runs, each once."""
        return list(dict.fromkeys(self._removed(self.findings)))

    @staticmethod
    def _removed(findings: Iterable[Finding]) -> Iterable[Path]:
        for finding in findings:
            yield from finding.mend.remove
