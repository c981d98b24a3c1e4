"""Transports as programs: what levels share, and that the same makes the same."""

from __future__ import annotations

from tests.viewers import transport_of

from rfpipe.viewer import lower
from rfpipe.viewer.program import pack_program


def test_the_same_transport_packs_into_the_same_bytes() -> None:
    packed = [pack_program(lower(transport_of("near_far"))) for _ in range(2)]
    assert packed[0].manifest == packed[1].manifest
    assert packed[0].blobs == packed[1].blobs
