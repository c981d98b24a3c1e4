"""The contract suite on rigs behind a real server, over a real HTTP connection."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from tests.server.harness import ResampledRig, Running, running, transport

from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig, RemoteRig, Rig
from rfpipe.testing import RigContract


class Contract(RigContract):
    """Every rig is a client of its own; one at a time holds the served rig."""

    clients: tuple[Running, list[RemoteRig]]

    @staticmethod
    def served_rig() -> Rig:
        raise NotImplementedError

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _served(cls) -> Iterator[None]:
        with running(cls.served_rig()) as server:
            cls.clients = (server, [])
            yield
            for client in cls.clients[1]:
                client.close()

    def make_rig(self) -> Rig:
        server, clients = self.clients
        while clients:
            clients.pop().close()
        clients.append(server.client())
        return clients[0]


class TestNoisyRemoteRig(Contract):
    @staticmethod
    def served_rig() -> Rig:
        return OperatorRig(transport(20, 21), (4, 5), (3, 7), noise=CameraModel(), seed=1)


class TestResampledRemoteRig(Contract):
    @staticmethod
    def served_rig() -> Rig:
        return ResampledRig()
