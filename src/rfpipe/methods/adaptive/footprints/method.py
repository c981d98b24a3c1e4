"""Footprint acquisition: near/far acquisition for rigs that aren't coaxial.

Direct light and indirect light are found together from random patterns, as in near/far acquisition.
Here nothing says which projector pixels a camera pixel sees: that is found from the same pictures,
with no structured light. Where the model doesn't fit, dual photography follows.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.methods.adaptive.decisions import footprints, is_unfit
from rfpipe.methods.adaptive.estimate import HELD_OUT, MOST_HELD_OUT, relit
from rfpipe.methods.adaptive.footprints.candidates import Candidates
from rfpipe.methods.adaptive.footprints.model import Model, find
from rfpipe.methods.adaptive.footprints.series import series_of, unit_of
from rfpipe.methods.adaptive.patterns import view_patterns
from rfpipe.methods.adaptive.rounds import Adaptive, AdaptiveState
from rfpipe.methods.base import ErrorOptions, Float, LevelImages, Method, get_method, options_of
from rfpipe.methods.images import Pictures
from rfpipe.methods.states import kept
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport
from rfpipe.transport.sum import SumTransport

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Random patterns of each round, a level. The first has to be enough to find footprints. Of several
# views, which are lit one at a time, each has as many as the second tuple tells.
ROUNDS = (24, 26, 36, 48, 64, 80)
_VIEW_ROUNDS = (24, 12, 16, 24, 32, 40)

_log = logging.getLogger(__name__)


def in_round(number: int, views: int) -> int:
    """Return the patterns of a round, numbered from 0, of a projector of so many views."""
    if views == 1:
        return ROUNDS[number]
    # each view is lit whole at first
    return views * (_VIEW_ROUNDS[number] + (number == 0))


def most_of(views: int) -> int:
    """Return the patterns of all rounds, the floodlit and the held-out ones among them."""
    return 1 + MOST_HELD_OUT + sum(in_round(number, views) for number in range(len(ROUNDS)))


@dataclass(frozen=True)
class FootprintState(AdaptiveState):
    """The state of a footprint acquisition.

    Attributes
    ----------
    model : dict of str to ndarray, optional
        The arrays of the `FootprintTransport` of the last fit.
    found : Candidates, optional
        With what the next search begins, in the unit of the fits.
    """

    model: dict[str, NDArray[Any]] | None = kept(dict)
    found: Candidates | None = kept(Candidates)


class Footprints(Adaptive):
    """Footprint acquisition as a `Method`, for any rig.

    Rounds of random patterns are fitted until the estimate of the error, from pictures that no fit
    sees, is at most ``target_error``. Where the model doesn't fit, or more rounds don't help, dual
    photography follows, no finer than the target asks for. The held-out pictures decide what is
    returned, whenever that is asked, and how good it is.
    """

    name = "footprints"
    title = "Footprint acquisition"
    colour = "#6a3d9a"
    marker = "p"
    bytes_per_ray = 100_000
    trials = (0.05, 0.01, 0.005)
    State = FootprintState

    @cached_property
    def hierarchy(self) -> Method[Any]:
        """Dual photography."""
        return get_method("dual")

    def expected_patterns(
        self, camera: RayDomain, projector: RayDomain, options: ErrorOptions
    ) -> int:
        """Return the patterns of all rounds: more views, more patterns."""
        return min(projector.size, options.patterns or most_of(projector.views))

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: ErrorOptions) -> int:
        """Return those of a scene for which all blocks are lit one by one, after all rounds."""
        inner = options_of(self.hierarchy)
        return most_of(projector.views) + self.hierarchy.most_patterns(camera, projector, inner)

    def levels(self, projector: RayDomain) -> tuple[tuple[str, int], ...]:
        """Return rounds, then the levels of dual photography below its floodlit one."""
        rounds = (("model", in_round(k, projector.views)) for k in range(len(ROUNDS)))
        return (*rounds, *(("hierarchy", 0),) * (BlockTree(projector).n_levels - 1))

    def _in_round(self, state: AdaptiveState) -> int:
        """Return the patterns of the next round; none where held-out ones are all that is left."""
        if state.unfit or state.reached:
            return 0
        return super()._in_round(state)

    def _patterns(self, state: AdaptiveState, count: int) -> NDArray[np.bool_]:
        return view_patterns(state.projector.shape, state.level, count)

    def _begun(self, state: AdaptiveState, images: LevelImages) -> AdaptiveState:
        after = super()._begun(state, images)
        return after.changed(unfit=not after.pictures.shine() or not self._fits(state))

    def _fits(self, state: AdaptiveState) -> bool:
        """Tell whether a rig is large enough for random patterns to pay."""
        rays, views = state.projector.size, state.projector.views
        limit = state.options.patterns
        # the whole view, and four patterns of each
        if views > 1 and limit and limit <= 1 + HELD_OUT + 5 * views:
            return False
        # smaller projectors are lit block by block at once
        return rays >= 4 * ROUNDS[0] * views

    def _fitted(self, state: AdaptiveState, images: LevelImages, first: int) -> AdaptiveState:
        """Fit the model to a round's pictures and all before them."""
        assert isinstance(state, FootprintState)
        count, channels = images.schedule.count, state.channels
        more = Pictures.read(images, channels, state.camera.size, first, count)
        state = state.changed(taken=more)
        pictures, views = state.pictures, state.projector.views
        unit = unit_of(pictures)
        grey = series_of(pictures.grey() if channels > 1 else pictures, unit, views)
        indices = range(channels if channels > 1 else 0)
        parts = (series_of(pictures.channel(index), unit, views) for index in indices)
        model = find(state.camera, state.projector, grey, parts, state.found)
        arrays = _arrays_of(model, state.camera, state.projector, unit)
        nodes, scalar = len(arrays["cores_columns"]), len(arrays["footprints_columns"])
        return state.counted(nodes=nodes, scalar=scalar).changed(model=arrays, found=model.grey)

    def _candidates(self, state: AdaptiveState) -> Iterator[Transport]:
        """Yield the model, and the hierarchy if there is one."""
        rows = list(state.rows)
        yield SumTransport([_model_of(state)], rows)
        if state.inner is not None:
            yield SumTransport([self.hierarchy.transport(state.inner)], rows)

    def _dark(self, state: AdaptiveState) -> NDArray[np.bool_]:
        """Return the camera pixels with at most a 50th of their direct light."""
        assert state.held is not None
        lit = state.held.lit[0]
        direct = relit(_model_of(state).direct(), np.stack([lit, np.ones_like(lit)]))
        observed, full = direct.sum(axis=1)
        return ~np.asarray(observed > 0.02 * full)

    def _nearness(self, state: AdaptiveState) -> Float:
        """Return how much of each projector ray's light arrives near where it lights, (*shape).

        Its indirect light, radiance, over the root mean square distance, in pixels of the camera,
        from the ray's footprint; 0 where the camera sees no footprint. Of rays that the camera
        hardly sees, the picture would be next to black.
        """
        transport = _model_of(state)
        _, height, width = state.camera.stack_shape
        ray = np.arange(state.camera.size)
        row, column = ray // width % height, ray % width
        moments = np.stack([np.ones_like(row), row, column, row**2 + column**2])
        light = np.repeat(moments.astype(np.float32)[:, None], transport.channels, axis=1)
        channels = range(transport.channels)
        total = transport.adjoint(light, channels).sum(axis=1, dtype=np.float64)
        direct = transport.direct().adjoint(light, channels).sum(axis=1, dtype=np.float64)
        sent = np.maximum(direct[0], np.finfo(np.float32).tiny)
        down, across = direct[1] / sent, direct[2] / sent
        weight, to_row, to_column, squares = total - direct
        distance = weight * (down**2 + across**2) + squares
        distance = distance - 2 * (down * to_row + across * to_column)
        there = (weight > 0) & (direct[0] > 0)
        mean = np.divide(distance, weight, out=np.ones_like(weight), where=there)
        reach = np.sqrt(np.clip(mean, 0.25, height**2 + width**2))
        nearness = np.where(there, weight / reach, 0)
        return nearness.astype(np.float32).reshape(state.projector.shape)

    def decided(self, state: AdaptiveState) -> AdaptiveState:
        """Go on, go another way, or end."""
        state = state.changed(unfit=is_unfit(state))
        following = footprints(state, len(ROUNDS))
        if following == "hierarchy":
            _log.info("the model of footprints leaves too much; going on with dual photography")
            # mean errors of relit pictures in tolerances of dual photography: of scenes with glass
            # and mirrors, where the model doesn't fit, 3 to 17, of diffuse scenes 1 to 6
            part = 10.0 if state.unfit else 3.0
            return self._hand_over(state, min(state.options.target_error / part, 0.01))
        return state.changed(following=following)


