"""Whether an occluder stands between two points."""

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.scenes import Occluder
from rfpipe.scenes.occluders import HIDDEN, MIXED, VISIBLE, blocked, classify

SQUARE = Occluder((0, 0, 1), (0.5, 0, 0), (0, 0.5, 0))  # in the plane z = 1


@pytest.mark.parametrize(
    ("first", "second", "expected"),
    [
        ((0, 0, 0), (0, 0, 2), True),
        ((0, 0, 0), (0.9, 0, 2), True),  # crosses at x = 0.45
        ((0, 0, 0), (1.1, 0, 2), False),
        ((0, 0, 0), (0, -1.1, 2), False),
        ((0, 0, 0), (0, 0, 0.9), False),  # stays in front
        ((0.1, 0, 1), (0.1, 0, 2), False),  # starts on the occluder
        ((-0.2, 0, 1), (0.2, 0, 1), False),  # runs within its plane
        ((-1, 0, 0.5), (1, 0, 1.5), True),
    ],
)
def test_segments(first, second, expected):
    p, q = (SQUARE.coordinates(np.array(point, dtype=float)) for point in (first, second))
    assert bool(blocked(p, q)) is expected
    assert bool(blocked(q, p)) is expected


def test_coordinates_of_a_slanted_parallelogram():
    occluder = Occluder((1, 2, 3), (1, 1, 0), (0, 1, 1))
    corner = np.array([1, 2, 3]) + np.array([1, 1, 0]) - np.array([0, 1, 1])
    assert occluder.coordinates(corner) == pytest.approx([0, 1, -1], abs=1e-12)
    normal = np.cross([1, 1, 0], [0, 1, 1]) / np.sqrt(3)
    assert occluder.coordinates(corner + 2 * normal) == pytest.approx([2, 1, -1], abs=1e-12)


@pytest.mark.parametrize("edges", [((1, 0, 0), (2, 0, 0)), ((0, 0, 0), (0, 1, 0))])
def test_edges_that_span_nothing_are_refused(edges):
    with pytest.raises(InputError, match="span a parallelogram"):
        Occluder((0, 0, 1), *edges)


def cluster(centre, radius):
    offsets = np.array([(x, y, 0) for x in (-1, 1) for y in (-1, 1)])
    return SQUARE.coordinates(np.asarray(centre) + radius * offsets)[None]


@pytest.mark.parametrize(
    ("first", "second", "verdict"),
    [
        (((0, 0, 0), 0.2), ((0, 0, 2), 0.2), HIDDEN),
        (((0, 0, 0), 0.2), ((0, 0, 2), 0.9), MIXED),
        (((2, 0, 0), 0.2), ((2, 0, 2), 0.2), VISIBLE),
        (((0, 0, 0), 0.2), ((3, 0, 2), 0.2), VISIBLE),  # passes beside it
        (((0, 0, 0), 9.0), ((0, 0, 0.5), 9.0), VISIBLE),  # both in front
    ],
)
def test_clusters(first, second, verdict):
    assert classify(cluster(*first), cluster(*second)) == verdict
    assert classify(cluster(*second), cluster(*first)) == verdict
