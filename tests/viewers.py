"""Transports of every kind for the viewer, and the light that they are compared under."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np

import rfpipe
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import planes_scene
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.base import Transport

KINDS = (
    "symmetric", "symmetric uint8", "near_far", "dual", "dual of two domains", "footprints",
    "low_rank", "brute_force", "wavelet", "light field", "one channel",
)  # fmt: skip


@cache
def transport_of(kind: str) -> Transport:
    """A small transport of a kind."""
    if kind == "wavelet":
        return _wavelet()
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


def rounded(transport: Transport, folder: Path) -> Transport:
    """The transport as a run's store keeps it."""
    save_transport(transport, folder / "transport.zarr", "uint8")
    return open_transport(folder / "transport.zarr")


def _wavelet() -> Transport:
    from rfpipe.transport.wavelet import Cells, WaveletTransport

    random = np.random.default_rng(4)
    size = Cells((11, 14), 2).haar.size
    pairs = np.unique(np.sort(random.integers(0, size, (2, 200)), axis=0), axis=1)
    held = {
        "side": np.array([2], np.int32),
        "factor": random.random((3, 154)).astype(np.float32),
        "pairs": pairs.astype(np.int32),
        "cores": random.standard_normal((3, pairs.shape[1])).astype(np.float32),
    }
    return WaveletTransport((11, 14), 3, [], held)


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
