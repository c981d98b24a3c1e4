"""Correspondences by structured light, smooth maps, rays and views, for known homographies."""

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from tests.rigs.calibration_bench import CAMERA, Bench, surface_bench, wedge_bench

from rfpipe.calibration.context import StepContext
from rfpipe.calibration.correspondence import (
    SmoothMap,
    find_views,
    fit_blur,
    fit_map,
    map_of_pixels,
    maps_of_views,
    measure_correspondence,
)
from rfpipe.calibration.dark import measure_dark
from rfpipe.calibration.rays import RayFit, fit_rays, measure_rays
from rfpipe.calibration.verdicts import Findings, Verdict
from rfpipe.config import CalibrationConfig
from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel
from rfpipe.rigs.build import DeviceRig
from rfpipe.rigs.layout import DARK, ProjectorLayout, apply_homography, pixel_middles
from rfpipe.scenes.lenses import Lens
from rfpipe.scenes.relighting import relighting_patterns

HOMOGRAPHY = np.array([[4.1, 0.12, 3.0], [-0.2, 3.9, 5.0], [2e-4, -1e-4, 1.0]])


def context_of(bench: Bench, **settings: object) -> StepContext:
    """Return the context of a bench with a measured black level and a linear projector."""
    config = CalibrationConfig(dark_frames=4, **settings)
    context = StepContext(bench.projector, bench.camera, config, None, {}, lambda _: nullcontext())
    light = Findings(Verdict("good", ""), {}, {"light": np.linspace(0, 1, 256)})
    return replace(context, findings={"dark": measure_dark(context), "light": light})


def correspondence_of(bench: Bench, **settings: object) -> Findings:
    return measure_correspondence(context_of(bench, **settings))


def map_of(findings: Findings) -> SmoothMap:
    return map_of_pixels(findings, findings["valid"])


def errors_of(bench: Bench, findings: Findings) -> tuple[float, float]:
    """Return the mean error of single pixels and of the smooth map, in projector pixels."""
    points = pixel_middles(bench.camera.shape)
    true = bench.path.projector_points(points)
    visible = np.isfinite(true[..., 0])
    measured = np.stack([findings["x"], findings["y"]], axis=-1)
    smooth = map_of(findings)
    single = np.hypot(*(measured - true)[visible & findings["valid"]].T)
    return float(single.mean()), float(np.hypot(*(smooth(points) - true)[visible].T).mean())


@pytest.mark.parametrize("changes", [{}, {"bits": 8}, {"electrons_per_radiance": 20_000.0}])
def test_the_correspondence_is_found_within_a_tenth_of_a_pixel(changes: dict) -> None:
    bench = wedge_bench(sensor=replace(CAMERA, **changes))
    findings = correspondence_of(bench)
    single, smooth = errors_of(bench, findings)
    # one camera pixel sees nine projector pixels, with texture in them
    assert single < 0.3
    assert smooth < 0.05
    assert findings.verdict.standing == "good"
    outside = np.isnan(bench.path.projector_points(pixel_middles((48, 54)))[..., 0])
    # a pixel whose middle is outside may still see the edge
    assert findings["valid"][outside].sum() < 0.1 * outside.sum()
    assert findings["valid"][~outside].mean() > 0.97


def test_the_correspondence_is_found_out_of_focus() -> None:
    # circles of 4 camera pixels at the left and right edge, more than a ray; the middle is sharp
    bench = wedge_bench(camera=(56, 63), lens=Lens(aperture=0.48, focus=3.0))
    findings = correspondence_of(bench)
    single, smooth = errors_of(bench, findings)
    assert single < 0.5
    assert smooth < 0.05
    assert findings.verdict.standing == "good"
    assert 0.4 < fit_blur(findings, [map_of(findings)]) < 1.0


def test_the_verdict_names_darkness_and_noise() -> None:
    bench = wedge_bench(rays=(8, 8), display=(32, 32), camera=(24, 24))
    bench.path.radiance = lambda light: np.zeros((24, 24, 1), np.float32)  # type: ignore[method-assign]
    findings = correspondence_of(bench, period_pixels=8)
    assert findings["valid"].sum() == 0
    assert "Only 0 camera pixels" in findings.verdict.text
    bench = wedge_bench(sensor=replace(CAMERA, electrons_per_radiance=300.0))
    assert correspondence_of(bench).verdict.standing == "poor"


def test_a_map_is_robust_estimates_its_error_and_fits_distortion() -> None:
    random = np.random.default_rng(0)
    points = random.uniform(0, 60, (2000, 2))
    true = apply_homography(HOMOGRAPHY, points)
    measured = true + 0.2 * random.standard_normal(true.shape)
    measured[::4] += random.uniform(-50, 50, measured[::4].shape)
    smooth = fit_map(points, measured)
    error = np.hypot(*(smooth(points) - true).T).mean()
    assert error < min(0.03, 3 * smooth.error)
    assert not smooth.distortion.any()
    assert smooth.rms == pytest.approx(0.2 * 2**0.5, rel=0.15)
    from_centre = (points - 30) / 30
    bent = points + from_centre * np.square(from_centre).sum(axis=1, keepdims=True)
    true = apply_homography(HOMOGRAPHY, bent)
    smooth = fit_map(points, true + 0.1 * random.standard_normal(true.shape))
    assert smooth.distortion.any()
    assert np.hypot(*(smooth(points) - true).T).mean() < 0.05


