"""Compressive sensing: sparse rows of T from random patterns of on and off."""

from pathlib import Path

import numpy as np
import pytest
from tests.helpers import acquire_matrix, dense

from rfpipe import OperatorRig, acquire
from rfpipe.blocks import RayDomain
from rfpipe.config import CameraConfig
from rfpipe.errors import InputError
from rfpipe.methods import options_of
from rfpipe.methods.rivals.compressive import Compressive
from rfpipe.methods.rivals.pursuit import pursue, rays_and_wavelets
from rfpipe.scenes import reference_scene
from rfpipe.store.arrays import open_arrays, write_arrays
from rfpipe.transport import open_transport, save_transport


def sparse(rows: int, rays: int, entries: int, seed: int = 0) -> np.ndarray:
    random = np.random.default_rng(seed)
    matrix = np.zeros((rows, rays))
    for row in matrix:
        row[random.choice(rays, entries, replace=False)] = 0.2 + random.random(entries)
    return matrix


def relative(found: np.ndarray, matrix: np.ndarray) -> float:
    return float(np.linalg.norm(found - matrix) / np.linalg.norm(matrix))


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (8, 8), (5, 9), (3, 4, 5)])
def test_the_dictionary_holds_all_rays_and_an_orthonormal_set_of_wavelets(
    shape: tuple[int, ...],
) -> None:
    rays = RayDomain(shape).size
    atoms = rays_and_wavelets(RayDomain(shape)).toarray()
    np.testing.assert_array_equal(atoms[:rays], np.eye(rays))
    np.testing.assert_allclose(atoms[rays:] @ atoms[rays:].T, np.eye(rays), atol=1e-12)
    np.testing.assert_allclose(atoms[rays + 1 :].sum(axis=1), 0, atol=1e-12)


def test_wavelets_are_constant_over_halves_of_blocks() -> None:
    wavelets = rays_and_wavelets(RayDomain((4, 4))).toarray()[17:].reshape(-1, 4, 4)
    largest = wavelets[0]
    np.testing.assert_allclose(largest, np.repeat([0.25, -0.25], 8).reshape(4, 4))
    assert sorted(np.count_nonzero(one) for one in wavelets) == [2] * 8 + [4] * 4 + [8] * 2 + [16]


def test_pursuit_finds_the_atoms_and_stops() -> None:
    random = np.random.default_rng(1)
    atoms = 3 * random.standard_normal((80, 40))
    signals = np.stack([2 * atoms[7] - atoms[33], np.zeros(40), 5 * atoms[70]])
    chosen, factors = pursue(atoms, signals, np.full(3, 1e-12), most=6)
    assert [set(row[row >= 0].tolist()) for row in chosen] == [{7, 33}, set(), {70}]
    np.testing.assert_allclose(np.sort(factors[0])[[0, -1]], [-1, 2], atol=1e-9)
    np.testing.assert_allclose(factors[2].sum(), 5)


def test_pursuit_takes_no_atom_twice_nor_one_in_the_span_of_others() -> None:
    atoms = np.array([[1.0, 0, 0], [0, 1, 0], [1, 1, 0]])
    chosen, factors = pursue(atoms, np.array([[1.0, 1, 1]]), np.zeros(1), most=3)
    assert chosen[0].tolist() == [2, -1, -1]
    assert np.isfinite(factors).all()


def test_pursuit_stops_at_the_noise() -> None:
    random = np.random.default_rng(2)
    atoms = random.standard_normal((300, 100))
    noise = 0.1 * random.standard_normal((50, 100))
    chosen, _ = pursue(atoms, 5 * atoms[:50] + noise, np.full(50, 0.01 * 100 * 1.3), most=20)
    assert (chosen[:, 0] == np.arange(50)).all()
    assert (chosen[:, 1:] == -1).mean() > 0.99


@pytest.mark.parametrize(("camera", "projector"), [((16, 16), (16, 16)), ((3, 4), (13, 17))])
def test_a_sparse_matrix_is_recovered_from_a_quarter_of_its_columns(
    camera: tuple[int, ...], projector: tuple[int, ...]
) -> None:
    rays = RayDomain(projector).size
    matrix = sparse(RayDomain(camera).size, rays, 4)
    rig = OperatorRig(matrix, camera, projector)
    result = acquire(rig, "compressive", progress=False, patterns=64)
    assert result.patterns == 64
    assert relative(dense(result.transport)[0], matrix) < 1e-4


