"""The camera model: moments of its counts, limits, optics and noise."""

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.errors import InputError
from rfpipe.photometry import CameraModel, ExactSensor
from rfpipe.photometry.camera import apply_optics
from rfpipe.photometry.demosaic import mosaic

QUIET = CameraModel(read_noise_electrons=0.0, dark_current_electrons=0.0)
"""Photon noise and rounding alone."""

FINE = replace(QUIET, exposures=(1.0,), bits=16, full_well_electrons=65_471.0)
"""One electron a count."""


def flat(value: float, shape: tuple[int, ...] = (250, 400, 1)) -> np.ndarray:
    return np.full(shape, value, np.float32)


def electrons(camera: CameraModel, mean: float, **settings: float) -> np.ndarray:
    """Return the electrons of the camera's first exposure for a mean of `mean` electrons."""
    camera = replace(camera, **settings)
    image = flat(mean / camera.electrons_per_radiance / camera.exposures[0])
    counts = camera.expose(image, 3, (0, 0))[0]
    return (counts.astype(float) - camera.black_level_counts) * camera.electrons_per_count


@pytest.mark.parametrize("mean", [0.3, 5.0, 40.0, 63.0, 65.0, 500.0, 20_000.0])
def test_shot_noise_has_the_moments_of_poisson(mean: float) -> None:
    drawn = electrons(FINE, mean)
    error = np.sqrt(mean / drawn.size)
    assert drawn.mean() == pytest.approx(mean, abs=5 * error)
    # the variance of a sample variance: (mu4 - sigma^4) / n, mu4 = 3 mean^2 + mean; where shot
    # noise is a rounded Gaussian, rounding adds 1/12
    spread = np.sqrt((2 * mean**2 + mean) / drawn.size)
    rounding = 1 / 12 if mean >= 64 else 0
    assert drawn.var() == pytest.approx(mean + rounding, abs=5 * spread)
    skewness = np.mean((drawn - drawn.mean()) ** 3) / drawn.std() ** 3
    allowed = 1 / 8 if mean >= 64 else 0
    assert abs(skewness - mean**-0.5) < allowed + 5 * np.sqrt(6 / drawn.size) + 0.1 / mean


def test_read_noise_and_dark_current() -> None:
    drawn = electrons(FINE, 0.0, read_noise_electrons=7.0, dark_current_electrons=4.0)
    assert drawn.mean() == pytest.approx(4.0, abs=5 * 7.4 / np.sqrt(drawn.size))
    expected = 7.0**2 + 4.0 + 1 / 12
    assert drawn.var() == pytest.approx(expected, rel=5 * np.sqrt(2 / drawn.size))


def test_full_well_is_full_scale_and_darkness_is_the_black_level() -> None:
    camera = replace(QUIET, exposures=(1.0,))
    bright = flat(10 * camera.full_well_electrons / camera.electrons_per_radiance)
    assert (camera.expose(bright, 0, (0, 0)) == camera.white_level).all()
    assert (camera.expose(flat(0.0), 0, (0, 0)) == camera.black_level_counts).all()
    half = flat(0.5 * camera.full_well_electrons / camera.electrons_per_radiance)
    expected = (camera.white_level + camera.black_level_counts) / 2
    assert camera.expose(half, 0, (0, 0)).mean() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
def test_mosaic_samples_each_photosite_in_its_colour(pattern: str) -> None:
    image = np.arange(4 * 6 * 3, dtype=np.float32).reshape(4, 6, 3)
    sampled = mosaic(image, pattern)
    for y, x in np.ndindex(4, 6):
        assert sampled[y, x] == image[y, x, "RGB".index(pattern[2 * (y % 2) + x % 2])]


def test_frames_under_a_mosaic_have_no_channels() -> None:
    camera = CameraModel(bayer="RGGB")
    assert camera.frame_shape((2, 4, 5), 3) == (4, 2, 4, 5)
    assert camera.expose(flat(0.1, (2, 4, 5, 3)), 0, (0, 0)).shape == (4, 2, 4, 5)
    with pytest.raises(InputError, match="not 1 of"):
        camera.frame_shape((4, 5), 1)
    with pytest.raises(InputError, match=r"not 3 of \(1, 5\)"):
        camera.frame_shape((1, 5), 3)


def test_blur_conserves_light_and_does_not_mix_views() -> None:
    image = np.zeros((2, 9, 11, 3), np.float32)
    image[0, 0, 5, 1] = 1  # at the border, in one view and channel
    blurred = apply_optics(image, 1.5, 0.0, 0.0)
    assert blurred.sum() == pytest.approx(1, rel=1e-5)
    assert blurred[0, ..., 1].sum() == pytest.approx(1, rel=1e-5)
    assert blurred[0, 0, 5, 1] < 0.3
    np.testing.assert_allclose(apply_optics(flat(2.0, (6, 7, 3)), 1.5, 0, 0), 2, rtol=1e-6)


def test_vignetting_takes_its_fraction_from_the_corners() -> None:
    vignetted = apply_optics(flat(1.0, (9, 13, 1)), 0, 0.4, 0)[..., 0]
    assert vignetted[4, 6] == 1
    np.testing.assert_allclose(vignetted[[0, 0, -1, -1], [0, -1, 0, -1]], 0.6, rtol=1e-6)
    assert (np.diff(vignetted[4, 6:]) < 0).all()
    assert apply_optics(flat(1.0, (1, 1, 1)), 0, 0.4, 0) == 1


def test_flare_spreads_a_fraction_of_each_views_light() -> None:
    image = np.zeros((2, 4, 5, 3), np.float32)
    image[1, 2, 3, 0] = 20
    spread = apply_optics(image, 0, 0, 0.1)
    assert spread.sum() == pytest.approx(20, rel=1e-5)
    assert (spread[0] == 0).all()
    assert (spread[..., 1:] == 0).all()
    np.testing.assert_allclose(spread[1, 0, 0, 0], 0.1, rtol=1e-6)
    np.testing.assert_allclose(spread[1, 2, 3, 0], 0.9 * 20 + 0.1, rtol=1e-6)


def test_a_white_level_below_full_scale_limits_the_counts() -> None:
    camera = CameraModel(bits=14, black_level_counts=600, white_level_counts=15_300)
    assert camera.white_level == 15_300
    assert camera.electrons_per_count == 20_000 / 14_700
    assert camera.expose(np.full((4, 5, 1), 1e9), 0, (0,)).max() == 15_300
    assert "white_level_counts" not in CameraModel().describe()  # as before there was one
    for wrong in (600, 2**14):
        with pytest.raises(InputError, match="black_level_counts is"):
            replace(camera, white_level_counts=wrong)


@pytest.mark.parametrize("sensor", [ExactSensor(), CameraModel()], ids=["exact", "camera"])
def test_slightly_negative_radiance_is_black(sensor: ExactSensor | CameraModel) -> None:
    image = flat(1.0, (4, 5, 3))
    image[2, 3, 1] = -1e-6
    dark = image.copy()
    dark[2, 3, 1] = 0
    np.testing.assert_array_equal(sensor.expose(image, 0, (1, 1)), sensor.expose(dark, 0, (1, 1)))
