"""Transports of every kind as programs: pictures as from Python, both ways, at every level."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.viewers import KINDS, rounded, run_program, transport_of

from rfpipe.errors import InputError
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.viewer import lower
from rfpipe.viewer.program import pack_program


def lights(shape: tuple[int, ...], channels: int) -> list[np.ndarray]:
    """White light, a coloured spot, and noise of both signs."""
    random = np.random.default_rng(7)
    spot = np.zeros((*shape, channels), np.float32)
    spot[..., 1 : shape[-2] // 2, 2 : shape[-1] // 2, :] = random.random(channels)
    return [np.ones(shape, np.float32), spot, random.standard_normal(shape).astype(np.float32)]


def planar(image: np.ndarray, shape: tuple[int, ...], channels: int) -> np.ndarray:
    """An image (*shape[, C]) as (C, rays)."""
    image = image.reshape(int(np.prod(shape)), -1)
    return np.broadcast_to(image, (len(image), channels)).T


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_pictures_are_python_s_both_ways_at_every_level(kind: str, tmp_path: Path) -> None:
    transport = transport_of(kind)
    if kind.endswith("uint8"):
        transport = rounded(transport, tmp_path)
    program = lower(transport, transport.known_levels)
    packed = pack_program(program)
    assert program.levels[-1] == transport.last_level
    for level in program.levels:
        seen = transport.truncate(level)
        for dual, view in ((False, seen), (True, seen.T)):
            for light in lights(view.projector_shape, view.channels):
                expected = planar(view.relight(light), view.camera_shape, view.channels)
                given = planar(light, view.projector_shape, view.channels)
                found = run_program(packed, given, level, dual=dual)
                limit = 1e-4 * np.abs(expected).max() + 1e-12
                assert np.abs(found - expected).max() < limit, (level, dual)


def test_levels_share_what_they_have_in_common() -> None:
    transport = transport_of("symmetric")
    program = lower(transport, transport.known_levels)
    alone = [lower(transport, [level]) for level in program.levels]
    assert len(program.levels) > 3
    assert len(program.operations) < sum(len(one.operations) for one in alone)
    for level, one in zip(program.levels, alone, strict=True):
        together = program.seen_at([level]).operations
        assert len(together) == len(one.operations)


def test_levels_that_show_the_same_are_one() -> None:
    dark = MultilevelTransport((4, 4), (4, 4), 1, [], [])
    assert len(dark.known_levels) == 3
    assert lower(dark, dark.known_levels).levels == [dark.last_level]


def test_parts_of_near_and_far_light_add_up_to_the_whole() -> None:
    transport = transport_of("near_far")
    packed = pack_program(lower(transport))
    parts = packed.manifest["parts"]
    assert parts[0] == "direct"
    assert len(parts) > 1
    light = planar(np.ones(transport.projector_shape), transport.projector_shape, 3)
    level = transport.last_level
    pictures = [run_program(packed, light, level, parts=[part]) for part in parts]
    assert all(picture.any() for picture in pictures)
    together = run_program(packed, light, level)
    np.testing.assert_allclose(sum(pictures), together, atol=1e-5 * together.max())


def test_a_level_that_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match="level -1"):
        lower(transport_of("symmetric"), [-1])


def test_the_same_transport_packs_into_the_same_bytes() -> None:
    packed = [pack_program(lower(transport_of("near_far"))) for _ in range(2)]
    assert packed[0].manifest == packed[1].manifest
    assert packed[0].blobs == packed[1].blobs
