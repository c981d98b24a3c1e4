"""Where the stages of one acquisition leave their stores and manifests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import DamagedStageError, IntegrityError, StoreError
from rfpipe.keys import VERIFICATION_KEY
from rfpipe.store import ArrayBundle, FrameStore, open_arrays, read_manifest, restore_header
from rfpipe.store.places import Place

__all__ = [
    "REFERENCE",
    "SYMMETRY",
    "VERIFICATION",
    "AcquisitionFolder",
    "advice_on_damage",
    "clear",
    "name_of",
    "next_level",
    "with_followers",
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
    """

    path: Path

    def manifest(self, level: int, stage: str) -> Path:
        """Manifest of a stage of a level; its existence says that the stage is complete."""
        name = "verification" if level == VERIFICATION else f"L{level:02d}"
        return self.path / name / f"{stage}.json"

    def store(self, level: int, stage: str) -> Path:
        """Store that the manifest is about."""
        return self.manifest(level, stage).with_suffix(".zarr")

    def read_manifest(self, level: int, stage: str) -> dict[str, Any]:
        """Read the manifest of a stage of a level; see `rfpipe.store.read_manifest`."""
        return read_manifest(self.manifest(level, stage))

    def levels(self) -> Iterator[int]:
        """Yield the levels that have patterns to show, as far as that is known.

        Level 0 is the first; the refinement of each tells the next one.

        Raises
        ------
        StoreError
            When a refinement is of an earlier version of rfpipe.
        """
        level: int | None = 0
        while level is not None:
            yield level
            manifest = self.manifest(level, "refine")
            try:
                level = next_level(manifest) if manifest.exists() else None
            except IntegrityError:  # it is about to be made anew
                return

    def levels_above(self, level: int | None) -> list[int]:
        """Return the levels with patterns above a level; all of them for None."""
        return list(takewhile(lambda above: level is None or above < level, self.levels()))

    def refined_above(self, level: int | None) -> list[str]:
        """Return the digests of all refinements above a level, which its schedule rests on."""
        return [self.read_manifest(above, "refine")["digest"] for above in self.levels_above(level)]

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
            stated = expected[part] if part else expected
            if "digest" in stated:
                _check_digest(bundle.path, bundle.digest, stated)
            elif bundle.attributes.get("facts") != expected:
                raise IntegrityError(
                    f"{bundle.path}: holds other patterns than {manifest.name} says. Run the "
                    "stage that writes it again"
                )
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


def next_level(refined: Path) -> int | None:
    """Return the level that follows a refined one, by its manifest; None where none has patterns.

    Raises
    ------
    StoreError, IntegrityError
        When the manifest is missing, damaged, or of an earlier version of rfpipe.
    """
    stated = read_manifest(refined)
    if "next" not in stated:
        raise StoreError(
            f"{refined}: is of an earlier version of rfpipe. Remove the schedule.json, merge.json, "
            f"normalize.json and refine.json of {refined.parents[1]}/L*, and run again: what was "
            "captured is kept"
        )
    following: int | None = stated["next"]
    return following


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


def clear(error: DamagedStageError) -> bool:
    """Remove the manifest of a damaged stage, so that it is made anew; tell whether it is.

    So are those of its level that follow from it. Captures are left to the user, who knows whether
    the scene still stands there: of theirs, headers alone are restored.
    """
    manifest = error.manifest
    if manifest.stem == "capture":
        restored = [restore_header(store) for store in manifest.parent.glob("*.zarr")]
        if not any(restored):
            return False
    for each in with_followers(manifest):
        each.unlink(missing_ok=True)
    return True


def with_followers(manifest: Path) -> list[Path]:
    """Return a stage's manifest and those of its level that are to go with it.

    Snakemake makes a missing file again only for one that follows from it and is missing, too.
    """
    stages = ("schedule", "capture", "merge", "normalize", "refine")
    if manifest.stem not in stages:
        return [manifest]
    return [manifest.with_name(f"{stage}.json") for stage in stages[stages.index(manifest.stem) :]]


def _check_digest(path: Path | Place, found: str, expected: dict[str, Any]) -> None:
    if found != expected["digest"]:
        raise IntegrityError(
            f"{path}: has the digest {found}; its manifest says {expected['digest']}. Run the "
            "stage that writes it again"
        )
