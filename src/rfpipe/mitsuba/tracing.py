"""Tracing rows and columns of a transport matrix with Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from rfpipe.array_types import Double
from rfpipe.mitsuba.beams import Pinholes, Sums, TracedScene
from rfpipe.mitsuba.caustics import Ends, trace_chains, trace_particles
from rfpipe.mitsuba.materials import shape_materials
from rfpipe.mitsuba.paths import trace_paths, trace_volumes
from rfpipe.mitsuba.views import Side
from rfpipe.mitsuba.world import TracingOptions
from rfpipe.provenance import generator

_LANES = 2**20  # paths traced at a time
_CHAINS = 2**18  # specular chains from all camera pixels
_MAX_CHAINS, _MIN_CHAINS = 256, 16  # per pixel
_DIRECT_SAMPLES = 32  # per pixel, to find which pixels direct light reaches


class Tracer:
    """Tracer of parts of the transport matrix of a scene.

    Attributes
    ----------
    is_symmetric : bool
        True if the matrix of a coaxial rig is symmetric: without specular surfaces, or with
        caustics, every path is traced in both directions.
    """

    def __init__(self, scene: Any, camera: Side, projector: Side, light: TracingOptions) -> None:
        self._rig = TracedScene(scene, Pinholes(camera), Pinholes(projector), light.bounces)
        self._light = light
        surfaces = shape_materials(scene)
        has_media = any(surface.is_filled or surface.has("Null") for surface in surfaces)
        self._trace_rows = trace_volumes if has_media else trace_paths
        self._has_specular = any(surface.is_smooth for surface in surfaces)
        self.is_symmetric = light.caustics or not self._has_specular
        self._ends: dict[int, Ends | None] = {}

    def length(self, kind: str) -> int:
        """Length of ``rows`` or ``columns`` in pixels."""
        sides = {"rows": self._rig.projector, "columns": self._rig.camera}
        return sides[kind].side.rays

    def rows(self, half: int, first: int, last: int) -> Double:
        """Trace rows [first, last) with half of the samples: float64 (last - first, N, 3)."""
        trace = partial(self._trace_rows, self._rig)
        return self._trace(trace, self._light.samples, "rows", 2 * half, first, last)

    def columns(self, half: int, first: int, last: int) -> Double:
        """Trace caustics in columns [first, last) with half of the samples: (columns, M, 3)."""
        if half not in self._ends:
            self._ends[half] = self._chain_ends(half) if self._has_specular else None
        trace = partial(trace_particles, self._rig, ends=self._ends[half])
        return self._trace(trace, self._light.samples, "columns", 2 * half + 1, first, last)

    def direct(self, first: int, last: int) -> Double:
        """Trace rows [first, last) of direct light only, with few samples."""
        trace = partial(self._trace_rows, self._rig._replace(bounces=1))
        return self._trace(trace, 2 * _DIRECT_SAMPLES, "rows", 4, first, last)

    def _chain_ends(self, half: int) -> Ends | None:
        """Trace specular chains from the camera; None if no chain reaches a diffuse surface."""
        chains = np.clip(_CHAINS // self._rig.camera.side.rays, _MIN_CHAINS, _MAX_CHAINS)
        seed = int(generator(self._light.seed, 2 * half + 5).integers(2**31))
        ends = trace_chains(self._rig, 4 ** int(np.log2(chains) / 2), seed)
        return Ends(ends) if len(ends.pixel) else None

    def _trace(
        self,
        trace: Callable[[Sums, int, int], None],
        samples: int,
        kind: str,
        stream: int,
        first: int,
        last: int,
    ) -> Double:
        """Trace half of the samples of some pixels: float64 (last - first, length, 3)."""
        sums = Sums(first, last - first, self.length(kind))
        batch = 4 ** int(np.log2(min(samples // 2, max(1, _LANES // sums.count))) / 2)
        n_batches = -(-(samples // 2) // batch)
        for index in range(n_batches):
            seed = int(generator(self._light.seed, stream, first, index).integers(2**31))
            trace(sums, batch, seed)
            sums.flush()
        mean: Double = sums.to_numpy() / (batch * n_batches)
        return mean
