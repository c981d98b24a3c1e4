"""What the stages of one acquisition share: its settings, its folder and the method's state."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rfpipe.blocks import RayDomain
from rfpipe.errors import IntegrityError
from rfpipe.methods import Method, Pack, get_method, options_of
from rfpipe.store import ArrayBundle, FrameStore, open_arrays, read_manifest

if TYPE_CHECKING:
    from rfpipe.config import Config

__all__ = ["REFERENCE", "AcquisitionFolder", "Plan", "advice_on_damage", "plan_of", "restore_state"]

REFERENCE = "reference"
"""The all-off and all-on brackets, taken with level 0: their store and their manifest's key."""


class Plan:
    """What an acquisition's stages know of it: its method, with its options, and its rays.

    Parameters
    ----------
    name : str
        What the settings' section and the results' folder are called.
    method : str
        A method's name or path, see `rfpipe.methods.get_method`.
    camera_shape, projector_shape : sequence of int
        See `rfpipe.blocks.RayDomain`.
    channels : int
        Colour channels, 1 or 3.
    options : mapping
        The method's.

    Raises
    ------
    InputError
        When there is no such method, or it lacks an option.
    """

    def __init__(
        self,
        name: str,
        method: str,
        camera_shape: Sequence[int],
        projector_shape: Sequence[int],
        channels: int,
        options: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = name
        self.method: Method[Any] = get_method(method)
        self.camera = RayDomain(tuple(camera_shape))
        self.projector = RayDomain(tuple(projector_shape))
        self.channels = channels
        self.options = options_of(self.method, **(options or {}))
        self._carried: tuple[int, Any] | None = None

    @classmethod
    def of(cls, settings: Config, scene: str, name: str) -> Plan:
        """Return the plan of one of a run's acquisitions."""
        return cls(**plan_of(settings, scene, name))

    @property
    def n_levels(self) -> int:
        """Number of levels; raises InputError where the method doesn't fit the rays."""
        return self.method.n_levels(self.camera, self.projector)

    @property
    def target_error(self) -> float | None:
        """The error at which the method is to stop, if it is one that stops at an error."""
        return getattr(self.options, "target_error", None)

    def carry(self, level: int, state: Any) -> None:
        """Keep the method's state before a level for `restore_state`; None for one to restore."""
        self._carried = None if state is None else (level, state)

    def carried(self, level: int) -> Any:
        """Return the state before a level if it is kept, else None."""
        return self._carried[1] if self._carried and self._carried[0] == level else None

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints."""
        return {
            "name": self.name,
            "method": self.method.name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            "options": self.options.options(),
        }


def plan_of(settings: Config, scene: str, name: str) -> dict[str, Any]:
    """Return the arguments of one of a run's plans as plain data."""
    section, about = settings.methods_of(scene)[name], settings.scenes[scene]
    return {
        "name": name,
        "method": section.method or name,
        "camera_shape": list(about.camera_ray_shape),
        "projector_shape": list(about.ray_shape),
        "channels": about.channels,
        "options": section.options(),
    }


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
        return self.path / f"L{level:02d}" / f"{stage}.json"

    def store(self, level: int, stage: str) -> Path:
        """Store that the manifest is about."""
        return self.manifest(level, stage).with_suffix(".zarr")

    def read_manifest(self, level: int, stage: str) -> dict[str, Any]:
        """Read the manifest of a stage of a level; see `rfpipe.store.read_manifest`."""
        return read_manifest(self.manifest(level, stage))

    def refined_above(self, level: int) -> list[str]:
        """Digests of what the levels above a level found: all that its schedule rests on."""
        return [self.read_manifest(above, "refine")["digest"] for above in range(level)]

    def bundle(self, level: int, stage: str, part: str | None = None) -> ArrayBundle:
        """Open what a stage wrote, checked against its manifest.

        Parameters
        ----------
        level : int
        stage : str
        part : str, optional
            A second store that the stage's manifest describes under this key.

        Raises
        ------
        StoreError
            When manifest or store are missing.
        IntegrityError
            When they are damaged, or don't belong together.
        """
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        with advice_on_damage(manifest):
            bundle = open_arrays(self.store(level, part or stage))
            _check_digest(bundle.path, bundle.digest, expected[part] if part else expected)
        return bundle

    @contextmanager
    def frames(self, level: int, stage: str, part: str | None = None) -> Iterator[FrameStore]:
        """Open the frames that a stage wrote, checked against its manifest; as `bundle`."""
        manifest = self.manifest(level, stage)
        expected = read_manifest(manifest)
        path = self.store(level, part or stage)
        with advice_on_damage(manifest), FrameStore.open(path) as frames:
            _check_digest(path, frames.digest(), expected[part] if part else expected)
            yield frames


@contextmanager
def advice_on_damage(manifest: Path) -> Iterator[None]:
    """Say how to make a damaged store again: its stage runs when its manifest is missing."""
    try:
        yield
    except IntegrityError as error:
        raise IntegrityError(f"{error}. To do so, remove {manifest} and run again") from error


def _check_digest(path: Path, found: str, expected: dict[str, Any]) -> None:
    if found != expected["digest"]:
        raise IntegrityError(
            f"{path}: has the digest {found}; its manifest says {expected['digest']}. Run the "
            "stage that writes it again"
        )


def restore_state(plan: Plan, folder: AcquisitionFolder, level: int) -> Any:
    """Return the method's state before a level: carried from the one above, or what all left.

    Raises
    ------
    StoreError, IntegrityError
        When a level's refinement is missing or damaged.
    """
    if (carried := plan.carried(level)) is not None:
        return carried
    packs = []
    for above in range(level):
        bundle = folder.bundle(above, "refine")
        with advice_on_damage(folder.manifest(above, "refine")):
            arrays = {name: bundle.read(name) for name in bundle.names}
        packs.append(Pack(arrays, bundle.attributes["state"]))
    start = plan.method.start(plan.camera, plan.projector, plan.channels, plan.options)
    return plan.method.restore(start, packs)
