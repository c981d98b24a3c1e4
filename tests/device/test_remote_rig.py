"""The contract suite on rigs behind a real server, over a real HTTP connection."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from scipy.sparse import csr_array
from tests.server.harness import Running, running, transport

from rfpipe.photometry import CameraModel, ResampledSensor, Resampling
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


class TestExactRemoteRig(Contract):
    @staticmethod
    def served_rig() -> Rig:
        return OperatorRig(transport(20, 21), (4, 5), (3, 7))


class TestNoisyRemoteRig(Contract):
    @staticmethod
    def served_rig() -> Rig:
        return OperatorRig(transport(20, 21), (4, 5), (3, 7), noise=CameraModel(), seed=1)


class TestRemoteRigOfViewsWithMosaic(Contract):
    @staticmethod
    def served_rig() -> Rig:
        camera = CameraModel(bayer="GRBG")
        return OperatorRig(transport(24, 24), (2, 3, 4), (2, 3, 4), noise=camera)


class ResampledRig:
    """A rig whose camera has twice as many pixels as there are rays, each ray the mean of two."""

    camera_shape = projector_shape = (4, 5)
    channels = 3
    seconds_per_pattern = 0.0

    def __init__(self) -> None:
        camera = CameraModel()
        matrix = np.repeat(transport(20, 20), 2, axis=1)
        shares = csr_array(np.repeat(np.eye(20, dtype=np.float32), 2, axis=1) / 2)
        self.raw = OperatorRig(matrix, (4, 10), (4, 5), noise=camera)
        self.sensor = ResampledSensor(camera, Resampling((4, 5), (4, 10), shares))

    def capture(self, patterns: np.ndarray, keys: Any) -> np.ndarray:
        return self.raw.capture(patterns, keys)

    def describe(self) -> dict[str, Any]:
        return {**self.raw.describe(), "sensor": self.sensor.describe()}


class TestResampledRemoteRig(Contract):
    @staticmethod
    def served_rig() -> Rig:
        return ResampledRig()
