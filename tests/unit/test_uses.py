"""Uses of a transport: correspondences, depth, separation of light, and inverse patterns."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import InputError
from rfpipe.scenes import planes_scene
from rfpipe.scenes.pinholes import Pinhole, first_hits
from rfpipe.scenes.rooms import GEOMETRIES
from rfpipe.transport.dense import DenseTransport

CAMERA, LAMP = Pinhole((24, 30)), Pinhole((28, 34), (1.72, 0.0, 0.54), (0.0, 0.0, 3.0))


@pytest.fixture(scope="module")
def aside():
    """The exact transport of a wedge with a displaced projector, and the visible points."""
    scene = planes_scene(
        "wedge_120", ("texture", "white"), CAMERA.shape, projector=LAMP, channels=1
    )
    rig = rfpipe.OperatorRig(scene, CAMERA.shape, LAMP.shape)
    points = first_hits(CAMERA, GEOMETRIES["wedge_120"]).positions
    return rfpipe.acquire(rig, "brute_force", progress=False).transport, points


def test_correspondences_equal_the_geometry(aside) -> None:
    transport, points = aside
    correspondence = transport.correspondence()
    places = LAMP.project(points).reshape(*CAMERA.shape, 2)
    off = np.linalg.norm(correspondence.places - places, axis=-1)[correspondence.mask]
    assert correspondence.mask.mean() > 0.8
    assert np.median(off) < 0.15
    # projection matrices for triangulation by other programs
    projected = np.column_stack([points, np.ones(len(points))]) @ LAMP.matrix.T
    np.testing.assert_allclose(projected[:, 1::-1] / projected[:, 2:], LAMP.project(points))


def test_correspondences_between_two_rays_are_interpolated() -> None:
    shape = (12, 40)
    direct = (np.eye(480) + np.eye(480, k=1)) / 2
    entries = direct + np.random.default_rng(1).uniform(0, 1e-4, direct.shape)
    places = transport_of(entries, shape).correspondence().places[:, :-1]
    row, column = np.indices(places.shape[:2])
    truth = np.stack([row + 0.5, column + 1], axis=-1)
    np.testing.assert_allclose(places, truth, atol=0.1)


def test_a_reachable_picture_is_reproduced_by_its_pattern(aside) -> None:
    transport, _ = aside
    lit = np.random.default_rng(1).uniform(0.2, 0.8, LAMP.shape)
    solution = transport.pattern_for(transport.relight(lit)[..., 0])
    assert solution.residual < 0.01
    assert ((solution.pattern >= 0) & (solution.pattern <= 1)).all()
    assert transport.pattern_for(np.full(CAMERA.shape, 1e3)).out_of_reach.mean() > 0.5


@pytest.mark.parametrize("mirrored", [False, True])
def test_light_is_separated_by_distance(mirrored) -> None:
    shape, rng = (26, 34), np.random.default_rng(1)
    rays = np.indices(shape).reshape(2, -1)
    apart = np.abs(rays[:, :, None] - rays[:, None]).max(axis=0)
    entries = rng.uniform(0, 1e-3, apart.shape)
    entries[apart == 0] = 1
    ranges = {"direct": apart <= 2, "near": apart == 3, "far": apart > 7}
    entries *= sum(ranges.values())  # light at ranges in between is partly near and partly far
    if mirrored:  # positions belong to other rays
        order = np.arange(apart.shape[0]).reshape(shape)[:, ::-1].ravel()
        entries, ranges = entries[order], {name: mask[order] for name, mask in ranges.items()}
    transport = transport_of(entries, shape)
    pattern = (rng.random(shape) > 0.5).astype(float)
    parts = transport.separate(pattern, near=2 / 34)
    for name, mask in ranges.items():
        truth = (entries * mask) @ pattern.ravel()
        np.testing.assert_allclose(getattr(parts, name).ravel(), truth, atol=1e-5)
    total = parts.direct + parts.near + parts.far
    np.testing.assert_allclose(total, transport.relight(pattern), rtol=1e-6)


@pytest.mark.parametrize(("method", "within"), [("auto", 0.02), ("symmetric", 0.01)])
def test_separation_agrees_between_methods(method, within) -> None:
    scene = planes_scene("wedge_30", ("white", "texture"), (32, 32), channels=1)
    made = []
    for by, noise in (("brute_force", None), (method, rfpipe.CameraModel())):
        rig = rfpipe.OperatorRig(scene, scene.shape, scene.shape, noise, seed=2)
        made.append(rfpipe.acquire(rig, by, progress=False).transport)
    exact, acquired = (transport.separate(np.ones(scene.shape)) for transport in made)
    total = np.linalg.norm(made[0].relight(np.ones(scene.shape)))
    for name in ("direct", "near", "far"):
        off = getattr(acquired, name) - getattr(exact, name)
        assert np.linalg.norm(off) < within * total


def transport_of(matrix, shape: tuple[int, ...]) -> DenseTransport:
    content = {"matrix": np.asarray(matrix, np.float32)[None]}
    return DenseTransport(shape, shape, 1, [], content)


@pytest.mark.parametrize(
    ("picture", "match"),
    [
        (lambda _: np.ones((3, 3)), "shape"),
        (lambda shape: np.full(shape, np.nan), "NaN"),
        (lambda shape: np.full(shape, 255, np.uint8), "weights"),
    ],
)
def test_invalid_pictures_are_rejected(aside, picture, match) -> None:
    with pytest.raises(InputError, match=f"the picture .*{match}"):
        aside[0].pattern_for(picture(CAMERA.shape))
    with pytest.raises(InputError, match=f"pattern .*{match}"):
        aside[0].separate(picture(LAMP.shape))


def test_options_out_of_range_are_rejected(aside) -> None:
    with pytest.raises(InputError, match="negative"):
        aside[0].pattern_for(-np.ones(CAMERA.shape))
    for option in ({"direct": -1}, {"direct": 0.5}, {"near": 0}, {"near": np.nan}):
        with pytest.raises(InputError, match="direct = "):
            aside[0].separate(np.ones(LAMP.shape), **option)


@pytest.mark.parametrize(
    ("shape", "light", "calls", "match"),
    [
        ((2, 8, 8), 1, ("separate", "correspondence"), "several views"),
        ((1, 12), 1, ("separate",), "are single lights"),
        (
            (8, 8),
            0,
            ("separate", "correspondence", "pattern_for"),
            "no camera pixel receives light",
        ),
    ],
)
def test_rays_without_positions_are_rejected(shape, light, calls, match) -> None:
    transport = transport_of(light * np.eye(np.prod(shape)), shape)
    for call in calls:
        arguments = () if call == "correspondence" else (np.ones(shape),)
        with pytest.raises(InputError, match=match):
            getattr(transport, call)(*arguments)


USES = sorted((Path(__file__).parents[2] / "docs/uses").glob("*.py"))


@pytest.mark.slow
@pytest.mark.parametrize("script", USES)
def test_scripts_of_the_page_write_only_the_stated_files(script: Path, tmp_path: Path) -> None:
    project, outputs, temporary = (tmp_path / name for name in ("here", "there", "temporary"))
    for folder in (project, temporary):
        folder.mkdir()
    settings = {**os.environ, "MPLBACKEND": "agg", "TMPDIR": str(temporary)}
    command = [sys.executable, script, "24", outputs / "inside"]
    done = subprocess.run(
        command, cwd=project, env=settings, check=True, capture_output=True, text=True
    )
    photographs = outputs / "inside" / script.stem
    files = [file for file in tmp_path.rglob("*") if file.is_file()]
    written = [file for file in files if file.parent != photographs]
    assert photographs.exists() == (script.stem in ("dome", "gray_code"))
    assert all(str(file) in done.stdout.splitlines()[-1] for file in written)
    picture = outputs / "inside" / script.with_suffix(".png").name
    more = [picture.with_name("cloud.ply")] if script.stem == "what_sees_what" else []
    assert sorted(written) == sorted([picture, *more])
    assert picture.stat().st_size > 5000


@pytest.mark.parametrize("script", USES)
def test_scripts_of_the_page_have_a_default_folder(script: Path) -> None:
    assert f"``python docs/uses/{script.name} [SIDE [FOLDER]]``" in script.read_text()
    assert 'else "results/uses")' in script.read_text()
