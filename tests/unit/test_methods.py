"""What every acquisition method has in common."""

import json

import numpy as np
import pytest
from tests.helpers import MatrixImages, acquire_matrix, dense

from rfpipe.blocks import RayDomain
from rfpipe.methods import Pack, get_method, method_names, options_of
from rfpipe.scenes import reference_scene
from rfpipe.testing import dot_test

SHAPE = (6, 7)
RAYS = 42
NAMES = method_names()


@pytest.fixture(scope="module")
def matrix() -> np.ndarray:
    return np.stack([reference_scene("IV", SHAPE).dense(channel) for channel in range(3)])


def test_methods_are_told_apart() -> None:
    methods = [get_method(name) for name in NAMES]
    assert len({method.title for method in methods}) == len(NAMES) == 7
    assert len({method.colour for method in methods}) == len(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_methods_go_by_their_names(name: str) -> None:
    assert get_method(name).name == name


@pytest.mark.parametrize("name", NAMES)
def test_patterns_are_light_and_the_same_each_time(name: str, matrix: np.ndarray) -> None:
    run = acquire_matrix(get_method(name), matrix, SHAPE, SHAPE)
    for level, (state, schedule) in enumerate(zip(run.states[:-1], run.schedules, strict=True)):
        assert (schedule.level, schedule.shape) == (level, SHAPE)
        shown = schedule.batch(0, schedule.count)
        assert shown.dtype == np.float32
        assert shown.shape == (schedule.count, *SHAPE)
        assert ((shown >= 0) & (shown <= 1)).all()
        if schedule.complete:
            np.testing.assert_allclose(shown.sum(axis=0), 1)
        assert get_method(name).schedule(state).digest() == schedule.digest()


@pytest.mark.parametrize("name", NAMES)
def test_all_light_is_accounted_for(name: str, matrix: np.ndarray) -> None:
    run = acquire_matrix(get_method(name), matrix, SHAPE, SHAPE, subtract_stored=True)
    floodlit = matrix.sum(axis=2).T.reshape(*SHAPE, 3)
    relit = run.transport.relight(np.ones(SHAPE))
    assert np.linalg.norm(relit - floodlit) < 0.02 * np.linalg.norm(floodlit)
    assert np.linalg.norm(dense(run.transport) - matrix) < 0.1 * np.linalg.norm(matrix)
    dot_test(run.transport)


@pytest.mark.parametrize("name", NAMES)
def test_the_table_of_levels_is_complete(name: str, matrix: np.ndarray) -> None:
    run = acquire_matrix(get_method(name), matrix, SHAPE, SHAPE)
    rows = run.transport.level_rows
    assert [row["level"] for row in rows] == list(range(len(run.patterns)))
    assert [row["patterns"] for row in rows] == run.patterns
    counts = {"level", "patterns", "nodes", "empty", "rank1", "scalar", "subdivided"}
    assert all(counts <= set(row) for row in rows)
    assert json.loads(json.dumps(rows)) == rows == list(run.states[-1].rows)


@pytest.mark.parametrize("name", NAMES)
def test_a_state_is_restored_from_what_its_levels_left(name: str, matrix: np.ndarray) -> None:
    method = get_method(name)
    run = acquire_matrix(method, matrix, SHAPE, SHAPE)
    packs = [Pack(pack.arrays, json.loads(json.dumps(pack.attributes))) for pack in run.packs]
    start = method.start(RayDomain(SHAPE), RayDomain(SHAPE), 3, options_of(method))
    for level in range(1, len(packs)):
        restored = method.restore(start, packs[:level])
        schedule = method.schedule(restored)
        assert schedule.digest() == run.schedules[level].digest()
        after = method.refine(restored, MatrixImages(matrix, SHAPE, schedule))
        expected, _ = method.transport(run.states[level + 1]).pack()
        found, _ = method.transport(after).pack()
        assert set(found) == set(expected)
        for part, array in expected.items():
            np.testing.assert_array_equal(found[part], array, err_msg=part)
    restored = method.restore(start, packs)
    np.testing.assert_array_equal(dense(method.transport(restored)), dense(run.transport))


@pytest.mark.parametrize("name", NAMES)
def test_darkness_gives_darkness(name: str) -> None:
    run = acquire_matrix(get_method(name), np.zeros((1, RAYS, RAYS)), SHAPE, SHAPE)
    assert not run.transport.relight(np.ones(SHAPE)).any()


@pytest.mark.parametrize("name", NAMES)
def test_a_guess_of_the_patterns_is_at_most_what_there_may_be(name: str) -> None:
    method, rays = get_method(name), RayDomain((62, 70))
    options = options_of(method)
    expected = method.expected_patterns(rays, rays, options)
    assert 0 < expected <= method.most_patterns(rays, rays, options)


@pytest.mark.parametrize(
    ("name", "asked", "patterns"),
    [
        ("compressive", {}, 542),
        ("compressive", {"patterns": 100}, 100),
        ("low_rank", {}, 512),
        ("low_rank", {"patterns": 100}, 100),
        ("near_far", {"patterns": 30}, 30),
        ("hadamard", {}, 4363),
        ("brute_force", {}, 4340),
    ],
)
def test_the_number_that_is_asked_for_counts_where_a_method_takes_it(
    name: str, asked: dict[str, int], patterns: int
) -> None:
    method, rays = get_method(name), RayDomain((62, 70))
    assert method.expected_patterns(rays, rays, options_of(method, **asked)) == patterns
