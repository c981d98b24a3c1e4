"""Physically based scenes by Mitsuba 3, as ground truth of a simulated rig."""

from __future__ import annotations

from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene, apply_in_batches
from rfpipe_mitsuba.light import Light
from rfpipe_mitsuba.recording import Recording, record
from rfpipe_mitsuba.variant import need_llvm
from rfpipe_mitsuba.views import Views
from rfpipe_mitsuba.world import World, load_scene

__all__ = ["MitsubaScene"]

Double = NDArray[np.float64]
_LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear sRGB (ITU-R BT.709)


class MitsubaScene(Scene):
    """A scene of Mitsuba 3 between cameras and projectors.

    Parameters
    ----------
    world
        The scene.
    camera, projector
        The two sides.
    channels
        Colour channels: 3, or 1 for its luminance.
    coaxial
        Whether the two sides are one.
    samples
        Paths a pixel, at least 2.
    bounces, caustics
        What light is followed; None for what the scene needs.
    seed
        Of the paths.
    rendered
        Whether Mitsuba renders each pattern, rather than recording the transport once.
    cache
        Folder of recorded matrices.
    """

    def __init__(
        self,
        world: World,
        camera: Views,
        projector: Views,
        *,
        channels: int = 3,
        coaxial: bool = False,
        samples: int = 16384,
        bounces: int | None = None,
        caustics: bool | None = None,
        seed: int = 0,
        rendered: bool = False,
        cache: Path = Path("results/recorded"),
    ) -> None:
        super().__init__(camera.domain, projector.domain, channels)
        self.world, self.camera, self.projector = world, camera, projector
        self.coaxial, self.cache = coaxial, cache
        self.light = Light(
            bounces or world.bounces,
            samples,
            (world.caustics if caustics is None else caustics) and not rendered,
            seed,
        )
        self.rendered = rendered

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            "scene": "mitsuba",
            "world": self.world.describe(),
            "camera": self.camera.describe(),
            "projector": self.projector.describe(),
            "light": self.light.describe(),
            "coaxial": self.coaxial,
            "channels": self.channels,
            "rendered": self.rendered,
            "mitsuba": metadata.version("mitsuba"),
        }

    @cached_property
    def recording(self) -> Recording:
        """The recorded matrix; recorded now, unless it was before.

        Raises
        ------
        InputError
            When it wasn't, and there is no LLVM to record it with.
        """
        described = {**self.describe(), "channels": 3}
        return record(
            self._loaded,
            self.camera,
            self.projector,
            self.light,
            self.cache / f"{self.world.name}-{fingerprint(described)[:12]}",
            coaxial=self.coaxial,
        )

    def _loaded(self) -> Any:
        need_llvm(f"scene {self.world.name}: light: recorded")
        return load_scene(self.world)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape).

        Raises
        ------
        InputError
            If the patterns don't have N rays each, no light comes back to the camera, or the
            transport can't be recorded here.
        """
        return apply_in_batches(
            self._rendered if self.rendered else self._recorded,
            patterns,
            self.projector_shape,
            self.channels,
            self.camera.rays,
        )

    def _recorded(self, weights: Double) -> Double:
        """Radiance (M, B, C) of patterns (N, B), by the recorded matrix."""
        radiance = np.empty((self.camera.rays, weights.shape[1], self.channels))
        for (first, last), matrices in zip(self.recording.pieces, self._matrices, strict=True):
            for channel, matrix in enumerate(matrices):
                radiance[first:last, :, channel] = matrix @ weights
        return radiance * self.recording.scale

    @cached_property
    def _matrices(self) -> list[list[Any]]:
        """The recorded matrix in memory, piece by piece, a sparse one a channel, float32."""
        pieces = (self.recording.piece(index) for index in range(len(self.recording.pieces)))
        return [piece if self.channels == 3 else [_luminance(piece)] for piece in pieces]

    @cached_property
    def _renderer(self) -> Any:
        from rfpipe_mitsuba.rendering import Renderer

        return Renderer(self.world, self.camera, self.projector, self.light)

    def _rendered(self, weights: Double) -> Double:
        """Radiance (M, B, C) of patterns (N, B), by rendering each."""
        dark = np.zeros((self.camera.rays, 3))  # as what a batch is filled up with
        colour = np.stack(
            [self._renderer.render(pattern) if pattern.any() else dark for pattern in weights.T],
            axis=1,
        )
        return colour if self.channels == 3 else colour @ np.array(_LUMINANCE)[:, None]

    def dense(self, channel: int = 0) -> Double:
        """The whole matrix (M, N) of one channel."""
        if self.rendered:
            return super().dense(channel)
        rows = [piece[channel].toarray() for piece in self._matrices]
        return np.concatenate(rows).astype(np.float64) * self.recording.scale


def _luminance(piece: list[Any]) -> Any:
    red, green, blue = (share * matrix for share, matrix in zip(_LUMINANCE, piece, strict=True))
    return red + green + blue
