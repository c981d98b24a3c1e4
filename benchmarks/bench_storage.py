"""Bytes, error and time of the ways to store a transport, into results/bench/storage.csv.

Usage: ``python benchmarks/bench_storage.py [--full]``. Scene IV in RGB: symmetric photography at
124 x 140 through a camera with noise, and from exact radiance at a tolerance at which the method's
own error is small; dual photography at 62 x 70. ``--full`` adds symmetric photography at 310 x 350.

Errors are the largest over the relighting patterns, relative RMS: `added` against the transport as
it was acquired, `unlit` against the truth, on the pixels that the pattern leaves dark. Formats
without times are not those of rfpipe: they were tried. Bytes are those of the store's files, but
under codecs other than the default those of the compressed arrays.
"""

from __future__ import annotations

import csv
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from numcodecs.blosc import BITSHUFFLE, NOSHUFFLE, SHUFFLE, Blosc

import rfpipe
from rfpipe.photometry import CameraModel
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import reference_scene, relighting_patterns
from rfpipe.stages.metrics import relative_rms, unlit_rms
from rfpipe.store import open_arrays, write_arrays
from rfpipe.transport import open_transport, save_transport
from rfpipe.transport.hierarchical import HierarchicalTransport
from rfpipe.transport.leaves import leaf_offsets

OUTPUT = Path("results/bench/storage.csv")
# Method, shape, camera or None for exact radiance, tolerance.
CASES = (
    ("symmetric", (124, 140), CameraModel(), 1e-3),
    ("symmetric", (124, 140), None, 1e-4),
    ("dual", (62, 70), CameraModel(), 1e-3),
)
FULL_CASE = ("symmetric", (310, 350), CameraModel(), 3e-4)
FORMATS = ("float32", "uint16", "uint8")
CODECS = {
    "none": None,
    "lz4 1, bits": Blosc("lz4", 1, BITSHUFFLE),
    "zstd 1, bits": Blosc("zstd", 1, BITSHUFFLE),
    "zstd 5, bytes": Blosc("zstd", 5, SHUFFLE),
    "zstd 5, unshuffled": Blosc("zstd", 5, NOSHUFFLE),
    "zstd 9, bits": Blosc("zstd", 9, BITSHUFFLE),
}
CHUNK_BYTES = 2**21


