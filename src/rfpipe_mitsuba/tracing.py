"""Rows and columns of a transport matrix, traced by Mitsuba."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe_mitsuba.chains import trace_chains
from rfpipe_mitsuba.merging import Ends
from rfpipe_mitsuba.particles import trace_particles
from rfpipe_mitsuba.paths import trace_paths
from rfpipe_mitsuba.pinholes import Pinholes
from rfpipe_mitsuba.sums import Sums
from rfpipe_mitsuba.views import Views
from rfpipe_mitsuba.volumes import trace_volumes

if TYPE_CHECKING:
    from rfpipe_mitsuba.light import Light

__all__ = ["Tracer"]

Double = NDArray[np.float64]

_LANES = 2**20  # paths at a time
_CHAINS = 2**18  # of mirrors and lenses, from all camera pixels
_MOST_CHAINS, _LEAST_CHAINS = 256, 16  # a pixel
_DIRECT_SAMPLES = 32  # a pixel, to tell where direct light falls


class Tracer:
    """Traces pieces of the matrix of one scene, rig and kind of light.

    Parameters
    ----------
    scene
        Mitsuba's scene.
    camera, projector
        The two sides.
    light
        What is followed.

    Attributes
    ----------
    is_whole : bool
        Whether each path is followed both ways, so that the matrix of a coaxial rig is symmetric:
        no mirror or lens is there, or caustics are followed.
    """

    def __init__(self, scene: Any, camera: Views, projector: Views, light: Light) -> None:
        self._scene, self._light = scene, light
        self._camera, self._projector = Pinholes(camera), Pinholes(projector)
        bent = [mi.BSDFFlags.DeltaReflection, mi.BSDFFlags.DeltaTransmission]
        through = _has(scene, mi.BSDFFlags.Null) or any(
            shape.is_medium_transition() for shape in scene.shapes()
        )
        self._trace_rows = trace_volumes if through else trace_paths
        self._bends = any(_has(scene, flag) for flag in bent)
        self.is_whole = light.caustics or not self._bends
        self._ends: dict[int, Ends | None] = {}

    def rows(self, half: int, first: int, last: int) -> Double:
        """Trace rows [first, last) of one half: float64 (last - first, N, 3)."""
        return self._traced(self._trace_rows, self._projector, 2 * half, first, last)

    def columns(self, half: int, first: int, last: int) -> Double:
        """Trace what caustics add to columns [first, last) of one half: (last - first, M, 3)."""
        if half not in self._ends:
            self._ends[half] = self._chain_ends(half) if self._bends else None
        trace = partial(trace_particles, ends=self._ends[half])
        return self._traced(trace, self._camera, 2 * half + 1, first, last)

    def _chain_ends(self, half: int) -> Ends | None:
        """Trace what the camera sees by mirrors and lenses, if anything."""
        wanted = np.clip(_CHAINS // self._camera.views.rays, _LEAST_CHAINS, _MOST_CHAINS)
        ends = trace_chains(
            self._scene,
            self._camera,
            samples=4 ** int(np.log2(wanted) / 2),
            bounces=self._light.bounces,
            seed=int(generator(self._light.seed, 2 * half + 5).integers(2**31)),
        )
        return Ends(ends) if len(ends.pixel) else None

    def direct(self, first: int, last: int) -> Double:
        """Trace rows [first, last) of direct light alone, roughly."""
        few = replace(self._light, bounces=1, samples=2 * _DIRECT_SAMPLES)
        tracer = copy(self)
        tracer._light = few
        return tracer.rows(2, first, last)

    def _traced(
        self, trace: Callable[..., None], others: Pinholes, stream: int, first: int, last: int
    ) -> Double:
        """Trace half of the samples of some pixels: float64 (last - first, others, 3)."""
        sums = Sums(first, last - first, others.views.rays)
        samples = self._light.samples // 2
        passed = 4 ** int(np.log2(min(samples, max(1, _LANES // sums.count))) / 2)
        passes = -(-samples // passed)
        for index in range(passes):
            seed = int(generator(self._light.seed, stream, first, index).integers(2**31))
            trace(
                self._scene,
                self._camera,
                self._projector,
                sums,
                samples=passed,
                bounces=self._light.bounces,
                seed=seed,
            )
            sums.flush()
        mean: Double = sums.to_numpy() / (passed * passes)
        return mean


def _has(scene: Any, flag: Any) -> bool:
    """Tell whether a surface of the scene has a flag of `BSDFFlags`."""
    return any(mi.has_flag(shape.bsdf().flags(), flag) for shape in scene.shapes())
