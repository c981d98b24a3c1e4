"""Storage of an acquisition in files.

Each stage of a level has a store and, written last, a manifest: a small JSON file that shows that
the stage is complete. Each store contains the fingerprint of its inputs and settings.
`rfpipe.storage.base` defines these words.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import DTypeLike

from rfpipe.errors import (
    IntegrityError,
    LockedError,
    StaleStoreError,
    StoreError,
)
from rfpipe.ranges import ranges
from rfpipe.rigs import Rig
from rfpipe.storage.base import (
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    REFERENCE_IMAGES,
    SUMS,
    SYMMETRY,
    Arrays,
    Attributes,
    Entry,
    Facts,
    Manifest,
    StoredPictures,
    WhenChanged,
    folder_name,
    level_name,
    rig_settings,
)
from rfpipe.storage.damage import raising_damage_of
from rfpipe.storage.differences import differing
from rfpipe.storage.results import current_manifest, write_result
from rfpipe.storage.set_aside import name_aside, set_aside
from rfpipe.storage.space import check_space
from rfpipe.store import (
    ItemWriter,
    PictureStore,
    StoreLock,
    bytes_on_disk,
    drop,
    is_dropped,
    keep_header,
    open_arrays,
    read_manifest,
    restore_header,
    to_disk,
    write_arrays,
    write_manifest,
)
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.store.places import Place
from rfpipe.transport.lazy import LazyArrays
from rfpipe.units import RADIANCE, RADIANCE_UNIT

STAGES_LOG = "stages.log"
"""Log beside the transport of the stages of an acquisition in one job.

