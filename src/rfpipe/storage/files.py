"""Where the stages of one acquisition leave what they make: on files, or in memory.

On files each stage has a store and, written last, a small manifest that says that it is complete. A
store knows the fingerprint of all that it was made from.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path
from time import perf_counter
from typing import Any

from numpy.typing import NDArray

from rfpipe.errors import DamagedStageError, IntegrityError, StoreError
from rfpipe.provenance import versions
from rfpipe.store import (
    FrameStore,
    ItemWriter,
    is_dropped,
    keep_header,
    open_arrays,
    read_manifest,
    restore_header,
    write_arrays,
    write_manifest,
)
from rfpipe.store.files import digest_of, storage_errors, write_atomically
from rfpipe.store.places import Place
from rfpipe.transport.lazy import LazyArrays
from rfpipe.units import RADIANCE, RADIANCE_UNIT, VERIFICATION_KEY

REFERENCE_BRACKETS = "reference_brackets"
"""Store and manifest key of the all-off and all-on brackets, captured with level 0."""

REFERENCE_IMAGES = "reference_images"
"""Store and key in level 0's merge manifest of black level, defects and floodlit image."""

SYMMETRY = "symmetry"
"""Store of the random patterns' brackets, captured with level 0; key of the symmetry test."""

CHECK_PICTURES = "check_pictures"
"""Store and manifest key of a level's check pictures, see `rfpipe.references.check_pictures`."""

SENSOR = "sensor"
"""Store and manifest key of a resampled sensor's arrays, beside the frames of level 0."""

SUMS = "sums"
"""Store and manifest key of the sum of a level's images and of their variance."""

LAMP = "lamp"
"""Key in level 0's merge manifest: brightness of the lamp before the first check picture."""

VERIFICATION = VERIFICATION_KEY
"""In the place of a level's number: the pictures that verify the transport, taken after it."""

VERIFICATION_FOLDER = "verification"
"""Folder of the verification pictures, beside those of the levels."""

VERIFICATION_MANIFEST = "verification.json"
"""Result of a verification, beside the transport."""

STAGES_LOG = "stages.log"
"""Beside the transport: the stages of a whole acquisition, of which Snakemake keeps no records.

Where it is newer than level 0's schedule, Snakemake does all stages again; no light is taken again.
"""

STAGES = ("schedule", "capture", "merge", "normalize", "refine")
"""Of a level, in their order."""

BY_PRODUCTS = (".log", ".benchmark.tsv", ".tmp")
"""Ends of the names of files beside results that tell of their making alone."""

FILES = "files.json"
"""Name of the manifest of a report's files."""

_log = logging.getLogger(__name__)

Arrays = Mapping[str, NDArray[Any]]
Facts = dict[str, Any]


def standing(manifest: Path, made_from: str) -> dict[str, Any] | None:
    """Return a manifest whose store has the fingerprint `made_from`, else None.

    One that says anything else, or is damaged, is removed: its store is about to change.
    """
    store = manifest.with_suffix(".zarr")
    try:
        stated = read_manifest(manifest)
        # a schedule's manifest says nothing but what is to be shown
        known = stated if "fingerprint" in stated else open_arrays(store).attributes
    except IntegrityError as error:
        _log.warning("made anew, since it is damaged: %s", error)
    except StoreError:
        pass
    else:
        if known.get("fingerprint") == made_from and store.exists():
            return stated
    manifest.unlink(missing_ok=True)
    return None


def write_bundle(
    manifest: Path,
    made_from: str,
    arrays: Mapping[str, NDArray[Any]],
    facts: dict[str, Any],
    **more: Any,
) -> None:
    """Write arrays and, beside them, a manifest of `facts`; `more` is for the store alone."""
    store = manifest.with_suffix(".zarr")
    made = {"fingerprint": made_from, "versions": versions()}
    write_arrays(store, arrays, {"facts": facts, **made, **more})
    write_manifest(manifest, {**facts, **open_arrays(store).entry(), **made})


