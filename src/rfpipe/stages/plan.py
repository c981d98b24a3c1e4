"""What the stages of one acquisition share: its settings, its folder and the method's state."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from rfpipe.blocks import RayDomain
from rfpipe.errors import IntegrityError
from rfpipe.methods import Method, Pack, Settings, get_method
from rfpipe.store import ArrayBundle, FrameStore, open_arrays, read_manifest

__all__ = ["REFERENCE", "AcquisitionFolder", "Plan", "advice_on_damage", "restore_state"]

REFERENCE = "reference"
"""The all-off and all-on brackets, taken with level 0: their store and their manifest's key."""


class Plan:
    """The settings of an acquisition that its method knows.

    Parameters
    ----------
    method : str
        A name in `rfpipe.methods.METHODS`.
    camera_shape, projector_shape : sequence of int
        (H, W) or (V, H, W).
    channels : int
        Colour channels, 1 or 3.
    **settings
        Those of `rfpipe.methods.Settings`.
    """

    def __init__(
        self,
        method: str,
        camera_shape: Sequence[int],
        projector_shape: Sequence[int],
        channels: int,
        **settings: Any,
    ) -> None:
        self.method: Method[Any] = get_method(method)
        self.camera = RayDomain(tuple(camera_shape))
        self.projector = RayDomain(tuple(projector_shape))
        self.channels = channels
        self.settings = Settings(**settings)

    @property
    def n_levels(self) -> int:
        """Number of levels; raises InputError where the method doesn't fit the rays."""
        return self.method.n_levels(self.camera, self.projector)

    def describe(self) -> dict[str, Any]:
        """Plain data for fingerprints."""
        return {
            "method": self.method.name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            **asdict(self.settings),
        }


@dataclass(frozen=True)
class AcquisitionFolder:
    """Where the manifests and stores of one acquisition lie.

    Parameters
    ----------
    path : Path
        ``results/{scene}/{method}``.
    """

    path: Path

    @classmethod
    def of_manifest(cls, manifest: str | Path) -> AcquisitionFolder:
        """Return the folder in which a level's manifest ``L{level:02d}/{stage}.json`` lies."""
        return cls(Path(manifest).parents[1])

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
    """Return the method's state before a level, from what the levels above it left.

    Raises
    ------
    StoreError, IntegrityError
        When a level's refinement is missing or damaged.
    """
    packs = []
    for above in range(level):
        bundle = folder.bundle(above, "refine")
        with advice_on_damage(folder.manifest(above, "refine")):
            arrays = {name: bundle.read(name) for name in bundle.names}
        packs.append(Pack(arrays, bundle.attributes["state"]))
    start = plan.method.start(plan.camera, plan.projector, plan.channels, plan.settings)
    return plan.method.restore(start, packs)
