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


def test_places_are_those_of_the_geometry(aside) -> None:
    transport, points = aside
    found = transport.correspondence()
    places = LAMP.project(points).reshape(*CAMERA.shape, 2)
    off = np.linalg.norm(found.places - places, axis=-1)[found.mask]
    assert found.mask.mean() > 0.8
    assert np.median(off) < 0.15
    # the matrices that others triangulate by
    projected = np.column_stack([points, np.ones(len(points))]) @ LAMP.matrix.T
    np.testing.assert_allclose(projected[:, 1::-1] / projected[:, 2:], LAMP.project(points))


def test_a_pattern_makes_what_is_within_reach(aside) -> None:
    transport, _ = aside
    lit = np.random.default_rng(1).uniform(0.2, 0.8, LAMP.shape)
    found = transport.pattern_for(transport.relight(lit)[..., 0])
    assert found.residual < 0.01
    assert ((found.pattern >= 0) & (found.pattern <= 1)).all()
    assert transport.pattern_for(np.full(CAMERA.shape, 1e3)).out_of_reach.mean() > 0.5


@pytest.mark.parametrize(
    "picture", [np.ones((3, 3)), np.full(CAMERA.shape, np.nan), -np.ones(CAMERA.shape)]
)
def test_what_is_no_picture_of_the_camera_is_refused(aside, picture) -> None:
    with pytest.raises(InputError, match="wished picture"):
        aside[0].pattern_for(picture)


@pytest.mark.slow
@pytest.mark.parametrize("script", sorted((Path(__file__).parents[2] / "docs/uses").glob("*.py")))
def test_the_scripts_of_the_page_make_their_pictures(script: Path, tmp_path: Path) -> None:
    settings = {**os.environ, "MPLBACKEND": "agg"}
    subprocess.run([sys.executable, script, "24"], cwd=tmp_path, env=settings, check=True)
    assert (tmp_path / script.with_suffix(".png").name).stat().st_size > 5000
