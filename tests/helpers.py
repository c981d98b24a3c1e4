"""Driving a method on a known matrix, in memory and without noise unless asked for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.methods import Method, Pack, options_of
from rfpipe.patterns import Schedule
from rfpipe.transport import Transport


@dataclass
class MatrixImages:
    """The images of one level as a rig of a known matrix would take them.

    `matrix` is (C, M, N); `sigma` the standard deviation of the noise added to each pixel.
    """

    matrix: NDArray[Any]
    camera_shape: tuple[int, ...]
    schedule: Schedule
    sigma: float = 0.0
    seed: int = 0

    def read(self, first: int, last: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        last = min(last, self.schedule.count)
        patterns = self.schedule.batch(first, last).reshape(last - first, -1).astype(np.float64)
        images = np.einsum("cmn,pn->pmc", self.matrix, patterns, optimize=True)
        if self.sigma:
            for index in range(first, last):
                random = np.random.default_rng([self.seed, self.schedule.level, index])
                images[index - first] += self.sigma * random.standard_normal(images.shape[1:])
        images = images.reshape(last - first, *self.camera_shape, len(self.matrix))
        radiance = images.astype(np.float32)
        return radiance, np.full_like(radiance, self.sigma**2)


@dataclass
class Acquisition:
    """What a run of a method left: its transport, and schedule, state and pack of each level."""

    transport: Transport
    schedules: list[Schedule]
    states: list[Any]
    packs: list[Pack]

    @property
    def patterns(self) -> list[int]:
        return [schedule.count for schedule in self.schedules]


def acquire_matrix(
    method: Method[Any],
    matrix: NDArray[Any],
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    tolerance: float = 1e-3,
    sigma: float = 0.0,
    seed: int = 0,
    subtract_stored: bool = True,
) -> Acquisition:
    """Acquire a matrix (M, N) or (C, M, N) level by level."""
    matrix = np.asarray(matrix)
    matrix = (matrix[None] if matrix.ndim == 2 else matrix).astype(np.float64)
    camera, projector = RayDomain(camera_shape), RayDomain(projector_shape)
    asked = {"tolerance": tolerance, "subtract_stored": subtract_stored}
    own = {name: asked[name] for name in method.Options.model_fields if name in asked}
    state = method.start(camera, projector, len(matrix), options_of(method, **own))
    schedules, states, packs = [], [state], []
    for _ in range(method.n_levels(camera, projector)):
        schedule = method.schedule(state)
        state = method.refine(state, MatrixImages(matrix, camera_shape, schedule, sigma, seed))
        schedules.append(schedule)
        states.append(state)
        packs.append(method.pack(state))
    return Acquisition(method.transport(state), schedules, states, packs)


def dense(transport: Transport) -> NDArray[np.float32]:
    """Return a small transport's matrices, (C, M, N)."""
    rays = int(np.prod(transport.projector_shape))
    impulses = np.eye(rays, dtype=np.float32).reshape(rays, *transport.projector_shape)
    columns = transport.relight_batch(impulses).reshape(rays, -1, transport.channels)
    return np.moveaxis(columns, (0, 1), (2, 1))
