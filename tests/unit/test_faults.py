"""Faults of pictures whose patterns are known."""

from __future__ import annotations

import re

import numpy as np
import pytest
from tests.rigs.structured_light import Shot, shot

from rfpipe.errors import InputError
from rfpipe.fitting import Series, fit_transport
from rfpipe.fitting.faults import PictureFault, faults_of

SETS = {
    "fine stripes are dark": shot((54, 96), (60, 90), 11, darkening=0.1),
    "much indirect light": shot((100, 100), (70, 60), 12, indirect=0.3),
    "noise": shot((64, 64), (80, 80), 13, noise=0.03),
}


def faults(given: Shot, *exchanges: tuple[int, int]) -> list[PictureFault]:
    """Return the faults found after successive exchanges of pictures."""
    order = np.arange(len(given.pictures))
    for first, second in exchanges:
        order[[first, second]] = order[[second, first]]
    patterns, pictures, *arguments = given.arguments()
    return faults_of(patterns, pictures[order], *arguments)


@pytest.mark.parametrize("given", SETS.values(), ids=SETS)
def test_correct_pictures_have_no_faults(given: Shot) -> None:
    assert faults(given) == []


@pytest.mark.parametrize("given", SETS.values(), ids=SETS)
@pytest.mark.parametrize(
    "exchange",
    [(0, 9), (5, 13), (10, 11), (1, 14), (8, 9), (16, 17), (22, 23), (11, 23), (4, -1), (21, -1)],
)
def test_two_exchanged_pictures_are_named(given: Shot, exchange: tuple[int, int]) -> None:
    pair = tuple(index % len(given.names) for index in exchange)
    [fault] = faults(given, pair)
    assert fault.kind == "exchanged"
    assert fault.pictures == pair
    assert f"{given.names[pair[0]]} with {given.names[pair[1]]}" in fault.message


@pytest.mark.parametrize("given", SETS.values(), ids=SETS)
@pytest.mark.parametrize(("first", "second"), [(0, 4), (2, 6), (8, 10), (6, 18)])
def test_two_exchanged_pairs_are_named(given: Shot, first: int, second: int) -> None:
    [fault] = faults(given, (first, second), (first + 1, second + 1))
    assert fault.kind == "exchanged"
    assert fault.pictures == (first, first + 1, second, second + 1)


def test_several_exchanges_are_named() -> None:
    given = SETS["much indirect light"]
    named = [fault.pictures for fault in faults(given, (4, 20), (7, 14), (10, 11))]
    assert sorted(named) == [(4, 20), (7, 14), (10, 11)]


def test_a_missing_picture_is_refused_in_one_sentence_on_the_order() -> None:
    given = shot((32, 32), (48, 48), 1)
    patterns, pictures = given.patterns[:-1], np.delete(given.pictures, 7, axis=0)
    series = Series(
        given.camera_shape, given.projector_shape, patterns, pictures[:, None],
        np.zeros_like(pictures[:, None]), names=given.names[:-1],
    )  # fmt: skip
    with pytest.raises(InputError, match="no picture is missing") as refusal:
        fit_transport(series)
    assert str(refusal.value).count("are exchanged:") == 1
    assert "name of the other. " in str(refusal.value)


def test_a_mirrored_map_is_no_fault() -> None:
    # the coarsest bit of a power of two, flipped, mirrors the projector: any scene may be mirrored
    assert faults(SETS["noise"], (0, 1)) == []


def test_pictures_without_complements_are_compared_with_half_of_white() -> None:
    given = shot((54, 96), (60, 90), 14, name="gray:{1}x{0},plain,white=last")
    assert faults(given) == []
    [fault] = faults(given, (2, 5))
    assert fault.pictures == (2, 5)


def test_random_patterns_without_complements_allow_no_test() -> None:
    given = SETS["noise"]
    random = np.random.default_rng(5)
    patterns = (random.random((20, 64 * 64)) < 0.5).astype(np.float32)
    pictures = patterns[:, random.permutation(64 * 64)].astype(np.float32)
    for order in (np.arange(20), random.permutation(20)):
        arguments = ((64, 64), (64, 64), given.names[:20])
        assert faults_of(patterns, pictures[order], *arguments) == []


@pytest.mark.parametrize(("name", "count"), [("phase:{1}x{0},period=16+48,steps=4,white=last", 17)])
def test_exchanged_sinusoids_are_named(name: str, count: int) -> None:
    given = shot((48, 64), (60, 80), 15, name=name, count=count)
    assert faults(given) == []
    [fault] = faults(given, (1, 12))
    assert fault.kind == "exchanged"
    assert {1, 12} <= set(fault.pictures)


@pytest.mark.parametrize("moved", [(0.9, 0.0), (0.0, -0.3), (1.5, 1.5)])
@pytest.mark.parametrize("flicker", [0.0, 0.03])
def test_motion_and_flicker_are_measured(moved: tuple[float, float], flicker: float) -> None:
    given = shot(
        (100, 100), (90, 80), 16, moved=(14, *moved), flicker=flicker, indirect=0.1, darkening=0.05
    )
    by_kind = {fault.kind: fault for fault in faults(given)}
    assert set(by_kind) == {"motion", "flicker"} - (set() if flicker else {"flicker"})
    motion = by_kind["motion"]
    assert motion.pictures == tuple(range(14, 28))
    assert "pictures 15.png to 28.png are shifted by" in motion.message
    measured = [
        float(word) for word in re.findall(r"([+-][\d.]+) (?:rows|columns)", motion.message)
    ]
    np.testing.assert_allclose(measured, moved, atol=0.11)
    if flicker:
        percent = float(re.search(r"flicker of (\d+) %", by_kind["flicker"].message)[1])
        assert 2 <= percent <= 4


def test_slight_flicker_is_not_reported_as_motion() -> None:
    assert faults(shot((64, 64), (80, 80), 17, flicker=0.01)) == []
    [fault] = faults(shot((64, 64), (80, 80), 17, flicker=0.06))
    assert fault.kind == "flicker"


def test_pictures_must_have_the_size_of_the_camera() -> None:
    given = SETS["noise"]
    with pytest.raises(InputError, match="expected"):
        faults_of(given.patterns, given.pictures, (80, 81), (64, 64), given.names)
