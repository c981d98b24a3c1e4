"""Transports as programs: what levels share, and that the same makes the same."""

from __future__ import annotations

import pytest
from tests.viewers import transport_of

from rfpipe.errors import InputError
from rfpipe.viewer import lower
from rfpipe.viewer.program import pack_program


def test_levels_share_what_they_have_in_common() -> None:
    transport = transport_of("symmetric")
    program = lower(transport, transport.known_levels)
    alone = [lower(transport, [level]) for level in program.levels]
    assert len(program.levels) > 3
    assert len(program.operations) < sum(len(one.operations) for one in alone)
    for level, one in zip(program.levels, alone, strict=True):
        together = program.seen_at([level]).operations
        assert len(together) == len(one.operations)


def test_a_level_that_there_is_not_is_refused() -> None:
    with pytest.raises(InputError, match="level -1"):
        lower(transport_of("symmetric"), [-1])


def test_the_same_transport_packs_into_the_same_bytes() -> None:
    packed = [pack_program(lower(transport_of("near_far"))) for _ in range(2)]
    assert packed[0].manifest == packed[1].manifest
    assert packed[0].blobs == packed[1].blobs
