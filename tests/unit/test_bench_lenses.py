"""Lenses of the bench: circles of confusion follow the thin-lens law, and light is conserved."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.rigs.calibration_bench import Surface

from rfpipe.config import BenchConfig
from rfpipe.devices.optical_path import OpticalPath, optical_path
from rfpipe.errors import ConfigError
from rfpipe.rigs.layout import Quadrilateral
from rfpipe.scenes import Pinhole, Plane
from rfpipe.scenes.lenses import Lens, LensView
from rfpipe.scenes.surfaces import upright

RAYS, SIZE = (12, 12), 48
"""A camera pixel is 1 / SIZE wide on the image plane at distance 1."""

FINER = 4
"""Projector pixels per camera pixel and axis."""


def square(size: int) -> list[Quadrilateral]:
    return [[(0, 0), (size, 0), (size, size), (0, size)]]


def path_of(
    *surfaces: Any,
    camera: Lens | None = None,
    projector: Lens | None = None,
    albedo: np.ndarray | None = None,
) -> OpticalPath:
    """Return the path between surfaces, and a camera and projector with lenses."""
    albedo = np.ones(RAYS) if albedo is None else albedo
    camera_lenses, projector_lenses = (
        () if lens is None else (LensView(lens, Pinhole(RAYS), surfaces),)
        for lens in (camera, projector)
    )
    return OpticalPath(
        Surface(albedo),
        RAYS,
        (FINER * SIZE, FINER * SIZE),
        (SIZE, SIZE),
        square(FINER * SIZE),
        square(SIZE),
        albedo.reshape(-1, 1),
        camera_lenses=camera_lenses,
        projector_lenses=projector_lenses,
    )


def facing(depth: float) -> Plane:
    return Plane("front", (0, 0, depth), (0, 0, -1))


def seen(path: OpticalPath, light: np.ndarray) -> np.ndarray:
    """Return the camera's picture (SIZE, SIZE) under light (SIZE, SIZE)."""
    return path.radiance(np.kron(light, np.ones((FINER, FINER))))[..., 0].astype(np.float64)


