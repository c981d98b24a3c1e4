"""The viewer's programs, run by numpy: the reference for what a browser makes of them."""

from __future__ import annotations

import gzip
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import rfpipe
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import planes_scene
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.base import Transport
from rfpipe.viewer.program import Packed

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


def unpack_array(about: dict[str, Any], blob: bytes) -> NDArray[Any]:
    """An array of a packed program."""
    dtype = np.dtype(f"<{about['type']}")
    planes = np.frombuffer(gzip.decompress(blob), np.uint8).reshape(dtype.itemsize, -1)
    flat = np.ascontiguousarray(planes.T).view(dtype).ravel()
    if dtype == np.int32:
        flat = np.cumsum(flat, dtype=np.int32)
    return flat.reshape(about["shape"])


def run_program(
    packed: Packed, light: NDArray[Any], level: int, *, dual: bool = False, parts: Any = None
) -> NDArray[np.float32]:
    """The planar image (C, rays) of planar light (C, rays)."""
    about = packed.manifest
    arrays = [unpack_array(*each) for each in zip(about["arrays"], packed.blobs, strict=True)]
    buffers = [np.zeros((about["channels"], size)) for size in about["buffers"]]
    ends = ("target", "source") if dual else ("source", "target")
    buffers[1 if dual else 0][:] = light
    operations = about["operations"]
    for operation in reversed(operations) if dual else operations:
        if level not in operation["levels"]:
            continue
        part = operation["part"]
        if parts is not None and part >= 0 and about["parts"][part] not in parts:
            continue
        own = {name: arrays[index] for name, index in operation["arrays"].items()}
        source, target = (buffers[operation[end]][:, operation[f"{end}_at"] :] for end in ends)
        _RUN[operation["kind"]](own, source, target, operation["transposed"] != dual)
    return buffers[0 if dual else 1].astype(np.float32)


def _gather(own: Any, source: Any, target: Any, transposed: bool) -> None:
    index = own["index"]
    if transposed:
        np.add.at(target, (slice(None), index), source[:, : len(index)])
    else:
        target[:, : len(index)] += source[:, index]


def _scale(own: Any, source: Any, target: Any, transposed: bool) -> None:
    size = own["values"].shape[1]
    target[:, :size] += own["values"] * source[:, :size]


def _csr(own: Any, source: Any, target: Any, transposed: bool) -> None:
    row = np.repeat(np.arange(len(own["counts"])), own["counts"])
    ends = (own["columns"], row) if transposed else (row, own["columns"])
    np.add.at(target, (slice(None), ends[0]), own["values"] * source[:, ends[1]])


def _dense(own: Any, source: Any, target: Any, transposed: bool) -> None:
    for plane, given, taken in zip(own["values"].astype(float), source, target, strict=True):
        matrix = plane.T if transposed else plane
        taken[: len(matrix)] += matrix @ given[: matrix.shape[1]]


def _pairs(own: Any, source: Any, target: Any, transposed: bool) -> None:
    a, b, values = own["first"], own["second"], own["values"]
    np.add.at(target, (slice(None), a), values * source[:, b])
    off = a != b
    np.add.at(target, (slice(None), b[off]), values[:, off] * source[:, a[off]])


def _leaves(own: Any, source: Any, target: Any, transposed: bool) -> None:
    sizes, a, b = own["sizes"], own["block_a"], own["block_b"]
    starts = np.append(0, np.cumsum(sizes))
    channels = len(source)
    scales = own.get("scales", np.ones((channels, len(a)))).astype(float)
    signs = own.get("signs", np.ones((channels, len(a)), np.int8))
    factors = own.get("values")
    if factors is None:
        codes = own["codes"].astype(np.int64)
        folded = codes[1:]
        codes[1:] = ((folded >> 1) ^ -(folded & 1)) + codes[:1]
        factors = (codes % (1 << 8 * own["codes"].itemsize)).astype(float) ** 2
    at = 0
    for n, (one, other) in enumerate(zip(a, b, strict=True)):
        rows, columns = (slice(starts[block], starts[block + 1]) for block in (one, other))
        scale = (scales[:, n] ** 2 * signs[:, n])[:, None]
        u = factors[:, at : at + sizes[one]].astype(float)
        at += sizes[one]
        if one == other:
            target[:, rows] += scale * u * (u * source[:, rows]).sum(1, keepdims=True)
            continue
        v = factors[:, at : at + sizes[other]].astype(float)
        at += sizes[other]
        target[:, rows] += scale * u * (v * source[:, columns]).sum(1, keepdims=True)
        target[:, columns] += scale * v * (u * source[:, rows]).sum(1, keepdims=True)


_RUN = {
    "gather": _gather, "scale": _scale, "csr": _csr, "dense": _dense, "pairs": _pairs,
    "leaves": _leaves,
}  # fmt: skip