def linear(bits: int) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Round fractions of the maximum in even steps."""
    largest = 2**bits - 1

    def rounded(fractions):
        codes = np.rint(fractions * largest)
        return codes.astype(np.uint8 if bits <= 8 else np.uint16), codes / largest

    return rounded


def half(fractions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    codes = (fractions * 2.0**15).astype(np.float16)
    return codes, codes.astype(np.float32) / 2.0**15


TRIED = {
    "float16 of the maximum": half,
    "16 bits, even steps": linear(16),
    "12 bits, even steps": linear(12),
    "8 bits, even steps": linear(8),
    "6 bits, even steps": linear(6),
}


def tried(transport: HierarchicalTransport, rounding) -> tuple[HierarchicalTransport, int]:
    """Round factors some other way; return the transport and the bytes of a store."""
    tree = transport.tree
    leaf_sets, arrays = [], {}
    for index, leaves in enumerate(transport.leaf_sets):
        arrays |= {f"{index}_a": leaves.block_a, f"{index}_b": leaves.block_b}
        if leaves.level == tree.n_levels - 1:
            leaf_sets.append(leaves)
            arrays[f"{index}_values"] = leaves.values
            continue
        offsets = leaf_offsets(tree, leaves)
        sizes = np.diff(tree.starts[leaves.level])[leaves.block_a]
        begin = np.unique(np.concatenate([offsets[:-1], offsets[:-1] + sizes]))
        begin = begin[begin < offsets[-1]]  # of each factor
        maxima = np.maximum.reduceat(leaves.values, begin, axis=1)
        each = np.repeat(maxima, np.diff(np.append(begin, offsets[-1])), axis=1)
        fractions = np.divide(leaves.values, each, out=np.zeros_like(each), where=each > 0)
        codes, kept = rounding(fractions)
        # two factors can share a scale, see rfpipe.transport.rounding
        arrays |= {f"{index}_codes": codes, f"{index}_scales": maxima[:, : len(leaves)]}
        leaf_sets.append(replace(leaves, values=(kept * each).astype(np.float32)))
    with TemporaryDirectory() as folder:
        write_arrays(Path(folder) / "tried.zarr", arrays, {}, small=True)
        nbytes = open_arrays(Path(folder) / "tried.zarr").nbytes_stored
    rows = transport.level_rows
    return HierarchicalTransport(transport.camera_shape, 3, rows, leaf_sets), nbytes


def compressed(arrays: dict[str, np.ndarray], codec: Blosc | None) -> int:
    """Return the bytes of arrays under a codec, chunk by chunk."""
    total = 0
    for array in arrays.values():
        flat = np.ascontiguousarray(array).reshape(-1)
        step = CHUNK_BYTES // flat.itemsize
        for first in range(0, len(flat), step):
            chunk = flat[first : first + step]
            total += chunk.nbytes if codec is None else len(codec.encode(chunk))
    return total


def measure(method, shape, camera, tolerance) -> Iterator[dict[str, object]]:
    """Acquire, and yield a row for each format and codec."""
    scene = reference_scene("IV", shape, channels=3)
    rig = SimulatedRig(scene, camera, seed=1)
    acquired = rfpipe.acquire(rig, method, tolerance, progress=False)
    patterns = np.stack(list(relighting_patterns(shape).values()))
    exact = acquired.transport.relight_batch(patterns)
    truth = scene.apply(patterns).reshape(exact.shape)

    def row(name: str, codec: str, nbytes: int, **more: object) -> dict[str, object]:
        about = {
            "acquisition": f"{method}, {shape[0]} x {shape[1]}, "
            f"{'exact' if camera is None else 'camera'}, {tolerance:g}",
            "patterns": acquired.patterns,
        }
        return {**about, "format": name, "codec": codec, "mb": f"{nbytes / 1e6:.3f}", **more}

    def errors(transport) -> dict[str, str]:
        found = transport.relight_batch(patterns)
        dark = [(pattern == 0).any() for pattern in patterns]
        added = [
            unlit_rms(*images)
            for images in zip(found[dark], exact[dark], patterns[dark], strict=True)
        ]
        unlit = [
            unlit_rms(*images)
            for images in zip(found[dark], truth[dark], patterns[dark], strict=True)
        ]
        total = max(relative_rms(*images) for images in zip(found, exact, strict=True))
        return {
            "added_total": f"{total:.1e}",
            "added_unlit": f"{max(added):.1e}",
            "unlit": f"{max(unlit):.4f}",
        }

    with TemporaryDirectory() as folder:
        path = Path(folder) / "transport.zarr"
        for name in FORMATS:
            save_transport(acquired.transport, path, name)
            open_transport(path).relight(patterns[0])  # compiles
            began = time.perf_counter()
            save_transport(acquired.transport, path, name)
            written = time.perf_counter()
            stored = open_transport(path)
            stored.relight(patterns[0])
            opened = time.perf_counter()
            yield row(
                name, "zstd 5, bits", stored.nbytes, **errors(stored),
                write_s=f"{written - began:.2f}", open_relight_s=f"{opened - written:.2f}",
            )  # fmt: skip
    if method == "symmetric":
        for name, rounding in TRIED.items():
            found, nbytes = tried(acquired.transport, rounding)
            yield row(name, "zstd 5, bits", nbytes, **errors(found))
    arrays, _ = acquired.transport.pack("uint8")
    for codec, blosc in CODECS.items():
        yield row("uint8", codec, compressed(arrays, blosc))


def main() -> None:
    """Measure each acquisition."""
    cases = (*CASES, FULL_CASE) if "--full" in sys.argv[1:] else CASES
    columns = ["acquisition", "patterns", "format", "codec", "mb", "added_total", "added_unlit"]
    columns += ["unlit", "write_s", "open_relight_s"]
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    with OUTPUT.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        for case in cases:
            for row in measure(*case):
                writer.writerow(row)
                file.flush()
                print(row, flush=True)


if __name__ == "__main__":
    main()
