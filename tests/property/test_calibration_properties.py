"""Properties of structured light and of pixel overlaps for any sizes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from rfpipe.calibration.correspondence import AxisCode, SmoothMap
from rfpipe.calibration.rays import coverage, fit_rays, overlapped_pixels
from rfpipe.rigs.layout import ProjectorLayout


def exact_map(homography: np.ndarray) -> SmoothMap:
    return SmoothMap(homography, np.zeros((10, 2)), np.zeros(2), 1.0, 0.0, 0.0)


@given(
    st.integers(4, 700), st.sampled_from([8, 12, 16, 20, 32]),
    st.floats(0.01, 5), st.floats(0, 3), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_every_pixel_is_decoded_exactly(
    extent: int, period: int, albedo: float, ambient: float, seed: int
) -> None:
    code = AxisCode(extent, period)
    lines = np.stack(code.lines()).astype(float)
    # neighbouring cells differ in one bit
    bits = lines[: 2 * code.bits : 2]
    assert np.abs(np.diff(bits, axis=1)).sum(axis=0).max() <= 1
    assert lines.min() >= 0
    assert lines.max() <= 1
    result = code.decode(albedo * lines + ambient, np.full(lines.shape, 1e-12))
    assert result["valid"].all()
    assert np.abs(result["coordinate"] - np.arange(extent) - 0.5).max() < 1e-3
    assert np.abs(result["contrast"] - 1).max() < 1e-3
    # an error in one of the two finest bits next to a cell's edge is corrected
    flipped = lines.copy()
    pixel = np.random.default_rng(seed).integers(0, extent)
    pair = 2 * (code.bits - 1)
    near_edge = pixel % (period // 4) in (0, period // 4 - 1)
    if near_edge:
        flipped[pair : pair + 2, pixel] = 0.5
    repeated = code.decode(albedo * flipped + ambient, np.full(lines.shape, 1e-12))
    assert abs(repeated["coordinate"][pixel] - pixel - 0.5) < 1e-3


@given(
    st.integers(1, 6), st.integers(1, 6), st.floats(0.3, 4), st.floats(-0.7, 0.7),
    st.floats(-2, 8), st.floats(-2, 8),
)  # fmt: skip
def test_overlaps_have_the_area_of_the_outline(
    rows: int, columns: int, scale: float, angle: float, x0: float, y0: float
) -> None:
    y, x = np.mgrid[: rows + 1, : columns + 1].astype(float)
    turn = scale * np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    corners = np.stack([x, y], -1) @ turn + (x0 + 40, y0 + 40)
    around = corners[:-1, :-1], corners[:-1, 1:], corners[1:, 1:], corners[1:, :-1]
    outlines = np.stack(around, axis=2).reshape(-1, 4, 2)
    camera, projector, share, areas = overlapped_pixels(outlines, (120, 120))
    total = np.bincount(camera, share, rows * columns)
    assert np.abs(total - 1).max() < 1e-6
    # the overlaps of an inner projector pixel with all camera pixels add up to its area
    chosen = np.bincount(projector, share * scale**2, 120 * 120)
    assert chosen.max() < 1 + 1e-6
    assert np.isclose(chosen.sum(), rows * columns * scale**2)
    np.testing.assert_allclose(areas, share * scale**2, rtol=1e-9)


@given(st.floats(2.0, 4.5), st.floats(-0.2, 0.2), st.floats(0, 1), st.floats(0, 1))
def test_resampling_inverts_the_mixture_of_rays_in_camera_pixels(
    pixels: float, angle: float, x0: float, y0: float
) -> None:
    side = 8  # projector pixels per ray
    step = side / pixels
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) * step
    centre = np.array([32, 32]) - turn @ np.array([20, 20]) + np.array([x0, y0])
    homography = np.block([[turn, centre[:, None]], [np.zeros((1, 2)), np.ones((1, 1))]])
    maps = [exact_map(homography)]
    layout = ProjectorLayout.grid((64, 64), (8, 8))
    fit = fit_rays(maps, layout, (40, 40))
    light = np.random.default_rng(0).random(64)
    shares, area = coverage(maps, layout, (40, 40))
    assert (area <= layout.pixels_of_ray * (1 + 1e-9)).all()
    camera = shares @ light
    rays = fit.resampling.matrix @ camera
    received = fit.resampling.visible.ravel()
    assert received.any()
    bound = fit.leak[received] * light.max() + 1e-4
    assert (np.abs(rays - light)[received] <= bound).all()
    assert np.median(fit.leak[received]) < 0.01