def test_too_few_patterns_do_not_recover_it() -> None:
    matrix = sparse(64, 256, 8)
    rig = OperatorRig(matrix, (8, 8), (16, 16))
    result = acquire(rig, "compressive", progress=False, patterns=20)
    assert relative(dense(result.transport)[0], matrix) > 0.1


def test_blocks_of_light_are_sparse_too() -> None:
    matrix = np.eye(256)
    matrix[:, 100:104] += 0.5
    matrix.reshape(256, 16, 16)[:, 8:, 8:] += 0.01
    rig = OperatorRig(matrix, (16, 16), (16, 16))
    result = acquire(rig, "compressive", progress=False, patterns=64)
    assert relative(dense(result.transport)[0], matrix) < 1e-4


def test_a_noisy_scene_is_relit_better_than_by_direct_light_alone() -> None:
    scene = reference_scene("II", (16, 16), channels=1).dense(0)
    rig = OperatorRig(scene, (16, 16), (16, 16), CameraConfig())
    result = acquire(rig, "compressive", progress=False, patterns=64)
    pattern = np.zeros((16, 16))
    pattern[:, 3:5] = 1
    truth = scene @ pattern.ravel()
    direct = np.diag(scene) * pattern.ravel()
    relit = result.transport.relight(pattern).ravel()
    assert np.linalg.norm(relit - truth) < 0.7 * np.linalg.norm(direct - truth)


def test_colours_are_recovered_one_by_one_and_a_dark_one_stays_dark() -> None:
    matrix = np.stack([sparse(64, 64, 2), sparse(64, 64, 2, seed=1), np.zeros((64, 64))])
    run = acquire_matrix(Compressive(), matrix, (8, 8), (8, 8))
    assert run.patterns == [1, 31]
    np.testing.assert_allclose(dense(run.transport), matrix, atol=1e-4)


@pytest.mark.parametrize("shape", [(1, 1), (1, 2), (3, 1), (1, 37), (2, 3, 4)])
def test_small_domains_of_any_shape(shape: tuple[int, ...]) -> None:
    rays = RayDomain(shape).size
    run = acquire_matrix(Compressive(), np.eye(rays), shape, shape)
    ones = np.ones(shape)
    np.testing.assert_allclose(run.transport.relight(ones)[..., 0], ones, rtol=1e-3)


def test_before_the_random_patterns_light_is_spread_evenly() -> None:
    matrix = sparse(12, 64, 5)
    method = Compressive()
    run = acquire_matrix(method, matrix, (3, 4), (8, 8))
    half = np.zeros((8, 8))
    half[:4] = 1
    relit = method.transport(run.states[1]).relight(half).ravel()
    np.testing.assert_allclose(relit, matrix.sum(axis=1) / 2, rtol=1e-5)


def test_states_go_through_a_store_and_transports_too(tmp_path: Path) -> None:
    method = Compressive()
    run = acquire_matrix(method, sparse(12, 64, 3), (3, 4), (8, 8))
    assert method.restore(run.states[0], []) is run.states[0]
    packs = []
    for level, pack in enumerate(run.packs):
        write_arrays(tmp_path / f"{level}.zarr", dict(pack.arrays), {"state": pack.attributes})
        bundle = open_arrays(tmp_path / f"{level}.zarr")
        arrays = {name: bundle.read(name) for name in bundle.names}
        packs.append(type(pack)(arrays, bundle.attributes["state"]))
        restored, after = method.restore(run.states[0], packs), run.states[level + 1]
        assert (restored.level, restored.rows) == (after.level, after.rows)
        np.testing.assert_array_equal(restored.matrix, after.matrix)
        np.testing.assert_array_equal(restored.floodlit, after.floodlit)
        np.testing.assert_array_equal(restored.variance, after.variance)
    save_transport(run.transport, tmp_path / "transport.zarr", "uint8")
    stored = open_transport(tmp_path / "transport.zarr")
    np.testing.assert_array_equal(dense(stored), dense(run.transport))


def test_a_large_domain_is_refused() -> None:
    large = RayDomain((65, 64))
    with pytest.raises(InputError, match="up to 4096 rays, beyond which it would take hours"):
        Compressive().start(RayDomain((2, 2)), large, 1, options_of(Compressive()))
    with pytest.raises(InputError, match="4160 camera rays"):
        Compressive().start(large, RayDomain((2, 2)), 1, options_of(Compressive()))
