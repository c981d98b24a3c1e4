"""The contract suite on rigs behind a real server, over a real HTTP connection."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.server.harness import ResampledRig, Running, running, transport

from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig, Rig
from rfpipe.testing import RigContract


def noisy_rig() -> Rig:
    return OperatorRig(transport(20, 21), (4, 5), (3, 7), noise=CameraModel(), seed=1)


class TestRemoteRig(RigContract):
    """Each rig is a separate client; one client at a time holds the served rig."""

    server: Running

    @pytest.fixture(autouse=True, scope="class", params=[noisy_rig, ResampledRig])
    @classmethod
    def _served(cls, request: pytest.FixtureRequest) -> Iterator[None]:
        with running(request.param()) as cls.server:
            yield

    def make_rig(self) -> Rig:
        return self.server.client()
