"""Smooth indirect light by least squares."""

from __future__ import annotations

import numpy as np
import pytest
from tests.helpers import scene_matrices

from rfpipe.methods.adaptive.patterns import probe_patterns
from rfpipe.methods.adaptive.smooth import as_transport, fit
from rfpipe.methods.adaptive.smooth_fit import (
    Evidence,
    Observations,
    Patches,
    solve,
)
from rfpipe.methods.images import Pictures
from rfpipe.transport.multiscale import MultiscaleBasis, cells, functions_over

SHARE = 0.002


# --- the fit


def made_up_frames(rays: int, patterns: int) -> Pictures:
    random = np.random.default_rng(0)
    floodlit, variance = random.uniform(0.2, 1, rays), random.uniform(1e-4, 1e-3, rays)
    lit = np.concatenate([np.ones((1, rays), bool), random.random((patterns, rays)) < 0.5])
    radiance = np.concatenate([floodlit[None], random.uniform(0, 1, (patterns, rays))])
    spread = np.concatenate([variance[None], random.uniform(1e-3, 1e-2, (patterns, rays))])
    return Pictures(lit, radiance[:, None].astype(np.float32), spread[:, None].astype(np.float32))


def column_by_column(basis: MultiscaleBasis, pictures: Pictures) -> np.ndarray:
    """What each core alone adds to the pictures, ``F (K F p - p K F 1)``, (M N, pairs)."""
    factor = pictures.floodlit[0].astype(np.float64)
    patterns = pictures.probes.lit.astype(np.float64)
    weights = basis.weights.toarray().astype(np.float64)
    columns = []
    for first, second in zip(basis.first, basis.second, strict=True):
        core = np.zeros((len(basis), len(basis)))
        core[first, second] = core[second, first] = 1
        smooth = weights @ core @ weights.T
        full = smooth @ factor
        columns.append([factor * (smooth @ (factor * p) - p * full) for p in patterns])
    return np.reshape(columns, (len(columns), -1)).T


@pytest.mark.parametrize(("shape", "scales"), [((5, 6), [1]), ((7, 6), [2, 1]), ((2, 3, 4), [2])])
def test_cores_are_those_of_the_dense_least_squares(
    shape: tuple[int, ...], scales: list[int]
) -> None:
    wanted = [np.ones(cells(shape, scale), np.bool_) for scale in scales]
    if len(scales) > 1:
        wanted[1][0, 2:] = False
    parts = [functions_over(*part) for part in zip(scales, wanted, strict=True)]
    basis = MultiscaleBasis(shape, np.concatenate(parts))
    pictures = made_up_frames(int(np.prod(shape)), 6)
    seen = Observations.of(Patches(basis), Evidence.of(pictures, SHARE))
    deviations = np.random.default_rng(1).uniform(0.1, 0.5, len(basis.first)).astype(np.float32)

    probes, factor = pictures.probes, pictures.floodlit[0].astype(np.float64)
    patterns = probes.lit.astype(np.float64)
    spread = probes.variance[:, 0] + patterns * pictures.variance[0, 0] + (SHARE * factor) ** 2
    certainty = 1 / np.sqrt(spread.ravel())
    shown = (probes.radiance[:, 0] - patterns * factor).ravel()
    system = np.concatenate(
        [certainty[:, None] * column_by_column(basis, pictures), np.diag(1 / deviations)]
    )
    aim = np.concatenate([certainty * shown, np.zeros(len(deviations))])
    expected = np.linalg.lstsq(system, aim, rcond=None)[0]

    found = solve(seen, deviations, 1e-6, 3000)
    assert found.dtype == np.float32
    apart = np.linalg.norm((found - expected) / deviations)
    assert apart < 1e-3 * np.linalg.norm(expected / deviations)
    near = solve(seen, deviations, 1e-6, 3000, start=np.float32(0.9) * found)
    np.testing.assert_allclose(near, found, atol=1e-3 * float(np.abs(found).max()))


def test_channels_are_found_from_what_all_of_them_told_and_dark_ones_stay_dark() -> None:
    shape = (24, 24)
    matrix = scene_matrices("IV", shape, 3)
    lit = np.concatenate([np.ones((1, *shape), bool), probe_patterns(shape, 1, 12)]).reshape(13, -1)
    matrix[2] = 0
    radiance = np.einsum("mn,crn->mcr", lit, matrix).astype(np.float32)
    pictures = Pictures(lit, radiance, np.full_like(radiance, 1e-8))
    model = fit(shape, pictures)
    assert not model.cores[2].any()
    pattern = (np.arange(576) % 24 < 8).astype(np.float32)
    transport = as_transport(shape, [], model, pictures)
    image = transport.forward(np.broadcast_to(pattern, (1, 3, 576)), range(3))[0]
    for found, expected in zip(image[:2], (matrix @ pattern)[:2], strict=True):
        assert np.linalg.norm(found - expected) < 0.02 * np.linalg.norm(expected)
