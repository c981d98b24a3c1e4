"""Files and variables with which the how-to pages begin."""

from __future__ import annotations

import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO as oiio
import scipy.io
from scipy.linalg import hadamard
from tests.results.acquired_collections import acquire_item
from tests.results.finished_run import write_run
from tests.results.report_folders import BOTH, acquired
from tests.results.transports import transport_of
from tests.rigs.structured_light import shot
from tests.unit.test_chrome_ball import chrome

import rfpipe
from rfpipe.config import Config
from rfpipe.export import write_lights, write_photographs
from rfpipe.fitting.codes import code_patterns
from rfpipe.light_files import write_directions
from rfpipe.lights.chrome_ball import Ball
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import Pinhole, planes_scene

ROOT = Path(__file__).parents[2]


def photographs(folder: Path) -> None:
    """Write photographs of Gray code and of a ball under 12 lights, and an even panorama."""
    camera, lamp = Pinhole((40, 40)), Pinhole((100, 100), (1.72, 0, 0.54), (0, 0, 3))
    scene = planes_scene("wedge_120", ("white", "white"), camera.shape, projector=lamp, channels=1)
    light = np.r_[np.full(28, 0.5), 1, 0]
    patterns = [read() for read in code_patterns("gray:100x100", len(light), light).readers]
    pictures = scene.apply(np.reshape(patterns, (len(light), -1)).astype(np.float32))
    write(folder / "table", 200 * pictures.reshape(-1, *camera.shape, 1) / pictures.max())

    lights = directions(12)
    write(folder / "cat", 200 * np.repeat(shading(lights, (24, 24)), 3, axis=-1))
    np.savetxt(folder / "cat" / "lights.txt", lights, header="12", comments="")
    assert oiio.ImageBuf(np.full((16, 32, 3), 0.5, np.float32)).write(str(folder / "sky.exr"))


