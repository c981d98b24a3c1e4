"""The merge of brackets: unbiased, with its stated variance, and free of NaN."""

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.errors import CaptureError
from rfpipe.photometry import CameraModel, ExactSensor, MergedImages
from rfpipe.photometry.camera import UNKNOWN_DEVIATION, merge_bracket
from rfpipe.photometry.demosaic import demosaic

CAMERA = CameraModel()


def take(camera: CameraModel, image: np.ndarray, count: int = 8, key: int = 0) -> MergedImages:
    """Return the merge of exposed brackets, with `count` all-off brackets."""
    return camera.merge(camera.expose(image, 1, (2, key))[None], black(camera, image, count), count)


def black(camera: CameraModel, image: np.ndarray, count: int = 8) -> np.ndarray:
    off = [camera.expose(np.zeros_like(image), 1, (10**6, index)) for index in range(count)]
    return np.mean(off, axis=0).astype(np.float32)


def flat(value: float, shape: tuple[int, ...] = (100, 200, 3)) -> np.ndarray:
    return np.full(shape, value, np.float32)


BENT = replace(CAMERA, response_gamma=2.2, black_level_counts=512, dark_current_electrons=0.0)
"""Its counts are steep at the black level: noise needs room there, see `CameraModel.merge`."""


@pytest.mark.parametrize("camera", [CAMERA, BENT], ids=["linear", "bent"])
@pytest.mark.parametrize("radiance", [0.0, 1e-5, 1e-4, 1e-3, 5e-3, 0.1, 1.5])
def test_merge_is_unbiased_and_states_its_variance(radiance: float, camera: CameraModel) -> None:
    merged = take(camera, flat(radiance))
    assert merged.saturated == 0
    deviation = float(np.sqrt(merged.variance.mean(dtype=np.float64)))
    bias = merged.radiance.mean(dtype=np.float64) - radiance
    assert abs(bias) < 5 * deviation / np.sqrt(merged.radiance.size)
    # at zero, positive noise counts as signal, so the stated variance is slightly too large
    assert merged.radiance.std() == pytest.approx(deviation, rel=0.05 if radiance else 0.1)


def test_weights_from_the_pooled_estimate_are_unbiased_and_optimal() -> None:
    """Weighting each exposure by its own noisy count pulls dark samples towards zero."""
    collection = np.array([4.0, 6.0, 9.0])  # electrons at a radiance of 1
    noise = np.float32(1.0)
    random = np.random.default_rng(0)
    size = 200_000
    drawn = random.poisson(collection[:, None], (3, size)) + random.normal(0, 1, (3, size))
    electrons = drawn.astype(np.float32)
    usable = np.ones(electrons.shape, bool)
    pooled, variance, _ = merge_bracket(electrons, usable, collection, [noise] * 3, 1e3)
    error = np.sqrt(variance.mean() / size)
    assert abs(pooled.mean(dtype=np.float64) - 1) < 5 * error
    # its variance equals the one of the best linear estimate, with the true weights
    best = 1 / np.sum(collection**2 / (collection + noise))
    assert pooled.var(dtype=np.float64) == pytest.approx(best, rel=0.02)


def test_noise_of_the_black_level_is_in_the_variance() -> None:
    for count in (1, 4):
        merged = take(CAMERA, flat(0.0), count)
        assert merged.radiance.std() <= np.sqrt(merged.variance.mean()) * 1.01
    assert (
        take(CAMERA, flat(0.0), 1).variance.mean()
        > 1.8 * take(CAMERA, flat(0.0), 64).variance.mean()
    )


def test_black_level_is_subtracted_before_the_merge() -> None:
    """An offset that varies with the pixel and the exposure is removed."""
    image = flat(0.004)
    pedestal = np.random.default_rng(0).integers(0, 200, (4, *image.shape)).astype(np.uint16)
    frames = CAMERA.expose(image, 0, (1, 1)) + pedestal
    shifted = CAMERA.merge(frames[None], black(CAMERA, image) + pedestal, 8)
    plain = CAMERA.merge((frames - pedestal)[None], black(CAMERA, image), 8)
    usable = (frames < 0.98 * CAMERA.white_level).all(axis=0)
    np.testing.assert_allclose(
        shifted.radiance[0][usable], plain.radiance[0][usable], atol=1e-4, rtol=0
    )
    # light in the all-off frames adds its shot noise
    assert (shifted.variance >= plain.variance).all()
    assert shifted.variance.mean() > 1.2 * plain.variance.mean()


def test_a_completely_saturated_sample_has_the_clipped_value_and_infinite_variance() -> None:
    image = flat(0.1, (6, 7, 3))
    image[2, 3, 1] = 50
    merged = take(CAMERA, image)
    assert merged.saturated == 1
    full_scale = CAMERA.full_well_electrons / CAMERA.electrons_per_radiance / CAMERA.exposures[0]
    assert merged.radiance[0, 2, 3, 1] == pytest.approx(full_scale, rel=1e-2)
    assert merged.variance[0, 2, 3, 1] == pytest.approx((UNKNOWN_DEVIATION * full_scale) ** 2)
    assert np.isfinite(merged.radiance).all()
    assert np.isfinite(merged.variance).all()
    np.testing.assert_allclose(
        np.delete(merged.radiance.ravel(), (2 * 7 + 3) * 3 + 1), 0.1, rtol=0.1
    )


