"""Rows and columns of a transport matrix, traced by Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.mitsuba.beams import Pinholes, Rig, Sums
from rfpipe.mitsuba.caustics import Ends, trace_chains, trace_particles
from rfpipe.mitsuba.materials import surfaces_of
from rfpipe.mitsuba.paths import trace_paths, trace_volumes
from rfpipe.mitsuba.views import Side
from rfpipe.mitsuba.world import Light
from rfpipe.provenance import generator

Double = NDArray[np.float64]

_LANES = 2**20  # paths at a time
_CHAINS = 2**18  # of mirrors and lenses, from all camera pixels
_MOST_CHAINS, _LEAST_CHAINS = 256, 16  # a pixel
_DIRECT_SAMPLES = 32  # a pixel, to tell where direct light falls


class Tracer:
    """Traces pieces of the matrix of one scene of Mitsuba's, rig and kind of light.

    Attributes
    ----------
    is_whole : bool
        Whether each path is followed both ways, so that the matrix of a coaxial rig is symmetric:
        no mirror or lens is there, or caustics are followed.
    """

    def __init__(self, scene: Any, camera: Side, projector: Side, light: Light) -> None:
        self._rig = Rig(scene, Pinholes(camera), Pinholes(projector), light.bounces)
        self._light = light
        surfaces = surfaces_of(scene)
        through = any(surface.is_filled or surface.has("Null") for surface in surfaces)
        self._trace_rows = trace_volumes if through else trace_paths
        self._bends = any(surface.is_smooth for surface in surfaces)
        self.is_whole = light.caustics or not self._bends
        self._ends: dict[int, Ends | None] = {}

    def others(self, kind: str) -> int:
        """Length of ``rows``, or of ``columns``, in pixels."""
        sides = {"rows": self._rig.projector, "columns": self._rig.camera}
        return sides[kind].side.rays

    def rows(self, half: int, first: int, last: int) -> Double:
        """Trace rows [first, last) of one half: float64 (last - first, N, 3)."""
        trace = partial(self._trace_rows, self._rig)
        return self._traced(trace, self._light.samples, "rows", 2 * half, first, last)

    def columns(self, half: int, first: int, last: int) -> Double:
        """Trace what caustics add to columns [first, last) of one half: (last - first, M, 3)."""
        if half not in self._ends:
            self._ends[half] = self._chain_ends(half) if self._bends else None
        trace = partial(trace_particles, self._rig, ends=self._ends[half])
        return self._traced(trace, self._light.samples, "columns", 2 * half + 1, first, last)

    def direct(self, first: int, last: int) -> Double:
        """Trace rows [first, last) of direct light alone, roughly."""
        trace = partial(self._trace_rows, self._rig._replace(bounces=1))
        return self._traced(trace, 2 * _DIRECT_SAMPLES, "rows", 4, first, last)

    def _chain_ends(self, half: int) -> Ends | None:
        """Trace what the camera sees by mirrors and lenses, if anything."""
        chains = np.clip(_CHAINS // self._rig.camera.side.rays, _LEAST_CHAINS, _MOST_CHAINS)
        seed = int(generator(self._light.seed, 2 * half + 5).integers(2**31))
        ends = trace_chains(self._rig, 4 ** int(np.log2(chains) / 2), seed)
        return Ends(ends) if len(ends.pixel) else None

    def _traced(
        self,
        trace: Callable[[Sums, int, int], None],
        samples: int,
        kind: str,
        stream: int,
        first: int,
        last: int,
    ) -> Double:
        """Trace half of the samples of some pixels: float64 (last - first, others, 3)."""
        sums = Sums(first, last - first, self.others(kind))
        passed = 4 ** int(np.log2(min(samples // 2, max(1, _LANES // sums.count))) / 2)
        passes = -(-(samples // 2) // passed)
        for index in range(passes):
            trace(
                sums,
                passed,
                int(generator(self._light.seed, stream, first, index).integers(2**31)),
            )
            sums.flush()
        mean: Double = sums.to_numpy() / (passed * passes)
        return mean
