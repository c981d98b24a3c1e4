"""Contract of acquisition methods: tests that every method should pass."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from math import prod
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.testing import assert_array_equal, assert_equal
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.methods import MethodDescription, StateArrays, options_of
from rfpipe.methods.base import MEMORY_BYTES, check_rays
from rfpipe.patterns import Schedule
from rfpipe.provenance import generator
from rfpipe.testing.checks import dot_test, require, require_close, require_raises
from rfpipe.transport import Transport, open_transport, save_transport

_COAXIAL = (6, 7), (6, 7)
_ANY = (3, 4), (5, 6)
_COUNTS = {"level", "patterns", "nodes", "empty", "rank1", "scalar", "subdivided"}


@dataclass
class MatrixImages:
    """The images of one level as a rig of a known matrix would take them.

    Parameters
    ----------
    matrix : ndarray of float, shape (C, camera rays, projector rays)
    camera_shape : tuple of int
    schedule : Schedule
    sigma : float
        Standard deviation of the noise of each pixel, radiance; at least 0.
    seed : int
        Seed of the noise. A pattern's noise doesn't depend on the batch in which it is read.
    """

    matrix: NDArray[Any]
    camera_shape: tuple[int, ...]
    schedule: Schedule
    sigma: float = 0.0
    seed: int = 0

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance of some patterns, ``(last - first, *camera_shape, C)``."""
        last = min(last, self.schedule.count)
        patterns = self.schedule.batch(first, last).reshape(last - first, -1).astype(np.float64)
        images = np.einsum("cmn,pn->pmc", self.matrix, patterns, optimize=True)
        if self.sigma:
            for index in range(first, last):
                random = np.random.default_rng([self.seed, self.schedule.seed, index])
                images[index - first] += self.sigma * random.standard_normal(images.shape[1:])
        shape = (last - first, *self.camera_shape, len(self.matrix))
        radiance = images.reshape(shape).astype(np.float32)
        return radiance, np.full_like(radiance, self.sigma**2)


@dataclass
class MethodRun:
    """Results of a run of a method: its transport, and the schedule and the state of each level.

    There is one state more than there are levels: the first is the state before level 0.
    """

    transport: Transport
    schedules: list[Schedule]
    states: list[Any]

    @property
    def patterns(self) -> list[int]:
        """Patterns of each level."""
        return [schedule.count for schedule in self.schedules]

    @property
    def changes(self) -> list[StateArrays]:
        """Arrays and attributes that each level added to the state."""
        return [state.to_arrays(previous) for previous, state in pairwise(self.states)]


def run_method(
    method: MethodDescription,
    matrix: NDArray[Any],
    camera_shape: tuple[int, ...],
    projector_shape: tuple[int, ...],
    *,
    sigma: float = 0.0,
    seed: int = 0,
    memory_bytes: int = MEMORY_BYTES,
    **options: Any,
) -> MethodRun:
    """Acquire a matrix ``(M, N)`` or ``(C, M, N)`` level by level, in memory.

    Parameters
    ----------
    method : MethodDescription
    matrix : ndarray of float
    camera_shape, projector_shape : tuple of int
        Shapes with M and N rays.
    sigma, seed
        Noise, as in `MatrixImages`.
    memory_bytes : int
        Memory limit, as in `Method.refine`.
    **options
        Options of the method.
    """
    matrix = np.asarray(matrix, np.float64)
    matrix = matrix[None] if matrix.ndim == 2 else matrix
    camera, projector = RayDomain(camera_shape), RayDomain(projector_shape)
    settings = options_of(method, **options)
    check_rays(method, camera, projector)
    chosen = method.for_rig(camera, projector)
    state = chosen.start(camera, projector, len(matrix), settings)
    schedules, states = [], [state]
    while (schedule := chosen.next_schedule(state)) is not None:
        images = MatrixImages(matrix, camera_shape, schedule, sigma, seed)
        state = chosen.refine(state, images, memory_bytes)
        schedules.append(schedule)
        states.append(state)
    return MethodRun(chosen.transport(state), schedules, states)


def matrix_of(transport: Transport) -> Float:
    """Return a small transport's matrices, float32 (C, M, N)."""
    rays = prod(transport.projector_shape)
    impulses = np.eye(rays, dtype=np.float32).reshape(rays, *transport.projector_shape)
    columns = transport.relight_batch(impulses).reshape(rays, -1, transport.channels)
    return np.moveaxis(columns, (0, 1), (2, 1))


