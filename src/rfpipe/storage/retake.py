"""Retakes: pictures of an acquisition are set aside, never removed, and captured again."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import InputError
from rfpipe.storage.base import (
    CHECK_PICTURES,
    MORE_REFERENCE_BRACKETS,
    REFERENCE_BRACKETS,
    REFERENCE_IMAGES,
    SENSOR,
    STAGES,
    SUMS,
    SYMMETRY,
    VERIFICATION,
    VERIFICATION_FOLDER,
    VERIFICATION_MANIFEST,
    scheduled_levels,
)
from rfpipe.storage.damage import with_followers
from rfpipe.storage.files import FolderStorage
from rfpipe.store import StoreLock, is_dropped
from rfpipe.text import similar_names

_CAPTURED = (
    "capture",
    REFERENCE_BRACKETS,
    MORE_REFERENCE_BRACKETS,
    SYMMETRY,
    SENSOR,
    CHECK_PICTURES,
)
"""Stores of a level's capture."""

_MERGED = ("merge", SUMS, REFERENCE_IMAGES)
"""Stores of a level's merge, set aside with them if the brackets were dropped."""

_MAX_SUGGESTIONS = 4
"""Number of similar names in a message."""


@dataclass(frozen=True)
class Retake:
    """Level whose pictures are to be captured again.

    Attributes
    ----------
    folder : FolderStorage
    level : int
        Number of the level, or VERIFICATION.
    """

    folder: FolderStorage
    level: int

    @property
    def path(self) -> Path:
        """Folder of the level."""
        return self.folder.manifest(self.level, "capture").parent

    def set_aside(self) -> list[Path]:
        """Rename the stores of the pictures; return their new paths.

        The manifests of all results of these pictures are removed first, the transport's before the
        capture's, so that a run after an interruption restores them from the same pictures.
        """
        with StoreLock(self.folder.path):
            for manifest in self._manifests():
                manifest.unlink(missing_ok=True)
            return self._rename_aside()

    @property
    def is_set_aside(self) -> bool:
        """True if earlier pictures of the level are set aside."""
        return self._last_number() > 0

    def put_back(self) -> list[Path]:
        """Exchange the pictures for those set aside last; return the paths of these.

        The manifests are removed as by `set_aside`.

        Raises
        ------
        InputError
            If no pictures of the level are set aside.
        """
        number = self._last_number()
        if not number:
            raise InputError(
                f"--put-back: no pictures are set aside in {self.path.absolute()}",
                remedy="name a level with a store capture.before_1.zarr",
            )
        with StoreLock(self.folder.path):
            for manifest in self._manifests():
                manifest.unlink(missing_ok=True)
            self._rename_aside()
            stores = [self.path / f"{name}.zarr" for name in (*_CAPTURED, *_MERGED)]
            pairs = [(_numbered(store, number), store) for store in stores]
            return [previous.rename(store) for previous, store in pairs if previous.exists()]

    def _rename_aside(self) -> list[Path]:
        """Rename the stores of the pictures, with the first unused number."""
        stores = [self.path / f"{name}.zarr" for name in _CAPTURED]
        if is_dropped(self.path / "capture.zarr"):
            stores += [self.path / f"{name}.zarr" for name in _MERGED]
        number = self._last_number() + 1
        return [store.rename(_numbered(store, number)) for store in stores if store.exists()]

    def _last_number(self) -> int:
        """Largest number in the names of stores that are set aside, 0 for none."""
        numbers = (path.stem.rpartition("_")[2] for path in self.path.glob("*.before_*.zarr"))
        return max((int(number) for number in numbers if number.isdigit()), default=0)

    def _manifests(self) -> list[Path]:
        """Manifests of the pictures and of all results of them, in reverse order of the stages.

        Later levels depend on the refinement, and on level 0's reference images by their merge.
        """
        folder, captured = self.folder, with_followers(self.folder.manifest(self.level, "capture"))
        if self.level == VERIFICATION:
            return [folder.path / VERIFICATION_MANIFEST, *reversed(captured)]
        first = "merge" if self.level == 0 else "refine"
        below = [
            folder.manifest(level, stage)
            for level in reversed(list(scheduled_levels(folder)))
            if level > self.level
            for stage in reversed(STAGES[STAGES.index(first) :])
        ]
        return [folder.path / "transport.json", *below, *reversed(captured)]