def spot(path: OpticalPath, row: int = SIZE // 2, column: int = SIZE // 2) -> np.ndarray:
    """Return the camera's picture of light as wide as a camera pixel, which covers it if sharp."""
    light = np.zeros((SIZE, SIZE))
    light[row, column] = 1
    return seen(path, light)


def moments(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the centroid of a picture and its covariance matrix, in (square) pixels."""
    points = np.indices(picture.shape).reshape(2, -1)
    return np.average(points, axis=1, weights=picture.ravel()), np.cov(
        points, aweights=picture.ravel(), ddof=0
    )


def law(diameter: float, lenses: int = 1) -> float:
    """Variance of a spot along an axis: of discs, and of the widths of spot and camera pixel."""
    return lenses * diameter**2 / 16 + (1 / 6 if diameter else 0)


LENS = Lens(aperture=1.0, focus=3.0)


@pytest.mark.parametrize("depth", [1.8, 2.4, 3.0, 4.5, 9.0])
@pytest.mark.parametrize("sides", [("camera",), ("projector",), ("camera", "projector")])
def test_a_spot_is_blurred_by_a_disc_and_keeps_its_light(
    depth: float, sides: tuple[str, ...]
) -> None:
    picture = spot(path_of(facing(depth), **dict.fromkeys(sides, LENS)))
    diameter = LENS.aperture * abs(1 / depth - 1 / LENS.focus) * SIZE
    centroid, covariance = moments(picture)
    assert picture.sum() == pytest.approx(1, rel=0.02)
    np.testing.assert_allclose(centroid, SIZE // 2, atol=0.03)
    np.testing.assert_allclose(np.diag(covariance), law(diameter, len(sides)), rtol=0.05)
    assert abs(covariance[0, 1]) < 0.02 * (1 + covariance[0, 0])


@pytest.mark.parametrize("side", ["camera", "projector"])
@pytest.mark.parametrize("column", [9, 29])
def test_the_blur_varies_over_tilted_planes(side: str, column: int) -> None:
    left, right = Plane("left", (0, 0, 3), (1, 0, -1)), Plane("right", (0, 0, 3), (-1, 0, -1))
    lens = Lens(0.8, 4.5)
    x = (column + 0.5) / SIZE - 0.5
    depth = 3 / (1 + abs(x))
    diameter = lens.aperture * (1 / depth - 1 / lens.focus) * SIZE
    _, covariance = moments(spot(path_of(left, right, **{side: lens}), column=column))
    np.testing.assert_allclose(np.diag(covariance), law(diameter), rtol=0.05)


def test_an_even_surface_stays_even_up_to_the_edge_of_the_light() -> None:
    sharp, blurred = (
        seen(path_of(facing(2.0), camera=lens, projector=lens), np.ones((SIZE, SIZE)))
        for lens in (None, LENS)
    )
    inner = slice(9, -9)  # the circle has a diameter of 8 pixels
    np.testing.assert_allclose(blurred[inner, inner], sharp[inner, inner], atol=1e-5)
    assert blurred[0].max() < 0.6  # half of the light comes from outside the lit part


CARD = upright("card", (-0.25, 0.0, 2.0), (0.25, 2.0), 0)
"""A card in the left half of the picture, between pinhole and plane; its edge is in the middle."""


def share_of_disc(distance: np.ndarray) -> np.ndarray:
    """Share of a disc of radius 1 on the left of a line at a distance from its centre."""
    x = np.clip(distance, -1, 1)
    return 0.5 + (x * np.sqrt(1 - x**2) + np.arcsin(x)) / np.pi


FROM_EDGE = np.arange(SIZE) + 0.5 - SIZE / 2
RADIUS = 0.4 * (1 / 2.0 - 1 / 4.0) * SIZE
"""Radius of the card's circle of confusion with `FAR`, and distances from its edge, in pixels."""

FAR = Lens(aperture=0.8, focus=4.0)


@pytest.mark.parametrize("side", ["camera", "projector"])
def test_a_card_out_of_focus_covers_part_of_the_lens(side: str) -> None:
    """The camera sees its blurred edge, the projector casts a penumbra on the plane behind."""
    albedo = np.ones(RAYS)
    albedo[:, : RAYS[1] // 2] = 0.0  # the card is black
    path = path_of(CARD, facing(4.0), albedo=albedo, **{side: FAR})
    row = seen(path, np.ones((SIZE, SIZE)))[SIZE // 2]
    expected = np.where(FROM_EDGE < 0, 0, share_of_disc(FROM_EDGE / RADIUS))
    inner = slice(10, -10)
    np.testing.assert_allclose(row[inner], expected[inner], atol=0.05)


def bench_of(scene: dict[str, Any], **lenses: Any) -> BenchConfig:
    plain = {"scene": scene, "display_shape": (48, 60), "camera_shape": (22, 28), **lenses}
    return BenchConfig.model_validate(plain)


SHAPES = {"shape": (6, 6), "channels": 1}


def test_without_aperture_a_bench_has_pinholes() -> None:
    light = np.random.default_rng(0).random((48, 60))
    closed = {side: {"aperture": 0.0, "focus": 2.0} for side in ("projector_lens", "camera_lens")}
    pinholes, shut = (
        optical_path(bench_of({"kind": "wedge", **SHAPES}, **lenses)) for lenses in ({}, closed)
    )
    assert pinholes.describe() == shut.describe()
    assert pinholes.radiance(light).tobytes() == shut.radiance(light).tobytes()


@pytest.mark.parametrize("side", ["projector_lens", "camera_lens"])
def test_a_lens_blurs_every_view(side: str) -> None:
    sharp, blurred = (
        optical_path(bench_of({"kind": "room", "views": (1, 2), **SHAPES}, **{side: lens}))
        for lens in (None, {"aperture": 1.0, "focus": 6.0})
    )
    columns = sharp.layout.picture(np.arange(sharp.layout.pixels_of_ray.size) % 2)
    steps = [np.abs(np.diff(path.radiance(columns)[..., 0])) for path in (sharp, blurred)]
    for half in (slice(None, 13), slice(15, None)):
        before, after = (step[:, half].sum() for step in steps)
        assert after < 0.9 * before
    assert sharp.describe() != blurred.describe()


def test_the_lens_of_a_scene_without_known_depths_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "matrix.npy", np.eye(64))
    matrix = {"kind": "matrix", "file": str(tmp_path / "matrix.npy"), "shape": (8, 8)}
    bench = bench_of({**matrix, "channels": 1}, camera_lens={"aperture": 0.1})
    with pytest.raises(ConfigError, match="of kind matrix, whose depths are unknown"):
        optical_path(bench)