class MethodContract:
    """Tests that any method must pass.

    Subclass it as ``Test...`` and define `make_method`.

    Attributes
    ----------
    options : dict
        Options with which the method is as exact as possible on the small matrices of these tests.
    error : float
        Largest relative error (Frobenius) of the light of each projector column in each channel,
        from exact radiance.
    floodlit_error : float
        Largest relative error of each channel's floodlit image.
    significance : float
        Largest light that noise may add beyond twice the true light, in standard deviations of the
        total light of brute force.
    """

    options: dict[str, Any] = {}  # noqa: RUF012 - a constant of each suite
    error: float = 0.1
    floodlit_error: float = 0.02
    significance: float = 6.0

    def make_method(self) -> MethodDescription:
        """Return the method."""
        raise NotImplementedError(f"{type(self).__name__} must define make_method()")

    def _shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        return _COAXIAL if self.make_method().needs_coaxial_rig else _ANY

    def _run(self, matrix: NDArray[Any], **changes: Any) -> MethodRun:
        method = self.make_method()
        return run_method(method, matrix, *self._shapes(), **{**self.options, **changes})

    def _matrix(self) -> NDArray[np.float64]:
        """Return direct light and smooth indirect light, symmetric where rays are shared."""
        camera, projector = (prod(shape) for shape in self._shapes())
        camera_position, projector_position = (
            np.linspace(0, 1, camera)[:, None],
            np.linspace(0, 1, projector),
        )
        smooth = np.exp(-3 * np.square(camera_position - projector_position)) / projector
        bright, dim = np.array([[1, 0.7, 0.4], [0.6, 0.8, 1]])[..., None, None]
        matrix: NDArray[np.float64] = np.eye(camera, projector) * bright + smooth * dim
        return matrix

    def test_it_describes_itself(self) -> None:
        """A method has a valid name, title, colour, described options, forecasts and rig check."""
        from matplotlib.colors import is_color_like

        method = self.make_method()
        require(bool(re.fullmatch(r"[a-z][a-z0-9_]*", method.name)), f"name is {method.name!r}")
        require(bool(method.title), "title is empty")
        require(
            is_color_like(method.colour), f"colour {method.colour!r} is not one of matplotlib's"
        )
        fields = method.Options.model_fields.items()
        bare = [name for name, field in fields if not field.description]
        require(not bare, f"options without a description: {', '.join(bare)}")
        for value in method.trials if method.trades else ():
            options_of(method, **{str(method.trades): value})
        message = require_raises(InputError, partial(options_of, method, no_such_option=1))
        require("no_such_option" in message, f"the message doesn't name it: {message}")
        options = options_of(method)
        for shape in ((1, 1), (8, 8), (62, 70), (3, 10, 11)):
            rays = RayDomain(shape)
            forecast = method.forecast(rays, rays, 3, options)
            require(forecast.patterns > 0, f"{forecast.patterns} patterns for {shape}")
            require(forecast.max_patterns >= forecast.patterns, f"{forecast} for {shape}")
            require(forecast.memory_bytes > 0, f"{forecast} for {shape}")
        if method.needs_coaxial_rig:
            matrix = np.zeros((prod(_ANY[0]), prod(_ANY[1])))
            require_raises(InputError, partial(run_method, method, matrix, *_ANY))

    def test_a_small_matrix_is_estimated(self) -> None:
        """Estimates match the matrix, are linear in light, and are stored exactly."""
        matrix = self._matrix()
        transport = self._run(matrix).transport
        estimate = matrix_of(transport)
        width = transport.projector_shape[-1]
        for channel, (measured, true) in enumerate(zip(estimate, matrix, strict=True)):
            name = f"floodlight in channel {channel}"
            require_close(measured.sum(1), true.sum(1), self.floodlit_error, name)
            for column in range(width):
                name = f"light of the projector's column {column} in channel {channel}"
                require_close(measured[:, column::width], true[:, column::width], self.error, name)
        dot_test(transport)
        twice = matrix_of(self._run(2 * matrix).transport)
        require_close(twice, 2 * estimate, 1e-4, "twice the light")
        first, second = generator(1).random((2, *transport.projector_shape), np.float32)
        apart = 2 * transport.relight(first) + 3 * transport.relight(second)
        joint = transport.relight(2 * first + 3 * second)
        require_close(joint, apart, 1e-5, "the image of a sum of patterns")
        with TemporaryDirectory(prefix="rfpipe-") as folder:
            save_transport(transport, Path(folder) / "transport.zarr")
            _require_same(open_transport(Path(folder) / "transport.zarr"), transport)

    def test_patterns_and_the_table_of_levels(self) -> None:
        """Weights are in [0, 1], complete schedules add up to full light; each level has a row."""
        run, shape = self._run(self._matrix()), self._shapes()[1]
        seeds = [schedule.seed for schedule in run.schedules]
        require(len(set(seeds)) == len(seeds), f"levels share seeds of their noise: {seeds}")
        for level, schedule in enumerate(run.schedules):
            require(schedule.count > 0, f"level {level} has no patterns")
            batch = schedule.batch(0, schedule.count)
            assert_equal(batch.shape, (schedule.count, *shape), "patterns")
            require(bool(((batch >= 0) & (batch <= 1)).all()), f"level {level}: not in [0, 1]")
            if schedule.complete:
                np.testing.assert_allclose(batch.sum(axis=0), 1, rtol=1e-5)
        rows = run.transport.level_rows
        assert_equal([(row["level"], row["patterns"]) for row in rows], [*enumerate(run.patterns)])
        for row in rows:
            require(set(row) >= _COUNTS, f"a row lacks {_COUNTS - set(row)}")
        estimates = any("estimated_error" in row for row in rows)
        assert_equal(estimates, self.make_method().estimates_error, "estimates_error")
        require(json.loads(json.dumps(rows)) == rows == list(run.states[-1].rows), f"{rows}")

    def test_a_state_is_restored_from_its_arrays(self) -> None:
        """A run resumed before any level continues with exactly the same state."""
        matrix, camera = self._matrix(), self._shapes()[0]
        camera_rays, projector_rays = map(RayDomain, self._shapes())
        method = self.make_method().for_rig(camera_rays, projector_rays)
        run = self._run(matrix)
        levels = [
            StateArrays(change.arrays, json.loads(json.dumps(dict(change.attributes))))
            for change in run.changes
        ]
        for level in range(len(levels) + 1):
            start = run.states[0]
            restored = type(start).from_arrays(start, levels[:level])
            _require_same(method.transport(restored), method.transport(run.states[level]))
            schedule = method.next_schedule(restored)
            if level == len(levels):
                require(schedule is None, "the restored state is not complete")
            else:
                assert schedule is not None
                assert_equal(schedule.digest(), run.schedules[level].digest(), "a schedule")
                after = method.refine(restored, MatrixImages(matrix, camera, schedule))
                _require_same(method.transport(after), method.transport(run.states[level + 1]))

    def test_memory_changes_nothing(self) -> None:
        """A memory limit of 64 KiB gives the same bytes as the default."""
        for sigma in (0.0, 0.01):
            small = self._run(self._matrix(), sigma=sigma, memory_bytes=2**16)
            _require_same(small.transport, self._run(self._matrix(), sigma=sigma).transport)

    def test_light_is_finite_and_bounded(self) -> None:
        """Dark scenes and dark channels give no light beyond that of noise."""
        matrix = self._matrix()
        dim = matrix * np.array([1, 0, 1])[:, None, None]
        for light, sigma in ((0 * matrix, 0.0), (0 * matrix, 0.1), (matrix, 0.3), (dim, 0.01)):
            estimate = matrix_of(self._run(light, sigma=sigma).transport)
            require(bool(np.isfinite(estimate).all()), f"NaN or infinite at noise {sigma}")
            if not light.any() and not sigma:
                require(not estimate.any(), "darkness gave light")
            total, true = estimate.sum((1, 2), dtype=np.float64), light.sum((1, 2))
            bound = 2 * true + self.significance * sigma * np.sqrt(matrix[0].size)
            require(
                bool((total <= bound).all()), f"{true} of light became {total} at noise {sigma}"
            )


def _require_same(actual: Transport, expected: Transport) -> None:
    (arrays, facts), (reference, expected_facts) = actual.pack(), expected.pack()
    assert_equal(sorted(arrays), sorted(reference), "names of arrays")
    for name, array in reference.items():
        assert_array_equal(arrays[name], array, name)
    require(
        json.loads(json.dumps(facts)) == json.loads(json.dumps(expected_facts)), f"{expected_facts}"
    )