def test_too_few_points_make_no_map() -> None:
    with pytest.raises(CaptureError, match="a map needs 30"):
        fit_map(np.zeros((5, 2)), np.zeros((5, 2)))
    with pytest.raises(CaptureError, match="don't span a plane"):
        fit_map(np.zeros((40, 2)), np.zeros((40, 2)))


@pytest.mark.parametrize(
    ("camera", "blur"), [((40, 45), 0.0), ((64, 72), 0.0), ((56, 63), 0.7), ((56, 63), 1.0)]
)
def test_pictures_on_the_rays_are_those_of_the_scene(camera: tuple[int, int], blur: float) -> None:
    rays, bench = (16, 16), wedge_bench(camera=camera, sensor=replace(CAMERA, psf_sigma=blur))
    findings = correspondence_of(bench)
    smooth = map_of(findings)
    measured = fit_blur(findings, [smooth])
    assert measured == pytest.approx(blur, rel=0.05, abs=0.1 * (blur == 0))
    layout = ProjectorLayout.grid(bench.projector.shape, rays)
    fit = fit_rays([smooth], layout, bench.camera.shape, measured)
    rig = DeviceRig(bench.projector, bench.camera, fit.layout, fit.resampling)
    named = {"floodlit": np.ones(rays, np.float32), **relighting_patterns(rays)}
    off = rig.capture(np.zeros((8, *rays), np.float32), [(9, i) for i in range(8)])
    patterns = np.stack(list(named.values()))
    frames = rig.capture(patterns, [(1, i) for i in range(len(patterns))])
    images = rig.sensor.merge(frames, off.mean(axis=0), 8).radiance
    true = bench.path._scene.apply(patterns.reshape(len(patterns), -1)).reshape(images.shape)
    for name, image, light in zip(named, images, true, strict=True):
        assert np.linalg.norm(image - light) < 0.02 * np.linalg.norm(light), name


def test_rays_that_the_camera_cannot_see_stay_dark() -> None:
    bench = wedge_bench()
    smooth = map_of(correspondence_of(bench))
    layout = ProjectorLayout.grid((144, 160), (16, 16))
    half: RayFit = fit_rays([smooth], layout, (24, 54))  # the camera's upper half
    visible = half.resampling.visible
    assert 100 < visible.sum() < 156
    assert visible[:6].all()
    assert not visible[9:].any()
    lit = np.unique(half.layout.ray_of_pixel)
    assert set(lit[lit != DARK]) == set(np.flatnonzero(visible))
    beside = replace(smooth, homography=np.array([[1.0, 0, 900], [0, 1, 0], [0, 0, 1]]))
    with pytest.raises(CaptureError, match="sees none of the rays"):
        fit_rays([beside], layout, (48, 54))


def test_a_camera_with_too_few_pixels_leaks() -> None:
    context = context_of(wedge_bench(camera=(20, 22)), period_pixels=32)
    findings = {"correspondence": measure_correspondence(context)}
    findings = measure_rays(replace(context, rays=(16, 16), findings=findings))
    assert findings["leak"].max() > 0.02
    assert findings["largest_noise"] > 1.2
    assert findings.verdict.standing == "poor"
    assert "camera pixels per ray" in findings.verdict.text


@pytest.mark.slow
def test_views_of_an_array_are_found_and_rectified() -> None:
    rays, grid = (9, 8, 8), (3, 3)
    bench = surface_bench(rays, (192, 192), (144, 144), grid)
    findings = correspondence_of(bench)
    corners = find_views(findings, grid)
    for quad, (row, column) in zip(corners, np.ndindex(grid), strict=True):
        expected = 64 * np.array([column, row]) + np.array([(0, 0), (64, 0), (64, 64), (0, 64)])
        assert np.abs(np.array(quad) - expected).max() < 3
    layout = ProjectorLayout.within(corners, rays, (192, 192))
    maps = maps_of_views(findings, corners)
    true = bench.path.projector_points(pixel_middles((144, 144)))
    visible = findings["valid"] & np.isfinite(true[..., 0])
    view = (true[visible] // 64).astype(int) @ [1, 3]
    mapped = np.stack([mapping(pixel_middles((144, 144))[visible]) for mapping in maps])
    error = np.hypot(*(mapped[view, np.arange(len(view))] - true[visible]).T)
    assert error.mean() < 0.1
    fit = fit_rays(maps, layout, (144, 144))
    assert fit.resampling.visible.all()
    assert fit.leak.max() < 0.01


def test_missing_views_raise_an_error() -> None:
    bench = surface_bench((4, 8, 8), (128, 128), (96, 96), (2, 2))
    context = context_of(bench, views=(2, 2))
    findings = measure_correspondence(context)
    with pytest.raises(CaptureError, match="has 4 separate views"):
        find_views(findings, (3, 3))
    with pytest.raises(CaptureError, match="too many"):
        measure_rays(replace(context, rays=(100, 100), findings={"correspondence": findings}))


def test_a_mosaic_is_calibrated_by_the_sum_of_its_colours() -> None:
    sensor = CameraModel(bayer="RGGB")
    bench = wedge_bench(sensor=CAMERA)
    grey = bench.path.radiance
    bench.path.radiance = lambda light: np.repeat(grey(light), 3, -1)  # type: ignore[method-assign]
    bench.camera.sensor, bench.camera.channels = sensor, 3
    _, smooth = errors_of(bench, correspondence_of(bench))
    assert smooth < 0.1
