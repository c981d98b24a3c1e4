"""Checking one acquisition: the stages of each level, and the transport that comes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rfpipe.errors import StoreError
from rfpipe.stages.capture import SENSOR
from rfpipe.stages.folder import (
    REFERENCE,
    SYMMETRY,
    VERIFICATION,
    AcquisitionFolder,
    with_followers,
)
from rfpipe.stages.merge import SUMS
from rfpipe.stages.merger import REFERENCES
from rfpipe.stages.unseen.verify import MANIFEST as VERIFIED
from rfpipe.stages.verifying.findings import Checked, Mend
from rfpipe.stages.verifying.stores import check_bundle, check_frames, first_sentence, made_for
from rfpipe.stages.watch import DRIFT, MOVES
from rfpipe.store import StoreLock, open_arrays, read_manifest

__all__ = ["check_acquisition", "is_acquisition"]

_STAGES = ("schedule", "capture", "merge", "normalize", "refine")
_OF_VERIFICATION = ("schedule", "capture", "merge")
_FRAMES = ("capture", "merge", REFERENCE, SYMMETRY, DRIFT, MOVES)
_PARTS = {
    "capture": (REFERENCE, SYMMETRY, DRIFT, MOVES, SENSOR),
    "merge": (SUMS, REFERENCES),
}


def is_acquisition(folder: Path) -> bool:
    """Whether stages of an acquisition left something in a folder."""
    return (folder / "transport.json").is_file() or (folder / "L00").is_dir()


def check_acquisition(path: Path, checked: Checked) -> None:
    """Check what the stages of an acquisition left."""
    holder = StoreLock.holder(path)
    if holder is not None and holder.is_known:
        checked.notes.append(f"{path}: is being acquired at this moment; not checked")
        checked.seen |= {*path.rglob("*.zarr"), *path.rglob("*.json")}
        return
    _Acquisition(AcquisitionFolder(path), checked).check()


@dataclass
class _Acquisition:
    folder: AcquisitionFolder
    checked: Checked

    def __post_init__(self) -> None:
        self.transport = self.folder.path / "transport.json"
        self.complete = self.transport.exists()
        self.levels = sorted(
            int(place.name[1:])
            for place in self.folder.path.glob("L*")
            if place.is_dir() and place.name[1:].isdigit()
        )

    def check(self) -> None:
        facts = self._manifest(self.transport)
        found = {level: self._level(level) for level in self.levels}
        if not self.complete:
            self.checked.notes.append(
                f"{self.folder.path}: not finished, {len(self.levels)} levels begun; the next run "
                "goes on there"
            )
            return
        wrong, digest = check_bundle(self.transport.with_suffix(".zarr"), self.checked)
        for what in wrong:
            self._wrong(self.transport.with_suffix(".zarr"), what)
        if facts is None:
            return
        self._is_of(self.transport.with_suffix(".zarr"), digest, facts["digest"], self.transport)
        names = facts["scene"], facts["method"]
        place = self.folder.path.resolve()
        if names != (place.parent.name, place.name) and place.parents[1].name == "results":
            self._wrong(self.transport, f"is of {names[0]} by {names[1]}, not of this folder")
        self._chain(facts.get("made_of"), found)
        self._verification(facts["digest"])

    def _chain(self, made_of: dict[str, Any] | None, found: dict[int, dict[str, Any]]) -> None:
        """Check that the transport was made of what the levels hold."""
        if made_of is None:  # of an earlier version of rfpipe
            return
        for level, digest in made_of["refine"]:
            manifest = self.folder.manifest(level, "refine")
            if level not in found:
                self._wrong(manifest.parent, "is missing")
            elif "refine" in found[level] and found[level]["refine"]["digest"] != digest:
                self._wrong(
                    self.transport,
                    f"was made of another {manifest.relative_to(self.folder.path)} than stands "
                    "there",
                )
        merged = found.get(0, {}).get("merge", {}).get(REFERENCES)
        if merged and merged["digest"] != made_of["references"]:
            self._wrong(self.transport, "was made with another floodlit image than stands there")

    def _verification(self, transport: str) -> None:
        """Check the pictures that verify the transport, if there are any."""
        manifest = self.folder.path / VERIFIED
        if self.folder.manifest(VERIFICATION, "schedule").exists():
            self._level(VERIFICATION, _OF_VERIFICATION, complete=manifest.exists())
        facts = self._manifest(manifest)
        if facts is None:
            return
        wrong, digest = check_bundle(manifest.with_suffix(".zarr"), self.checked)
        for what in wrong:
            self._wrong(manifest.with_suffix(".zarr"), what, manifest)
        self._is_of(manifest.with_suffix(".zarr"), digest, facts["digest"], manifest)
        if facts["transport"] != transport:
            self._wrong(manifest, "is of another transport than stands there")

    def _level(
        self, level: int, stages: Sequence[str] = _STAGES, *, complete: bool | None = None
    ) -> dict[str, Any]:
        """Check a level; return the manifests of its stages that are whole."""
        found: dict[str, Any] = {}
        for stage in stages:
            manifest = self.folder.manifest(level, stage)
            if not manifest.exists():
                if self.complete if complete is None else complete:
                    self._wrong(manifest, "is missing")
                continue
            facts = self._manifest(manifest)
            if facts is not None and (facts["stage"], facts["level"]) != (stage, level):
                self._wrong(manifest, f"is of {facts['stage']} of level {facts['level']}")
            elif facts is not None:
                found[stage] = facts
            self._stores(level, stage, facts)
        captured, merged = found.get("capture"), found.get("merge")
        if captured and merged and merged["made_of"]["captured"] != captured["digest"]:
            self._wrong(self.folder.manifest(level, "merge"), "is of another capture")
        return found

    def _stores(self, level: int, stage: str, facts: dict[str, Any] | None) -> None:
        """Check the stores that a manifest is about; all that may be, if it is damaged."""
        manifest = self.folder.manifest(level, stage)
        for part in (None, *_PARTS.get(stage, ())):
            path = self.folder.store(level, part or stage)
            stated = None if facts is None else facts if part is None else facts.get(part)
            if part is not None and stated is None and (facts is not None or not path.exists()):
                continue
            check = check_frames if (part or stage) in _FRAMES else check_bundle
            wrong, digest = check(path, self.checked)
            if check is check_frames and not wrong:
                wrong = made_for(path, None if stated is None else stated.get("fingerprint"))
            for what in wrong:
                self._wrong(path, what, manifest)
            if stated is not None and "digest" in stated:
                self._is_of(path, digest, stated["digest"], manifest)
            elif stated and not wrong and open_arrays(path).attributes["facts"] != stated:
                self._wrong(path, f"holds other patterns than {manifest.name} says", manifest)

    def _manifest(self, path: Path, of: Path | None = None) -> dict[str, Any] | None:
        """Read a manifest; None where it is missing or damaged, which is found."""
        if not path.exists() and of is None:
            return None
        self.checked.manifests += 1
        self.checked.seen.add(path)
        try:
            return read_manifest(path)
        except StoreError as error:
            self._wrong(path, first_sentence(error, path), of)
            return None

    def _is_of(self, path: Path, digest: str | None, stated: str, manifest: Path) -> None:
        if digest is not None and digest != stated:
            self._wrong(
                path,
                f"isn't the store of {manifest.name}: its digest is {digest}, not {stated}",
                manifest,
            )

    def _wrong(self, path: Path, what: str, manifest: Path | None = None) -> None:
        """Add a finding, which is mended where the stage's manifest goes, and the transport's."""
        of = manifest or (path if path.suffix == ".json" else self.transport)
        self.checked.wrong(path, what, self._mend(path, of))

    def _mend(self, path: Path, manifest: Path) -> Mend:
        verified = self.folder.path / VERIFIED
        if manifest.parent.name == "verification" or manifest == verified:
            return Mend("run", tuple(dict.fromkeys((manifest, verified))))
        if manifest.stem == "capture":
            cost = (
                "what is whole stays; the damaged patterns are shown again, so the scene must "
                "stand as it did" if "header" not in path.name else ""
            )  # fmt: skip
            return Mend("run", (*with_followers(manifest), self.transport), cost)
        if manifest.stem == "merge" and self._is_dropped(manifest.parent):
            taken = [
                place
                for level in self.folder.path.glob("L*")
                for place in (
                    *with_followers(level / "capture.json"),
                    *(level / f"{name}.zarr" for name in ("capture", REFERENCE, SYMMETRY)),
                )
                if place.exists()
            ]
            cost = (
                "the raw exposures were dropped after their merge (capture.keep_raw): ALL patterns "
                "are taken again. A copy of the folder, if there is one, is better"
            )
            return Mend("run", tuple(dict.fromkeys((manifest, *taken, self.transport))), cost)
        return Mend("run", tuple(dict.fromkeys((*with_followers(manifest), self.transport))))

    @staticmethod
    def _is_dropped(level: Path) -> bool:
        return (level / "capture.zarr" / "dropped.json").exists()
