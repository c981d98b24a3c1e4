"""Small transports of each kind for the viewer, and light to compare them."""

from __future__ import annotations

from functools import cache

import numpy as np
from tests.unit.test_transports import wavelets

import rfpipe
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import planes_scene
from rfpipe.transport.base import Transport

KINDS = (
    "symmetric", "symmetric uint8", "near_far", "dual", "dual of two domains", "footprints",
    "low_rank", "brute_force", "wavelet", "light field", "one channel",
)  # fmt: skip


@cache
def transport_of(kind: str) -> Transport:
    """Return a small transport of a kind."""
    if kind == "wavelet":
        return wavelets()[0]
    if kind == "light field":
        matrix = np.abs(np.random.default_rng(3).standard_normal((48, 48))).astype(np.float32)
        symmetric = matrix + matrix.T + 30 * np.eye(48, dtype=np.float32)
        rig = rfpipe.OperatorRig(symmetric, camera_shape=(2, 4, 6), projector_shape=(2, 4, 6))
        return rfpipe.acquire(rig, method="symmetric", progress=False).transport
    if kind in ("dual of two domains", "footprints"):
        random = np.random.default_rng(5)
        matrix = random.random((3, 180, 99)) * (random.random((180, 99)) < 0.1)
        rig = rfpipe.OperatorRig(
            matrix.astype(np.float32), camera_shape=(12, 15), projector_shape=(9, 11)
        )
        method = "dual" if kind != "footprints" else kind
        return rfpipe.acquire(rig, method=method, progress=False).transport
    scene = planes_scene("wedge", ("texture", "texture"), (20, 24))
    if kind == "one channel":
        scene = planes_scene("wedge", ("white", "white"), (13, 11), channels=1)
    names = {
        "symmetric uint8": "symmetric",
        "one channel": "symmetric",
        "low_rank": "benchmarks.rivals.low_rank:LowRank",
    }
    name = names.get(kind, kind)
    return rfpipe.acquire(SimulatedRig(scene), method=name, progress=False).transport


def lights(shape: tuple[int, ...], channels: int) -> list[np.ndarray]:
    """Return white light, a coloured spot, and noise of both signs."""
    random = np.random.default_rng(7)
    spot = np.zeros((*shape, channels), np.float32)
    spot[..., 1 : shape[-2] // 2, 2 : shape[-1] // 2, :] = random.random(channels)
    return [np.ones(shape, np.float32), spot, random.standard_normal(shape).astype(np.float32)]


def planar(image: np.ndarray, shape: tuple[int, ...], channels: int) -> np.ndarray:
    """Return an image (*shape[, C]) as (C, rays)."""
    image = image.reshape(int(np.prod(shape)), -1)
    return np.broadcast_to(image, (len(image), channels)).T