Snakemake keeps no records of these stages. Where the log is newer than level 0's schedule,
Snakemake runs all stages again; no picture is taken again.
"""

BY_PRODUCTS = (".log", ".benchmark.tsv", ".tmp")
"""Ends of the names of files beside results that no result depends on."""

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class FolderStorage:
    """Storage of an acquisition in the folder ``results/{scene}/{method}``.

    It implements `rfpipe.storage.base.Storage`.
    """

    path: Path

    def manifest(self, level: int, stage: str) -> Path:
        """Path of the manifest of a stage of a level."""
        return self.folder(level) / f"{stage}.json"

    def store(self, level: int, stage: str) -> Path:
        """Path of the store of a stage of a level."""
        return self.manifest(level, stage).with_suffix(".zarr")

    def exists(self, level: int, stage: str) -> bool:
        """Test whether a stage of a level is complete."""
        return self.manifest(level, stage).exists()

    def read_manifest(self, level: int, stage: str) -> Manifest:
        """Read the manifest of a stage of a level; see `rfpipe.store.read_manifest`."""
        return read_manifest(self.manifest(level, stage))

    def current_manifest(self, level: int, stage: str, fingerprint: str) -> Manifest | None:
        """Return the manifest of a stage if its store has a fingerprint, else None."""
        return current_manifest(self.manifest(level, stage), fingerprint)

    def write(
        self,
        level: int,
        stage: str,
        fingerprint: str,
        arrays: Arrays,
        facts: Facts,
        **attributes: Any,
    ) -> None:
        """Write a stage's arrays and its manifest; see `write_result`."""
        self.manifest(level, stage).parent.mkdir(parents=True, exist_ok=True)
        write_result(self.manifest(level, stage), fingerprint, arrays, facts, **attributes)

    def write_part(self, level: int, part: str, arrays: Arrays, **attributes: Any) -> Entry:
        """Write arrays without a manifest; return the store's entry for one."""
        store = self.store(level, part)
        write_arrays(store, arrays, attributes)
        return open_arrays(store).entry()

    def write_manifest(self, level: int, stage: str, manifest: Manifest) -> None:
        """Write a manifest alone."""
        write_manifest(self.manifest(level, stage), manifest)

    def read(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        """Read a stage's arrays and attributes, checked against its manifest.

        A `part` is a further store, which the stage's manifest describes under this key.

        Raises
        ------
        StoreError, IntegrityError
            When the manifest is missing or damaged.
        DamagedStageError
            When the store is damaged or missing, or isn't the manifest's.
        """
        arrays, attributes = self.open(level, stage, part)
        return dict(arrays), attributes

    def open(self, level: int, stage: str, part: str | None = None) -> tuple[Arrays, Attributes]:
        """Return the same as `read`, with arrays that are read and checked when first used."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        with raising_damage_of(manifest):
            bundle = open_arrays(self.store(level, part or stage))
            entry = expected[part] if part else expected
            if "digest" in entry:
                _check_digest(bundle.path, bundle.digest, entry)
            elif bundle.attributes.get("facts") != expected:
                raise IntegrityError(
                    f"patterns differ from those of {manifest.name}",
                    place=bundle.path,
                    remedy="Run the stage that writes it again",
                )
        read = raising_damage_of(manifest)(bundle.read)
        return LazyArrays(bundle.names, read), bundle.attributes

    @contextmanager
    def pictures(self, level: int, stage: str, part: str | None = None) -> Iterator[StoredPictures]:
        """Open the complete pictures of a stage or a part; checks and errors as in `read`."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        path = self.store(level, part or stage)
        with raising_damage_of(manifest), PictureStore.open(path.absolute()) as pictures:
            _check_digest(path, pictures.digest(), expected[part] if part else expected)
            yield pictures

    def partial_brackets(self, level: int, part: str) -> AbstractContextManager[PictureStore]:
        """Open brackets that may be incomplete; StoreError if there are none."""
        path = self.store(level, part).absolute()
        if path.exists():
            restore_header(path)
        return PictureStore.open(path)

    def missing_brackets(
        self, level: int, part: str, count: int, longest: int
    ) -> list[tuple[int, int]]:
        """List the runs of the `count` brackets that aren't captured, of at most `longest`."""
        path = self.store(level, part)
        if not path.exists():
            return ranges(count, longest)
        with PictureStore.open(path) as brackets:
            return list(brackets.missing(longest))

    def make_room(
        self,
        level: int,
        part: str,
        fingerprint: str,
        attributes: Attributes,
        when_changed: WhenChanged,
    ) -> None:
        """Set aside brackets of other settings, before brackets of these settings are captured.

        A store of another fingerprint is renamed, with its fingerprint in its new name. A store
        that was set aside and has this fingerprint takes its place, so that no rig is needed. A
        store whose brackets were dropped after their merge is removed. A damaged header is restored
        from its copy.

        Raises
        ------
        StaleStoreError
            When there are brackets of other settings, none of these, and `when_changed` is
            "refuse".
        LockedError
            When another process writes the store.
        IntegrityError
            When the header and its copy are damaged.
        """
        path = self.store(level, part)
        if path.exists() and restore_header(path):
            _log.warning("%s: its header was damaged or missing; restored", path)
        former = name_aside(path, fingerprint)
        with StoreLock(path):
            old = PictureStore.open(path) if path.exists() else None
            if old is not None:
                if old.fingerprint == fingerprint:
                    return
                set_aside(path, old, fingerprint, attributes, when_changed)
            if former.exists():
                former.rename(path)
                text = "%s: captured with these settings before; taken from %s"
                _log.warning(text, path, former)

    def record_brackets(
        self,
        level: int,
        part: str,
        shape: tuple[int, ...],
        dtype: DTypeLike,
        fingerprint: str,
        attributes: Attributes,
    ) -> AbstractContextManager[PictureStore]:
        """Open a store of brackets for writing; create it if there is none."""
        path = self.store(level, part)
        brackets = PictureStore.create(path, shape, dtype, fingerprint, attributes)
        keep_header(path)
        return brackets

    @contextmanager
    def record_images(
        self, level: int, shape: tuple[int, ...], fingerprint: str, layout: tuple[int, int]
    ) -> Iterator[tuple[PictureStore, ItemWriter]]:
        """Make a store of a level's merged images; provide it, and a writer for any process.

        A merge is quick beside its capture: an interrupted one starts from the beginning.
        """
        store = self.store(level, "merge").absolute()
        PictureStore.discard(store)
        axes = {"axis 1": ["radiance", "variance"], "units": RADIANCE_UNIT}
        with PictureStore.create(
            store, shape, RADIANCE, fingerprint, axes,
            items_per_chunk=layout[0], chunks_per_file=layout[1],
        ) as images:  # fmt: skip
            yield images, ItemWriter(store, fingerprint)

    def folder(self, level: int) -> Path:
        """Folder of a level."""
        return self.path / folder_name(level)

    def images_without_raw(self, level: int, inputs: Facts, fingerprint: str) -> Manifest | None:
        """Return the manifest of merged images whose brackets were dropped; None with brackets.

        Raises StaleStoreError where the images are damaged or of other settings.
        """
        raw = self.store(level, "capture")
        if not PictureStore.open(raw).dropped:
            return None
        advice = (
            f"To capture all levels again: '{self.retake_command()}', with the run's other options"
        )
        facts, fault = self._merged_facts(level)
        if not fault and facts["inputs"] != inputs:
            fault = (
                f"the inputs of their merge changed ({differing(facts['inputs'], inputs)}). Set "
                "that back and run again: all merged images are still there, and manifests that "
                "are missing are made again"
            )
        if fault:
            raise StaleStoreError(
                f"{raw}: the brackets were dropped after their merge (capture.keep_raw is "
                f"false), and {fault}. {advice}"
            )
        if facts["fingerprint"] != fingerprint:
            _log.warning(
                "%s: merged by an earlier version of the code and kept, since the brackets "
                "were dropped. %s", raw, advice,
            )  # fmt: skip
        return facts

    def _merged_facts(self, level: int) -> tuple[Facts, str]:
        """Read the manifest that is also stored with the sums; or why the images can't be used."""
        try:
            sums = open_arrays(self.store(level, SUMS))
            sums.read_all()
            facts: Facts = {**sums.attributes["facts"], SUMS: sums.entry()}
            if level == 0:
                open_arrays(self.store(0, REFERENCE_IMAGES)).read_all()
            images = PictureStore.open(self.store(level, "merge"))
            is_whole = images.complete and not images.damaged()
        except LockedError:
            raise
        except (StoreError, KeyError) as error:
            return {}, f"there are no whole merged images of them ({error})"
        return facts, "" if is_whole else "the merged images are damaged"

    def drop_raw(self, level: int) -> None:
        """Remove the brackets of a merged level; safe to interrupt at any time."""
        merged = ["merge", SUMS, *([REFERENCE_IMAGES] if level == 0 else [])]
        raw = [
            "capture",
            *([REFERENCE_BRACKETS, MORE_REFERENCE_BRACKETS, SYMMETRY] if level == 0 else []),
        ]
        for part in merged:
            to_disk(self.store(level, part))
        stores = [self.store(level, part) for part in raw]
        freed = sum(drop(store) for store in stores if store.exists())
        if freed:
            _log.info("%s: brackets dropped, %.3g MB", level_name(level), freed / 1e6)

    def describe_rig(self, rig: Rig) -> Facts:
        """Describe a rig, for manifests and fingerprints."""
        return rig_settings(rig)

    def check_space(self, level: int, needed: int) -> None:
        """Raise StoreError if a capture of `needed` bytes doesn't fit on the disk."""
        merged = self.store(level, "merge")  # replaced
        present = bytes_on_disk(merged) if merged.exists() else 0
        check_space(level_name(level), needed, self.path, present)

    def seconds_since_capture(self) -> float:
        """Seconds since the last bracket was captured; infinite if there is none."""
        journals = self.path.glob("L*/*.zarr/journal.jsonl")
        times = [journal.stat().st_mtime for journal in journals]
        return time.time() - max(times) if times else np.inf

    @contextmanager
    def timing(self, level: int, stage: str) -> Iterator[None]:
        """Write the seconds of a stage beside its manifest, if the stage writes one."""
        manifest = self.manifest(level, stage)
        before, began = manifest.exists() and manifest.stat().st_mtime_ns, perf_counter()
        yield
        if manifest.stat().st_mtime_ns != before:
            times = manifest.with_suffix(".benchmark.tsv")
            write_atomically(times, f"s\n{perf_counter() - began:.4f}\n".encode())
            log = self.path / STAGES_LOG
            with storage_errors(log, "writing"), log.open("a", encoding="utf-8") as lines:
                lines.write(f"{manifest.parent.name}/{stage}\n")

    def has_merged_raw(self) -> bool:
        """Test whether there are brackets on disk that are merged."""
        stores = [path.with_name("capture.zarr") for path in self.path.glob("*/merge.json")]
        return any(store.exists() and not is_dropped(store) for store in stores)

    def retake_command(self, level: int | None = None) -> str:
        """Return the command that takes a level's pictures again; all levels' for None.

        It is for a shell in the run's folder, and needs the run's other options.
        """
        scene, method = self.path.absolute().parts[-2:]
        suffix = "" if level is None else f"/{self.manifest(level, 'capture').parent.name}"
        return f"rfpipe run --retake {scene}/{method}{suffix}"

    def recovery_advice(self, level: int) -> str:
        """Describe how to go on after a capture that ended since the rig or its light changed."""
        level_advice = ""
        if level:
            level_advice = (
                f"Or put back what changed: '{self.retake_command(level)}' takes only this level "
                "again, if the pattern looks as it did at first. "
            )
        return (
            f"all captured pictures are kept. To start over: '{self.retake_command()}', with the "
            f"run's other options. {level_advice}capture.watch: warn continues despite it"
        )


def _check_digest(path: Path | Place, digest: str, expected: Entry) -> None:
    if digest != expected["digest"]:
        raise IntegrityError(
            f"digest is {digest}; its manifest states {expected['digest']}",
            place=path,
            remedy="Run the stage that writes it again",
        )
