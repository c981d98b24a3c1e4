"""The files of a small finished run, written without running its stages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from tests.rigs.known_matrix import settings_of_a_plane

from rfpipe.store import write_arrays, write_manifest
from rfpipe.transport import save_transport
from rfpipe.transport.dense import DenseTransport

SHAPE = (6, 7)
N = 6 * 7


def write_transport(folder: Path, scene: str, matrix: np.ndarray) -> None:
    """Write a transport (3, N, N) by dual photography and its manifest."""
    place = folder / f"results/{scene}/dual"
    transport = DenseTransport(
        SHAPE, SHAPE, 3, [{"level": 0, "patterns": 12}], {"matrix": matrix.astype(np.float32)}
    )
    facts = {"digest": save_transport(transport, place / "transport.zarr"), "patterns": 12}
    shapes = {"camera_shape": SHAPE, "projector_shape": SHAPE, "channels": 3}
    write_manifest(place / "transport.json", {**facts, **shapes})


def write_run(folder: Path, *scenes: str) -> Path:
    """Write a run with relit pictures, captures, logs and a report."""
    for seed, scene in enumerate(scenes):
        matrix = np.random.default_rng(seed).random((3, N, N))
        write_transport(folder, scene, matrix)
        place = folder / f"results/{scene}/dual"
        digest = write_arrays(place / "relight.zarr", {"images": matrix[0]}, {})
        write_manifest(place / "relight.json", {"digest": digest})
        captured = {"stage": "capture", "patterns": 12, "shape": [12, 4, *SHAPE, 3]}
        write_manifest(place / "L00/capture.json", captured)
        (place / "L00/capture.zarr").mkdir()
        (place / "L00/capture.zarr/c.0").write_bytes(b"a frame")
        (place / "acquire.log").write_text(f"in {folder}")
    settings = {"provenance": {"configuration": settings_of_a_plane().result_settings()}}
    table = "scene,patterns,error,psnr\ndesk,12,0.1,\ndesk,3,1,4.5\n"
    for name, text in {
        "index.html": "<h1>Report</h1>",
        "view/desk.html": "<h1>Paint</h1>",
        "tables/errors.csv": table,
        "results.json": json.dumps(settings),
    }.items():
        file = folder / "results/report" / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return folder