def _model_of(state: AdaptiveState) -> FootprintTransport:
    """Return the model, or, before there is one, what the floodlit image says."""
    arrays = state.model
    if arrays is None:
        from scipy.sparse import csr_array

        channels, pixels, rays = state.channels, state.camera.size, state.projector.size
        nothing: Any = csr_array((pixels, rays), dtype=np.float32)
        one = np.ones((1, 1), np.float32)
        arrays = {
            **_arrays("footprints", nothing, [nothing.data] * channels),
            **_arrays("left", csr_array(np.ones((pixels, 1), np.float32))),
            **_arrays("right", csr_array(np.ones((rays, 1), np.float32))),
            **_arrays("cores", csr_array(one), [np.full(1, 1 / rays, np.float32)] * channels),
            "camera_factor": np.maximum(state.pictures.floodlit, 0),
            "projector_factor": np.ones((channels, rays), np.float32),
        }
    shapes = state.camera.shape, state.projector.shape
    return FootprintTransport(*shapes, state.channels, [], arrays)


def _arrays_of(
    model: Model, camera: RayDomain, projector: RayDomain, unit: float
) -> dict[str, NDArray[Any]]:
    """Return the arrays of a `FootprintTransport`; the model is in units of so much radiance."""
    exchanges = [exchange for _, exchange in model.channels]
    functions = exchanges[0].functions
    direct = [candidates.matrix(camera.size, projector.size) for candidates, _ in model.channels]
    cores = [functions.cores(each.unknowns) for each in exchanges]
    return {
        **_arrays("footprints", direct[0], [each.data * np.float32(unit) for each in direct]),
        **_arrays("left", functions.left),
        **_arrays("right", functions.right),
        **_arrays("cores", cores[0], [each.data for each in cores]),
        "camera_factor": np.stack([each.camera * np.float32(unit) for each in exchanges]),
        "projector_factor": np.stack([each.projector for each in exchanges]),
    }


def _arrays(
    name: str, matrix: csr_array[Any], values: list[Float] | None = None
) -> dict[str, NDArray[Any]]:
    """Return a sparse matrix, values channel by channel, as a `FootprintTransport` holds it."""
    held = matrix.data.astype(np.float32) if values is None else np.stack(values)
    used = np.atleast_2d(held).any(axis=0)
    before = np.concatenate([[0], np.cumsum(used)])
    return {
        name: np.ascontiguousarray(held[..., used]),
        f"{name}_columns": matrix.indices[used].astype(np.int32),
        f"{name}_starts": before[matrix.indptr].astype(np.int32),
    }