def write_files(manifest: Path, files: Iterable[Path]) -> None:
    """Write a manifest with the digests of files that lie beside it or below."""
    digests = {
        path.relative_to(manifest.parent).as_posix(): digest_of(path.read_bytes()) for path in files
    }
    write_manifest(manifest, {"files": digests})


@dataclass(frozen=True)
class AcquisitionFolder:
    """An acquisition on files, in ``results/{scene}/{method}``."""

    path: Path

    def manifest(self, level: int, stage: str) -> Path:
        """Manifest of a stage of a level; its existence says that the stage is complete."""
        return self.path / folder_of(level) / f"{stage}.json"

    def store(self, level: int, stage: str) -> Path:
        """Store that the manifest is about."""
        return self.manifest(level, stage).with_suffix(".zarr")

    @property
    def is_kept(self) -> bool:
        """Whether it outlives the process, so that what stands there is used again."""
        return True

    def exists(self, level: int, stage: str) -> bool:
        """Whether a stage of a level is complete."""
        return self.manifest(level, stage).exists()

    def read_manifest(self, level: int, stage: str) -> dict[str, Any]:
        """Read the manifest of a stage of a level; see `rfpipe.store.read_manifest`."""
        return read_manifest(self.manifest(level, stage))

    def standing(self, level: int, stage: str, made_from: str) -> dict[str, Any] | None:
        """Return the manifest of a stage that was made from the same things, else None."""
        return standing(self.manifest(level, stage), made_from)

    def write(
        self, level: int, stage: str, made_from: str, arrays: Arrays, facts: Facts, **more: Any
    ) -> None:
        """Write arrays and manifest of a stage; see `write_bundle`."""
        made = {"fingerprint": made_from, "versions": versions()}
        entry = self.write_part(level, stage, arrays, facts=facts, **made, **more)
        self.write_manifest(level, stage, {**facts, **entry, **made})

    def write_part(self, level: int, part: str, arrays: Arrays, **about: Any) -> Facts:
        """Write arrays without a manifest; return the store's entry for one."""
        store = self.store(level, part)
        write_arrays(store, arrays, about)
        return open_arrays(store).entry()

    def write_manifest(self, level: int, stage: str, facts: Facts) -> None:
        """Write a manifest alone."""
        write_manifest(self.manifest(level, stage), facts)

    def read(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
        """Read what a stage wrote, checked against its manifest: arrays and attributes.

        A `part` is a second store, which the stage's manifest describes under this key.

        Raises
        ------
        StoreError, IntegrityError
            When the manifest is missing or damaged.
        DamagedStageError
            When the store is damaged or missing, or isn't the manifest's.
        """
        arrays, attributes = self.open(level, stage, part)
        return dict(arrays), attributes

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Facts]:
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
                    f"patterns differ from those of {manifest.name}",
                    place=bundle.path,
                    remedy="Run the stage that writes it again",
                )
        read = advice_on_damage(manifest)(bundle.read)
        return LazyArrays(bundle.names, read), bundle.attributes

    @contextmanager
    def frames(self, level: int, stage: str, part: str | None = None) -> Iterator[FrameStore]:
        """Open the frames that a stage wrote, checked against its manifest; as `read`."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        path = self.store(level, part or stage)
        with advice_on_damage(manifest), FrameStore.open(path.absolute()) as frames:
            _check_digest(path, frames.digest(), expected[part] if part else expected)
            yield frames

    def open_frames(self, level: int, part: str) -> AbstractContextManager[FrameStore]:
        """Open frames that a stage writes or wrote, complete or not; StoreError for none."""
        return FrameStore.open(self.store(level, part).absolute())

    def recording(
        self, path: Path, shape: tuple[int, ...], dtype: Any, made_for: str, shown: Facts
    ) -> AbstractContextManager[FrameStore]:
        """Open a store of brackets for writing; make it where there is none."""
        frames = FrameStore.create(path, shape, dtype, made_for, shown)
        keep_header(path)
        return frames

    @contextmanager
    def merging(
        self, level: int, shape: tuple[int, ...], made_from: str, layout: tuple[int, int]
    ) -> Iterator[tuple[FrameStore, ItemWriter]]:
        """Make a store of a level's merged images; provide it, and what writes items anywhere.

        A merge is quick beside its capture: one that was interrupted starts anew. `layout` is the
        number of patterns a chunk, and of chunks a file.
        """
        store = self.store(level, "merge").absolute()
        FrameStore.discard(store)
        about = {"axis 1": ["radiance", "variance"], "units": RADIANCE_UNIT}
        with FrameStore.create(
            store, shape, RADIANCE, made_from, about,
            items_per_chunk=layout[0], chunks_per_file=layout[1],
        ) as images:  # fmt: skip
            yield images, ItemWriter(store, made_from)

    @contextmanager
    def doing(self, level: int, stage: str) -> Iterator[None]:
        """Keep the seconds of a stage's work beside its manifest, if there was any."""
        manifest = self.manifest(level, stage)
        before, began = manifest.exists() and manifest.stat().st_mtime_ns, perf_counter()
        yield
        if manifest.stat().st_mtime_ns != before:
            times = manifest.with_suffix(".benchmark.tsv")
            write_atomically(times, f"s\n{perf_counter() - began:.4f}\n".encode())
            log = self.path / STAGES_LOG
            with storage_errors(log, "writing"), log.open("a", encoding="utf-8") as done:
                done.write(f"{manifest.parent.name}/{stage}\n")

    def has_merged_raw(self) -> bool:
        """Whether raw exposures are on disk that a merge has used."""
        stores = [path.with_name("capture.zarr") for path in self.path.glob("*/merge.json")]
        return any(store.exists() and not is_dropped(store) for store in stores)

    def retaking(self, level: int | None = None) -> str:
        """Return the command that takes a level's pictures again, all levels' for None.

        It is for a shell in the run's folder, and needs the run's other options.
        """
        scene, method = self.path.absolute().parts[-2:]
        of = "" if level is None else f"/{self.manifest(level, 'capture').parent.name}"
        return f"rfpipe run --retake {scene}/{method}{of}"

    def levels(self) -> Iterator[int]:
        """Yield the levels that have patterns to show, as far as that is known.

        Level 0 is the first; the refinement of each tells the next one.
        """
        level: int | None = 0
        while level is not None:
            yield level
            try:
                refined = self.exists(level, "refine") and self.read_manifest(level, "refine")
            except IntegrityError:  # it is about to be made anew
                return
            level = refined["next"] if refined else None

    def levels_above(self, level: int | None) -> list[int]:
        """Return the levels with patterns above a level; all of them for None."""
        return list(takewhile(lambda above: level is None or above < level, self.levels()))

    def refined_above(self, level: int | None) -> list[str]:
        """Return the digests of all refinements above a level, which its schedule rests on."""
        return [self.read_manifest(above, "refine")["digest"] for above in self.levels_above(level)]


def folder_of(level: int) -> str:
    """Name of a level's folder."""
    return VERIFICATION_FOLDER if level == VERIFICATION else f"L{level:02d}"


def name_of(level: int) -> str:
    """Return what messages call a level."""
    return "verification" if level == VERIFICATION else f"level {level}"


@contextmanager
def advice_on_damage(manifest: Path) -> Iterator[None]:
    """Raise DamagedStageError for a `StoreError`: its stage runs again without its manifest."""
    try:
        yield
    except StoreError as error:
        remedy = f"{error.remedy}. To do so, remove {manifest} and run again"
        raise DamagedStageError(
            error.what,
            value=error.value,
            place=error.place,
            remedy=remedy.removeprefix(". "),
            manifest=manifest,
        ) from error


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
    if manifest.stem not in STAGES:
        return [manifest]
    rest = STAGES[STAGES.index(manifest.stem) :]
    return [manifest.with_name(f"{stage}.json") for stage in rest]


def _check_digest(path: Path | Place, found: str, expected: dict[str, Any]) -> None:
    if found != expected["digest"]:
        raise IntegrityError(
            f"digest is {found}; its manifest states {expected['digest']}",
            place=path,
            remedy="Run the stage that writes it again",
        )
