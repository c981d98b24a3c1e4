"""Where the stages of one acquisition leave their stores and manifests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import DamagedStageError, IntegrityError, StoreError
from rfpipe.keys import VERIFICATION_KEY
from rfpipe.store import ArrayBundle, FrameStore, open_arrays, read_manifest
from rfpipe.store.places import Place

__all__ = [
    "REFERENCE",
    "SYMMETRY",
    "VERIFICATION",
    "AcquisitionFolder",
    "advice_on_damage",
    "name_of",
]

REFERENCE = "reference"
"""The all-off and all-on brackets, taken with level 0: their store and their manifest's key."""

SYMMETRY = "symmetry"
"""Brackets of random patterns, taken with level 0: their store, their key, and a stage's name."""

VERIFICATION = VERIFICATION_KEY
"""In the place of a level's number: the pictures that verify the transport, taken after it."""


@dataclass(frozen=True)
class AcquisitionFolder:
    """Where the manifests and stores of one acquisition lie.

    Parameters
    ----------
    path : Path
        ``results/{scene}/{method}``.
    believing : bool
        Whether a stage believes its own manifest where one stands there, rather than check every
        byte of its store.
    """

    path: Path
    believing: bool = False

    def manifest(self, level: int, stage: str) -> Path:
        """Manifest of a stage of a level; its existence says that the stage is complete."""
        name = "verification" if level == VERIFICATION else f"L{level:02d}"
        return self.path / name / f"{stage}.json"

    @property
    def asked(self) -> Path:
        """What the last job to end was asked for: a note of it, as its log is, and no result."""
        return self.path / "acquire.asked"

    def store(self, level: int, stage: str) -> Path:
        """Store that the manifest is about."""
        return self.manifest(level, stage).with_suffix(".zarr")

    def read_manifest(self, level: int, stage: str) -> dict[str, Any]:
        """Read the manifest of a stage of a level; see `rfpipe.store.read_manifest`."""
        return read_manifest(self.manifest(level, stage))

    def refined_above(self, level: int) -> list[str]:
        """Digests of what the levels above a level found: all that its schedule rests on."""
        return [self.read_manifest(above, "refine")["digest"] for above in range(level)]

    def read(
        self, level: int, stage: str, part: str | None = None
    ) -> tuple[dict[str, NDArray[Any]], dict[str, Any]]:
        """Read what a stage wrote, checked against its manifest: arrays and attributes.

        Parameters
        ----------
        level : int
        stage : str
        part : str, optional
            A second store that the stage's manifest describes under this key.

        Raises
        ------
        StoreError, IntegrityError
            When the manifest is missing or damaged.
        DamagedStageError
            When the store is damaged or missing, or isn't the manifest's.
        """
        arrays, attributes = self.open(level, stage, part)
        return dict(arrays), attributes

    def open(
        self, level: int, stage: str, part: str | None = None
    ) -> tuple[Mapping[str, NDArray[Any]], dict[str, Any]]:
        """Return what `read` does, with each array read, and checked, when it is asked for."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        with advice_on_damage(manifest):
            bundle = open_arrays(self.store(level, part or stage))
            _check_digest(bundle.path, bundle.digest, expected[part] if part else expected)
        return _Opened(bundle, manifest), bundle.attributes

    @contextmanager
    def frames(self, level: int, stage: str, part: str | None = None) -> Iterator[FrameStore]:
        """Open the frames that a stage wrote, checked against its manifest; as `read`."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        path = self.store(level, part or stage)
        with advice_on_damage(manifest), FrameStore.open(path) as frames:
            _check_digest(path, frames.digest(), expected[part] if part else expected)
            yield frames


@dataclass(frozen=True)
class _Opened(Mapping[str, NDArray[Any]]):
    """The arrays of a store, by name; whoever asks for a damaged one is told how to mend it."""

    bundle: ArrayBundle
    manifest: Path

    def __getitem__(self, name: str) -> NDArray[Any]:
        if name not in self.bundle.names:
            raise KeyError(name)
        with advice_on_damage(self.manifest):
            return self.bundle.read(name)

    def __contains__(self, name: object) -> bool:
        return name in self.bundle.names  # whether there is one is known without reading it

    def __iter__(self) -> Iterator[str]:
        return iter(self.bundle.names)

    def __len__(self) -> int:
        return len(self.bundle.names)


def name_of(level: int) -> str:
    """Return what messages call a level."""
    return "verification" if level == VERIFICATION else f"level {level}"


@contextmanager
def advice_on_damage(manifest: Path) -> Iterator[None]:
    """Say how to make a damaged or missing store again: its stage runs without its manifest.

    Raises
    ------
    DamagedStageError
        In place of a `StoreError`.
    """
    try:
        yield
    except StoreError as error:
        text = f"{error}. To do so, remove {manifest} and run again"
        raise DamagedStageError(text, manifest) from error


def _check_digest(path: Path | Place, found: str, expected: dict[str, Any]) -> None:
    if found != expected["digest"]:
        raise IntegrityError(
            f"{path}: has the digest {found}; its manifest says {expected['digest']}. Run the "
            "stage that writes it again"
        )
