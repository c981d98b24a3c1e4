"""What people do with a transport: what sees what, depth, and patterns that make pictures."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import InputError
from rfpipe.scenes import planes_scene
from rfpipe.scenes.rooms import GEOMETRIES
from rfpipe.scenes.sight import Pinhole, sight_of
from rfpipe.transport.correspondence import write_ply

CAMERA, LAMP = Pinhole((24, 30)), Pinhole((28, 34), (1.72, 0.0, 0.54), (0.0, 0.0, 3.0))


@pytest.fixture(scope="module")
def aside():
    """The exact transport of a wedge lit from aside, and the points that the camera sees."""
    scene = planes_scene(
        "wedge_120", ("texture", "white"), CAMERA.shape, projector=LAMP, channels=1
    )
    rig = rfpipe.OperatorRig(scene, CAMERA.shape, LAMP.shape)
    points = sight_of(CAMERA, GEOMETRIES["wedge_120"]).positions
    return rfpipe.acquire(rig, "brute_force", progress=False).transport, points


def projection(pinhole: Pinhole) -> np.ndarray:
    """The matrix that maps homogeneous points to columns and rows."""
    height, width = pinhole.shape
    inner = np.array(
        [[1 / pinhole.pitch, 0, width / 2], [0, 1 / pinhole.pitch, height / 2], [0, 0, 1]]
    )
    return inner @ np.column_stack([pinhole.axes, -pinhole.axes @ pinhole.origin])


def test_places_and_points_are_those_of_the_geometry(aside, tmp_path: Path) -> None:
    transport, points = aside
    found = transport.correspondence()
    places = LAMP.project(points).reshape(*CAMERA.shape, 2)
    off = np.linalg.norm(found.places - places, axis=-1)[found.mask]
    assert found.mask.mean() > 0.8
    assert np.median(off) < 0.15
    seen = found.points(projection(CAMERA), projection(LAMP))
    wrong = np.linalg.norm(seen.reshape(-1, 3) - points, axis=1)[found.mask.ravel()]
    assert np.median(wrong) < 0.01 * np.linalg.norm(points, axis=1).mean()
    colours = np.full((*CAMERA.shape, 3), 200, np.uint8)
    assert write_ply(tmp_path / "cloud.ply", seen, colours) == found.mask.sum()
    head, _, body = (tmp_path / "cloud.ply").read_bytes().partition(b"end_header\n")
    assert b"element vertex %d" % found.mask.sum() in head
    assert len(body) == 15 * found.mask.sum()


def test_a_pattern_makes_what_is_within_reach(aside) -> None:
    transport, _ = aside
    lit = np.random.default_rng(1).uniform(0.2, 0.8, LAMP.shape)
    found = transport.pattern_for(transport.relight(lit)[..., 0])
    assert found.residual < 0.01
    assert found.pattern.min() >= 0
    assert found.pattern.max() <= 1
    bright = 2 * transport.relight(np.ones(LAMP.shape))
    assert transport.pattern_for(bright).out_of_reach.mean() > 0.5


@pytest.mark.parametrize(
    "picture", [np.ones((3, 3)), np.full(CAMERA.shape, np.nan), -np.ones(CAMERA.shape)]
)
def test_what_is_no_picture_of_the_camera_is_refused(aside, picture) -> None:
    with pytest.raises(InputError, match="wished picture"):
        aside[0].pattern_for(picture)
    with pytest.raises(InputError, match=r"shape \(3, 4\)"):
        aside[0].correspondence().points(np.eye(3), np.eye(4))


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted((Path(__file__).parents[2] / "docs/uses").glob("*.py")))
def test_the_scripts_of_the_page_make_their_pictures(script: Path, tmp_path: Path) -> None:
    settings = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run([sys.executable, script, "24"], cwd=tmp_path, env=settings, check=True)
    assert (tmp_path / script.with_suffix(".png").name).stat().st_size > 5000