def find_retakes(
    results: Path,
    names: Sequence[str],
    acquisitions: Collection[tuple[str, str]] | None = None,
    option: str = "--retake",
) -> list[Retake]:
    """Return captured levels by their names.

    Parameters
    ----------
    results : Path
        Folder of results.
    names : sequence of str
        ``SCENE/METHOD/LEVEL``, with a level such as ``L02``, ``2`` or ``verification``; or
        ``SCENE/METHOD`` for all levels and the verification pictures.
    acquisitions : collection of (str, str), optional
        Scenes and methods of the settings.
    option : str
        Name of the command's option, for messages.

    Raises
    ------
    InputError
        If nothing is captured by a name, with similar names; or if the settings don't have the
        acquisition.
    """
    captured = dict(_captured(results))
    retakes: dict[str, Retake] = {}
    for name in names:
        keys = [key for key in captured if key == _normal(name) or _is_in(key, _normal(name))]
        if not keys:
            raise InputError(f"{option} {_unknown(name, results, list(captured))}")
        scene, method, *_ = keys[0].split("/")
        if acquisitions is not None and (scene, method) not in acquisitions:
            raise InputError(
                f"{option} {name}: the settings have no acquisition of {scene} by {method}, only "
                f"{', '.join(map('/'.join, acquisitions))}",
                remedy="Add it to them first",
            )
        retakes |= {key: captured[key] for key in keys}
    return list(retakes.values())


def is_complete(retakes: Collection[Retake], folder: FolderStorage) -> bool:
    """Test whether retakes include all captured levels of an acquisition."""
    levels = {retake.level for retake in retakes if retake.folder.path == folder.path}
    captured = _captured(folder.path.parents[1])
    return levels >= {retake.level for _, retake in captured if retake.folder.path == folder.path}


def _captured(results: Path) -> Iterator[tuple[str, Retake]]:
    """Yield name and level of each capture: incomplete, complete, or set aside."""
    stores = (
        path
        for stem in ("capture", REFERENCE_BRACKETS)
        for path in (
            *results.glob(f"*/*/*/{stem}.zarr"),
            *results.glob(f"*/*/*/{stem}.before_*.zarr"),
        )
    )
    for path in sorted({store.parent for store in stores}):
        folder, name = FolderStorage(path.parent), "/".join(path.parts[-3:])
        if path.name == VERIFICATION_FOLDER:
            yield name, Retake(folder, VERIFICATION)
        elif path.name.startswith("L") and path.name[1:].isdigit():
            yield name, Retake(folder, int(path.name[1:]))


def _normal(name: str) -> str:
    """Return a name with its level as in folders: 2 and L2 become L02."""
    scene_and_method, _, level = name.strip("/").rpartition("/")
    number = level.removeprefix("L").removeprefix("l")
    if number.isdigit() and "/" in scene_and_method:
        return f"{scene_and_method}/L{int(number):02d}"
    return name.strip("/")


def _is_in(key: str, name: str) -> bool:
    return name.count("/") == 1 and key.startswith(f"{name}/")


def _unknown(name: str, results: Path, known: list[str]) -> str:
    """Return the message for a name by which nothing is captured."""
    if not known:
        return f"{name}: nothing is captured in {results.absolute()}"
    acquisitions = dict.fromkeys(key.rpartition("/")[0] for key in known)
    names = [*acquisitions, *known]
    similar = similar_names(_normal(name), names, count=_MAX_SUGGESTIONS, cutoff=0.5)
    suggestions = similar or list(acquisitions)[:_MAX_SUGGESTIONS]
    return (
        f"{name}: nothing is captured by this name in {results.absolute()}; expected "
        f"SCENE/METHOD or SCENE/METHOD/LEVEL, such as {', '.join(suggestions)}"
    )


def _numbered(store: Path, number: int) -> Path:
    """Return the path of a store that is set aside."""
    return store.with_name(f"{store.stem}.before_{number}{store.suffix}")
