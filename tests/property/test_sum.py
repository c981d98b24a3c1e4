"""Sums of transports of any kinds as linear operators, truncated and stored."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.property.test_hierarchical import random_transport, shapes

from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import InputError, IntegrityError
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.arrays import DenseTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.pairs import PairSet
from rfpipe.transport.sum import SumTransport

ROWS = [{"level": level, "patterns": 1} for level in range(9)]


def dense_part(shape, channels, rng):
    rays = int(np.prod(shape))
    matrix = rng.random((channels, rays, rays), dtype=np.float32)
    return DenseTransport(shape, shape, channels, ROWS[:1], {"matrix": matrix})


def random_sum(shape, channels, seed):
    """Return a sum of a dense, a signed hierarchical and a multilevel part."""
    rng = np.random.default_rng(seed)
    domain = RayDomain(shape)
    tree = BlockTree(domain)
    rays = np.arange(domain.size, dtype=np.int32)
    values = rng.random((channels, domain.size), dtype=np.float32)
    pairs = PairSet(tree.n_levels - 1, rays, tree.order.astype(np.int32), values)
    parts = [
        dense_part(shape, channels, rng),
        random_transport(shape, channels, seed, signed=True)[0],
        MultilevelTransport.from_pair_sets(domain, domain, channels, [], [pairs]),
    ]
    return SumTransport(parts, ROWS)


@settings(max_examples=25, deadline=None)
@given(shape=shapes, channels=st.sampled_from([1, 3]), seed=st.integers(0, 2**32 - 1))
def test_it_is_the_sum_of_its_parts_and_its_transpose_that_of_theirs(shape, channels, seed):
    total = random_sum(shape, channels, seed)
    rng = np.random.default_rng(seed)
    rays = int(np.prod(shape))
    pattern = rng.standard_normal(shape)
    for dual in (False, True):
        expected = sum((part.T if dual else part).relight(pattern) for part in total.parts)
        found = (total.T if dual else total).relight(pattern)
        np.testing.assert_allclose(found, expected, atol=1e-5 * rays)
    x, y = rng.standard_normal((2, rays))
    operator = total.channel(channels - 1)
    assert y @ (operator @ x) == pytest.approx(x @ (operator.T @ y), abs=1e-4 * rays)
    assert total.nbytes == sum(part.nbytes for part in total.parts)


@pytest.mark.parametrize("number_format", ["float32", "uint16", "uint8"])
def test_it_is_kept_by_the_store_and_read_within_the_memory_budget(tmp_path, number_format):
    within = random_sum((6, 7), 3, 5)
    total = SumTransport([within, dense_part((6, 7), 3, np.random.default_rng(1))], ROWS)
    path = tmp_path / "transport.zarr"
    first = save_transport(total, path, number_format, scene="test")
    opened, streamed = open_transport(path), open_transport(path, memory_budget=0)
    assert isinstance(opened, SumTransport)
    assert (opened.camera_shape, opened.projector_shape, opened.channels) == ((6, 7), (6, 7), 3)
    assert opened.levels.equals(total.levels)
    files = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
    assert 0 < opened.parts[0].nbytes < opened.nbytes == files
    pattern = np.random.default_rng(0).random((6, 7))
    exact = total.relight(pattern)
    bound = {"float32": 0, "uint16": 1e-4, "uint8": 2e-2}[number_format]
    assert np.abs(opened.relight(pattern) - exact).max() <= bound * np.abs(exact).max()
    np.testing.assert_array_equal(streamed.relight(pattern), opened.relight(pattern))
    assert save_transport(opened, tmp_path / "again", number_format, scene="test") == first
    for chunk in path.glob("part_00_part_01_*/c/*"):
        chunk.unlink()
    for chunk in path.glob("part_00_part_01_*/c.*"):
        chunk.unlink()
    opened.relight(pattern)
    with pytest.raises(IntegrityError, match="missing, truncated or altered"):
        streamed.relight(pattern)


def test_parts_that_do_not_fit_together_are_refused():
    rng = np.random.default_rng(0)
    part = dense_part((4, 5), 3, rng)
    with pytest.raises(InputError, match="at least one part"):
        SumTransport([], ROWS)
    for other in (dense_part((5, 4), 3, rng), dense_part((4, 5), 1, rng)):
        with pytest.raises(InputError, match=r"part 1 of a sum has .*, part 0 has .*\(4, 5\).* 3"):
            SumTransport([part, other], ROWS)