def shading(lights: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Return pictures of a bulge under each light, (count, height, width, 1)."""
    x, y = np.meshgrid(np.linspace(-1, 1, shape[1]), np.linspace(1, -1, shape[0]))
    normals = np.stack([x / 2, y / 2, np.sqrt(1 - (x**2 + y**2) / 4)], axis=-1)
    return np.maximum(np.moveaxis(normals @ lights.T, -1, 0), 0)[..., None]


def directions(count: int) -> np.ndarray:
    """Return the directions of lights all over the camera's half of the sphere, (count, 3)."""
    angles = np.arange(count) * np.pi * (3 - 5**0.5)
    heights = 1 - 0.9 * (np.arange(count) + 0.5) / count
    rings = np.sqrt(1 - heights**2)
    return np.stack([rings * np.cos(angles), rings * np.sin(angles), heights], axis=1)


def write(folder: Path, pictures: np.ndarray) -> None:
    """Write pictures with noise, (count, height, width, channels), as numbered PNG files."""
    folder.mkdir(parents=True)
    noisy = pictures + 10 + np.random.default_rng(1).standard_normal(pictures.shape)
    for index, picture in enumerate(np.clip(np.rint(noisy), 0, 255).astype(np.uint8)):
        name = str(folder / f"{index + 1:02d}.png")
        assert oiio.ImageBuf(np.ascontiguousarray(picture)).write(name)


def a_transport(folder: Path) -> None:
    """Write a transport, pictures of a dome, and a panorama."""
    photographs(folder)
    (folder / "cat").rename(folder / "FOLDER")
    transport_of("symmetric").save(folder / "transport.zarr")
    assert oiio.ImageBuf(str(folder / "sky.exr")).write(str(folder / "sky.hdr"))


def names_of_uses() -> dict[str, Any]:
    transport = transport_of("symmetric")
    pattern = np.random.default_rng(1).random(transport.projector_shape)
    picture = transport.relight(pattern)
    return {
        "transport": transport, "pattern": pattern, "picture": picture, "row": 10, "column": 12,
        "panorama": np.ones((16, 32, 3)), "rfpipe": rfpipe,
    }  # fmt: skip


def light_field(folder: Path) -> None:
    """Write the settings that the page on light fields begins with."""
    page = (ROOT / "docs" / "light_fields.md").read_text("utf-8")
    block = re.findall(r"^```yaml\n(.*?)^```", page, re.M | re.S)[0]
    (folder / "field.yaml").write_text(block)


def niche(folder: Path) -> None:
    """Write a scene of one's own and its settings."""
    shutil.copy(ROOT / "tests" / "examples" / "niche.py", folder)
    scene = '{kind: "niche.py:Niche", shape: [16, 18], brick: 0.25}'
    (folder / "niche.yaml").write_text(f"scenes: {{niche: {scene}}}\nmethods: {{near_far: {{}}}}\n")


def settings(folder: Path) -> None:
    """Write the settings of a run of one's own."""
    (folder / "config").mkdir()
    (folder / "config" / "mine.yaml").write_text("scenes: {vase: {kind: plane, shape: [16, 18]}}\n")


def coin(folder: Path) -> None:
    """Write photographs of an object and a chrome ball, and those of a card, under 12 lamps."""
    lights, ball, shape = directions(12), Ball(110, 163.5, 32), (150, 200)
    pictures = np.stack([chrome(light[None], ball=ball, shape=shape) for light in lights])
    pictures[:, :, :128] = shading(lights, (150, 128))[..., 0]
    write(folder / "coin", 200 * pictures[..., None])
    write_directions(folder / "coin" / "coin.lp", [f"{n:02d}.png" for n in range(1, 13)], lights)
    card = np.broadcast_to(200 * lights[:, 2, None, None, None], (12, *shape, 1))
    write(folder / "card", card)


def matrix_and_pictures(folder: Path) -> None:
    """Write a matrix, and pictures of a code, lights, brackets and an exported set-up."""
    random = np.random.default_rng(1)
    matrix = random.random((48 * 64, 32 * 32)) * (random.random((48 * 64, 32 * 32)) < 0.003)
    scipy.io.savemat(folder / "T.mat", {"T": matrix})

    gray = shot((32, 32), (20, 20), 3, name="gray:32x32")
    write(folder / "table", 255 * gray.pictures.reshape(-1, 20, 20, 1))
    lights, names = directions(12), [f"{number:02d}.png" for number in range(1, 13)]
    write(folder / "dome", 200 * shading(lights, (24, 24)))
    write_directions(folder / "dome" / "dome.lp", names, lights)
    write(folder / "stage", 200 * random.random((150, 8, 9, 3)))

    rig = rfpipe.OperatorRig(random.random((63, 150)), (7, 9), (10, 15))
    transport = rfpipe.acquire(rig, "brute_force", progress=False).transport
    write_lights(transport, folder / "olat.exr")
    write_photographs(transport, folder / "setup", 160, 20)
    brackets(folder)


def brackets(folder: Path) -> None:
    """Write two exposures of each Hadamard pattern on a coaxial rig, and the camera's settings."""
    scene = planes_scene("wedge", ("white", "white"), (8, 8), channels=1)
    patterns = (hadamard(64) + 1.0) / 2
    light = np.stack([scene.apply(pattern[None].astype(np.float32)) for pattern in patterns])
    exposed = 150 * light.reshape(64, 1, 8, 8, 1) / light.max() * [[[[[0.25]]], [[[1.0]]]]]
    write(folder / "brackets" / "pictures", exposed.reshape(128, 8, 8, 1))
    np.save(folder / "brackets" / "patterns.npy", patterns.reshape(64, 8, 8))
    camera = "{exposures: [0.25, 1.0], bits: 8, black_level_counts: 10}"
    (folder / "camera.yaml").write_text(f"camera: {camera}\n")


def exportable(folder: Path) -> None:
    """Write two transports, and patterns for one of them."""
    acquire_planes(folder)
    transport = rfpipe.acquire(
        SimulatedRig(planes_scene("wedge", ("texture", "texture"), (40, 60))), progress=False
    ).transport
    transport.save(folder / "transport.zarr")
    np.save(folder / "patterns.npy", np.random.default_rng(1).random((2, 40, 60)))


def names_of_export() -> dict[str, Any]:
    mask = np.zeros((40, 60), bool)
    mask[5:8] = True
    return {"np": np, "rfpipe": rfpipe, "mask": mask, "x": np.ones(2400)}


def acquire_planes(folder: Path) -> None:
    """Acquire two planes by symmetric photography, in the folder that the pages name."""
    scene = {"kind": "wedge", "surfaces": ["texture", "texture"], "shape": [20, 24]}
    settings = Config(scenes={"planes_iv": scene}, methods={"symmetric": {}})
    acquire_item(settings, "planes_iv", "symmetric", folder / "results")


def relit_run(folder: Path) -> None:
    """Acquire two scenes by two methods, with the errors of relit pictures."""
    acquired(folder / "results", BOTH)


def positions(folder: Path) -> None:
    """Acquire a scene from two positions."""
    scenes = {name: {"kind": "plane", "shape": [6, 8]} for name in ("left_3", "left_4")}
    settings = Config(scenes=scenes, methods={"dual": {}})
    for name in scenes:
        acquire_item(settings, name, "dual", folder / "results")


def names_of_collections() -> dict[str, Any]:
    return {"rfpipe": rfpipe, "pattern": np.ones((6, 8)), "slide": np.ones((6, 8))}


def publishable(folder: Path) -> None:
    """Write a finished run and the answers to the questions of `rfpipe publish`."""
    write_run(folder / "FOLDER", "desk")
    (folder / "FOLDER" / "publication.yaml").write_text(
        'license: CC-BY-4.0\ncreators: [{name: "Doe, Jane"}]\n'
    )


def names_of_stores() -> dict[str, Any]:
    """Return a light field of six views."""
    matrix = np.random.default_rng(1).random((480, 480))
    rig = rfpipe.OperatorRig(matrix, (6, 20, 4), (6, 20, 4))
    transport = rfpipe.acquire(rig, "hadamard", progress=False).transport
    return {"np": np, "rfpipe": rfpipe, "transport": transport}
