"""A recorded acquisition as a scene: its pictures answer for all light that its patterns span."""

from __future__ import annotations

from math import prod
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from rfpipe.config.base import Text
from rfpipe.config.scenes import AnyRig, SceneSettings
from rfpipe.errors import InputError, StoreError
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene
from rfpipe.stages.capture import read_sensor, symmetry_patterns
from rfpipe.stages.folder import SYMMETRY, AcquisitionFolder
from rfpipe.stages.merger import read_floodlit, read_merger
from rfpipe.stages.schedule import read_schedule
from rfpipe.units import SATURATION_FRACTION

# A pattern is spanned where the recorded ones make it up to within so much of full light.
_SPANNED = 1e-3
# Eigenvalues below this part of the largest one are rounding.
_ROUNDING = 1e-10


class RecordedOptions(AnyRig):
    """Which recording."""

    files: ClassVar[tuple[str, ...]] = ("folder",)

    folder: Text = Field(
        description="Folder of the recorded acquisition, such as results/desk/brute_force.",
    )
    complete: bool = Field(
        False,
        description="Whether the recorded patterns span all light, as those of brute_force and "
        "hadamard do.",
    )

    @property
    def has_truth(self) -> bool:
        """Whether any light can be asked for."""
        return self.complete


class Recorded(Scene):
    """A recorded acquisition, whose patterns span those that are asked for.

    Its pictures are merged radiance, noise included, all held in memory; a picture of another
    pattern is the same sum of them that makes up the pattern. Raises StoreError when nothing of the
    folder, ``results/{scene}/{method}``, is merged, IntegrityError when it is damaged.
    """

    Options: ClassVar[type[SceneSettings]] = RecordedOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:  # noqa: ARG003
        """Read the recording; InputError when it has another shape or number of channels."""
        scene = cls(options.folder)
        for name, found, expected in (
            ("shape", scene.projector_shape, options.ray_shape),
            ("camera_shape", scene.camera_shape, options.camera_ray_shape),
            ("channels", scene.channels, options.channels),
        ):
            if found != expected:
                raise InputError(
                    f"{options.folder}: was recorded with {name} {found}; the scene's settings say "
                    f"{expected}. Set them to the recording's"
                )
        return scene

    def __init__(self, folder: str | Path) -> None:
        recorded = AcquisitionFolder(Path(folder))
        floodlit, _ = read_floodlit(recorded)
        digests, patterns, images = [], [], [floodlit[None]]
        shape: tuple[int, ...] = ()
        for level in recorded.levels():
            if not recorded.exists(level, "merge"):
                break
            schedule = read_schedule(recorded, level)
            shape = schedule.shape
            with recorded.frames(level, "merge") as frames:
                digests.append(frames.digest())
                images.append(frames.read(0, schedule.count)[:, 0])
            patterns.append(schedule.batch(0, schedule.count).reshape(schedule.count, -1))
        random = _symmetry(recorded)
        if random is not None and shape:
            digests.append(fingerprint(random))
            images.append(random)
            lit, _ = symmetry_patterns(shape, len(random), 0, len(random))
            patterns.append(lit.reshape(len(random), -1))
        if not shape:
            raise StoreError(f"{folder}: no level of it is merged; run its acquisition first")
        super().__init__(floodlit.shape[:-1], shape, floodlit.shape[-1])
        self._folder, self._digests = str(folder), digests
        white = np.ones((1, prod(shape)), np.float32)
        self._patterns = np.concatenate([white, *patterns]).astype(np.float64)
        self._images = np.concatenate(images).reshape(len(self._patterns), -1)
        values, vectors = np.linalg.eigh(self._patterns @ self._patterns.T)
        kept = values > _ROUNDING * values[-1]
        self._inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape).

        Raises InputError where a pattern isn't spanned by those that were recorded.
        """
        asked = np.asarray(patterns, np.float64).reshape(len(np.asarray(patterns)), -1)
        if asked.shape[1] != prod(self.projector_shape):
            raise InputError(
                f"patterns of {asked.shape[1]} rays; the recording's have "
                f"{prod(self.projector_shape)}"
            )
        images = np.empty((len(asked), prod(self.camera_shape), self.channels), np.float32)
        for index, pattern in enumerate(asked):  # one by one, so that bits don't depend on others
            shares = self._inverse @ (self._patterns @ pattern)
            missed = float(np.abs(shares @ self._patterns - pattern).max())
            if not missed <= _SPANNED:
                raise InputError(
                    f"{self._folder}: the {len(self._patterns)} recorded patterns don't span "
                    f"pattern {index} of those asked for (off by up to {missed:.2g} of full "
                    "light). Replay the method that recorded them, or record by brute_force or "
                    "hadamard, whose patterns span all"
                )
            light = (shares.astype(np.float32) @ self._images).reshape(images.shape[1:])
            images[index] = np.maximum(light, 0)  # noise
        return images

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {"kind": "recorded", "merged": self._digests}


def _symmetry(folder: AcquisitionFolder) -> NDArray[np.float32] | None:
    """Return the radiance of the random patterns that it began with, if they are there."""
    if not folder.store(0, SYMMETRY).exists():
        return None
    merger = read_merger(read_sensor(folder), folder, SATURATION_FRACTION)
    with folder.frames(0, "capture", SYMMETRY) as frames:
        if frames.dropped:
            return None
        return merger.merge(frames.read(0, frames.shape[0]), 0).radiance
