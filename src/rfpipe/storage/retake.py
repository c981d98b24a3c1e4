"""Taking pictures of a finished acquisition again: the old ones are set aside, never removed."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rfpipe.errors import InputError
from rfpipe.storage.base import REFERENCE_BRACKETS, STAGES, SYMMETRY, VERIFICATION
from rfpipe.storage.files import AcquisitionFolder, with_followers
from rfpipe.store import StoreLock, is_dropped
from rfpipe.text import similar_names

_CAPTURED = ("capture", REFERENCE_BRACKETS, SYMMETRY, "sensor", "check_pictures")
"""Stores of a level's capture."""

_MERGED = ("merge", "sums", "reference_images")
"""Stores of its merge, which alone hold the light where raw exposures were dropped."""

_NEAREST = 4  # names in a message


@dataclass(frozen=True)
class Retake:
    """A level whose pictures are to be taken again; `VERIFICATION` in the place of its number."""

    folder: AcquisitionFolder
    level: int

    @property
    def path(self) -> Path:
        """Folder of the level."""
        return self.folder.manifest(self.level, "capture").parent

    def set_aside(self) -> list[Path]:
        """Make way for new pictures; return the stores that hold the old ones.

        Manifests are removed first, the transport's before the capture's. If that is interrupted,
        the next run makes the missing ones again from the old pictures.
        """
        with StoreLock(self.folder.path):
            for manifest in self._manifests():
                manifest.unlink(missing_ok=True)
            return self._rename_aside()

    @property
    def is_set_aside(self) -> bool:
        """Whether older pictures of the level are set aside."""
        return self._last_number() > 0

    def put_back(self) -> list[Path]:
        """Exchange the pictures for those set aside last; return the stores that are back.

        Pictures taken since are set aside in turn. Manifests are removed first, as by `set_aside`.

        Raises
        ------
        InputError
            When no pictures of the level are set aside.
        """
        number = self._last_number()
        if not number:
            raise InputError(
                f"--put-back: no pictures are set aside in {self.path.absolute()}; name a level "
                "with a store capture.before_1.zarr"
            )
        with StoreLock(self.folder.path):
            for manifest in self._manifests():
                manifest.unlink(missing_ok=True)
            self._rename_aside()
            stores = [self.path / f"{name}.zarr" for name in (*_CAPTURED, *_MERGED)]
            pairs = [(_numbered(store, number), store) for store in stores]
            return [aside.rename(store) for aside, store in pairs if aside.exists()]

    def _rename_aside(self) -> list[Path]:
        """Rename the stores of the pictures, all with the first number that is free."""
        stores = [self.path / f"{name}.zarr" for name in _CAPTURED]
        if is_dropped(self.path / "capture.zarr"):
            stores += [self.path / f"{name}.zarr" for name in _MERGED]
        number = self._last_number() + 1
        return [store.rename(_numbered(store, number)) for store in stores if store.exists()]

    def _last_number(self) -> int:
        """Largest number in the names of stores that are set aside, 0 where there are none."""
        numbers = (path.stem.rpartition("_")[2] for path in self.path.glob("*.before_*.zarr"))
        return max((int(number) for number in numbers if number.isdigit()), default=0)

    def _manifests(self) -> list[Path]:
        """Manifests of the pictures and of the stages after them, in the reverse order of stages.

        Later levels follow from the refinement; those after level 0 are also merged by its black
        level.
        """
        folder, captured = self.folder, with_followers(self.folder.manifest(self.level, "capture"))
        if self.level == VERIFICATION:
            return [folder.path / "verification.json", *reversed(captured)]
        first = "merge" if self.level == 0 else "refine"
        below = [
            folder.manifest(level, stage)
            for level in reversed(folder.levels())
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
    """Return the levels of names, ``SCENE/METHOD/LEVEL`` or all of ``SCENE/METHOD``.

    Parameters
    ----------
    results : Path
        Of the run.
    names : sequence of str
        A level is its number, ``L02`` or ``2``, or ``verification``, the pictures that were taken
        to verify the transport, which are among all levels.
    acquisitions : collection of (str, str), optional
        Scenes and methods of the settings.
    option : str
        Name of the command's option, for messages.

    Raises
    ------
    InputError
        When nothing is captured by a name, which then says the nearest ones, or the settings don't
        have it.
    """
    captured = dict(_captured(results))
    retakes: dict[str, Retake] = {}
    for name in names:
        wanted = [key for key in captured if key == _normal(name) or _is_in(key, _normal(name))]
        if not wanted:
            raise InputError(f"{option} {_unknown(name, results, list(captured))}")
        scene, method, *_ = wanted[0].split("/")
        if acquisitions is not None and (scene, method) not in acquisitions:
            raise InputError(
                f"{option} {name}: the settings have no acquisition of {scene} by {method}, only "
                f"{', '.join('/'.join(each) for each in acquisitions)}. Add it to them first"
            )
        retakes |= {key: captured[key] for key in wanted}
    return list(retakes.values())


def is_whole(retakes: Collection[Retake], folder: AcquisitionFolder) -> bool:
    """Whether retakes have all levels that are captured of an acquisition."""
    levels = {retake.level for retake in retakes if retake.folder.path == folder.path}
    captured = _captured(folder.path.parents[1])
    return levels >= {each.level for _, each in captured if each.folder.path == folder.path}


def _captured(results: Path) -> Iterator[tuple[str, Retake]]:
    """Yield the name and level of each capture: begun, complete, or set aside."""
    stores = (
        path
        for stem in ("capture", REFERENCE_BRACKETS)
        for path in (
            *results.glob(f"*/*/*/{stem}.zarr"),
            *results.glob(f"*/*/*/{stem}.before_*.zarr"),
        )
    )
    for place in sorted({store.parent for store in stores}):
        folder, name = AcquisitionFolder(place.parent), "/".join(place.parts[-3:])
        if place.name == "verification":
            yield name, Retake(folder, VERIFICATION)
        elif place.name.startswith("L") and place.name[1:].isdigit():
            yield name, Retake(folder, int(place.name[1:]))


def _normal(name: str) -> str:
    """Return a name with its level as folders have it: 2 and L2 are L02."""
    scene_and_method, _, level = name.strip("/").rpartition("/")
    number = level.removeprefix("L").removeprefix("l")
    if number.isdigit() and "/" in scene_and_method:
        return f"{scene_and_method}/L{int(number):02d}"
    return name.strip("/")


def _is_in(key: str, name: str) -> bool:
    return name.count("/") == 1 and key.startswith(f"{name}/")


def _unknown(name: str, results: Path, known: list[str]) -> str:
    """Describe a name by which nothing is captured."""
    if not known:
        return f"{name}: nothing is captured in {results.absolute()}"
    acquisitions = dict.fromkeys(key.rpartition("/")[0] for key in known)
    names = [*acquisitions, *known]
    similar = similar_names(_normal(name), names, count=_NEAREST, cutoff=0.5)
    nearest = similar or list(acquisitions)[:_NEAREST]
    return (
        f"{name}: nothing is captured by this name in {results.absolute()}; expected "
        f"SCENE/METHOD or SCENE/METHOD/LEVEL, such as {', '.join(nearest)}"
    )


def _numbered(store: Path, number: int) -> Path:
    """Name of a store that is set aside."""
    return store.with_name(f"{store.stem}.before_{number}{store.suffix}")