def test_a_pixel_stuck_at_full_scale_is_as_uncertain() -> None:
    image = flat(0.1, (4, 5, 1))
    frames, off = CAMERA.expose(image, 0, (0, 0)), black(CAMERA, image)
    frames[:, 1, 1], off[:, 1, 1] = CAMERA.white_level, CAMERA.white_level
    merged = CAMERA.merge(frames[None], off, 8)
    assert merged.radiance[0, 1, 1, 0] == 0
    full_scale = CAMERA.full_well_electrons / CAMERA.electrons_per_radiance / CAMERA.exposures[0]
    assert merged.variance[0, 1, 1, 0] == pytest.approx((UNKNOWN_DEVIATION * full_scale) ** 2)
    assert merged.saturated == 1


def test_counts_near_full_scale_are_saturated() -> None:
    first = int(np.ceil(0.98 * CAMERA.white_level))
    frames = np.full((1, 4, 1, 2, 1), first - 1, np.uint16)
    frames[:, :, 0, 0] = first
    assert CAMERA.merge(frames, np.zeros(frames.shape[1:])).saturated == 1


def test_no_brackets_merge_to_empty_arrays() -> None:
    image = flat(0.0, (4, 5, 3))
    for sensor in (CAMERA, replace(CAMERA, bayer="RGGB"), ExactSensor()):
        shape = sensor.frame_shape((4, 5), 3)
        none = np.zeros((0, *shape), sensor.frame_dtype)
        merged = sensor.merge(none, np.zeros(shape, np.float32))
        assert merged.radiance.shape == merged.variance.shape == (0, *image.shape)


def test_wrong_frames_are_refused() -> None:
    image = flat(0.1, (4, 5, 3))
    off, bracket = black(CAMERA, image), CAMERA.expose(image, 0, (0, 0))[None]
    with pytest.raises(CaptureError, match=r"pattern 32: brackets have the shape \(4, 4, 4, 3\)"):
        CAMERA.bracket_merge(off)(bracket[:, :, :, :4], 32)
    with pytest.raises(CaptureError, match="dtype float64"):
        CAMERA.bracket_merge(off)(bracket.astype(float), 32)
    wild = np.repeat(bracket, 2, axis=0)
    wild[1, 2, 3, 4, 0] = 5000
    with pytest.raises(
        CaptureError, match=r"pattern 33 holds 5000 counts at exposure 2, pixel \(3, 4, 0\).* 4095"
    ):
        CAMERA.bracket_merge(off)(wild, 32)
    off[0, 0, 0, 0] = np.nan
    with pytest.raises(CaptureError, match="all-off frames hold NaN"):
        CAMERA.merge(bracket, off)


@pytest.mark.parametrize("value", [np.nan, -np.inf, -0.5])
def test_impossible_float_frames_are_named(value: float) -> None:
    frames = np.ones((3, 1, 4, 5, 3), np.float32)
    frames[1, 0, 2, 3, 1] = value
    with pytest.raises(CaptureError, match=rf"pattern 33 holds {value} at pixel \(0, 2, 3, 1\)"):
        ExactSensor().bracket_merge(np.zeros(frames.shape[1:]))(frames, 32)


def test_exact_sensor_returns_the_radiance() -> None:
    image = np.random.default_rng(0).random((4, 5, 3)).astype(np.float32)
    sensor = ExactSensor()
    bracket = sensor.expose(image, 0, (0, 0))
    assert bracket.shape == sensor.frame_shape((4, 5), 3)
    merged = sensor.merge(bracket[None], np.zeros_like(bracket))
    np.testing.assert_array_equal(merged.radiance[0], image)
    assert not merged.variance.any()
    assert merged.saturated == 0
    light = np.full_like(bracket, 0.25)
    lit = sensor.merge(bracket[None] + light, light).radiance[0]
    np.testing.assert_allclose(lit, image, atol=1e-7)


@pytest.mark.parametrize("pattern", ["RGGB", "BGGR", "GRBG", "GBRG"])
@pytest.mark.filterwarnings("ignore")  # the library triggers its deprecation warnings
def test_demosaic_agrees_with_a_library_on_an_image_mirrored_beforehand(pattern: str) -> None:
    from colour_demosaicing import demosaicing_CFA_Bayer_bilinear

    samples = np.random.default_rng(0).random((7, 8)).astype(np.float32)
    padded = np.pad(samples, 2, mode="reflect")
    expected = demosaicing_CFA_Bayer_bilinear(padded, pattern)[2:-2, 2:-2]
    colour, _ = demosaic(samples, np.ones_like(samples), pattern)
    np.testing.assert_allclose(colour, expected, rtol=0, atol=1e-6)


def test_demosaic_states_the_variance_of_its_interpolation() -> None:
    random = np.random.default_rng(0)
    variance = random.uniform(0.5, 2, (6, 7)).astype(np.float32)
    noise = random.normal(0, np.sqrt(variance), (3000, 6, 7)).astype(np.float32)
    colour, stated = demosaic(noise, np.broadcast_to(variance, noise.shape), "GBRG")
    np.testing.assert_allclose(colour.var(axis=0), stated[0], rtol=0.15)
