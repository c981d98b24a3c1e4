"""Resampling camera pixels to rays: weights, variance, mosaic, defects, and its sensor."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array, random_array

from rfpipe.errors import InputError
from rfpipe.photometry import (
    CameraModel,
    ExactSensor,
    ResampledSensor,
    Resampling,
    sensor_from_description,
)
from rfpipe.photometry.defects import check_floodlit
from rfpipe.photometry.resampling import normalised
from rfpipe.references.reference_images import estimate_references

CAMERA = CameraModel(exposures=(1 / 64, 1 / 16), electrons_per_radiance=200_000.0)
SHAPE, CAMERA_SHAPE = (3, 4), (8, 10)


def random_resampling(shape=SHAPE, camera_shape=CAMERA_SHAPE, seed: int = 0) -> Resampling:
    size = (int(np.prod(shape)), int(np.prod(camera_shape)))
    weights = random_array(size, density=0.1, rng=np.random.default_rng(seed), format="csr")
    return Resampling(shape, camera_shape, normalised(csr_array(weights)))


def resampled(resampling: Resampling, images: np.ndarray, power: int = 1) -> np.ndarray:
    weights = resampling.matrix.power(power)
    flat = images.reshape(len(images), -1, images.shape[-1])
    return np.stack([weights @ image for image in flat]).reshape(len(images), *resampling.shape, -1)


def frames_of(sensor: CameraModel, light: np.ndarray, count: int = 2) -> np.ndarray:
    return np.stack([sensor.expose(light, 0, (0, index)) for index in range(count)])


def black_of(sensor: CameraModel, channels: int, count: int = 4) -> np.ndarray:
    dark = np.zeros((*CAMERA_SHAPE, channels), np.float32)
    frames = [sensor.expose(dark, 1, (1, index)) for index in range(count)]
    return np.mean(frames, axis=0).astype(np.float32)


def test_merging_rays_equals_resampling_of_merged_pixels() -> None:
    resampling = random_resampling()
    sensor = ResampledSensor(CAMERA, resampling)
    light = np.random.default_rng(2).random((*CAMERA_SHAPE, 3), np.float32)
    frames, black = frames_of(CAMERA, light), black_of(CAMERA, 3)
    count = 4
    merged, raw = sensor.merge(frames, black, count), CAMERA.merge(frames, black, count)
    assert np.array_equal(merged.radiance, resampled(resampling, raw.radiance))
    assert np.array_equal(merged.variance, resampled(resampling, raw.variance, 2))
    assert sensor.frame_shape(SHAPE, 3) == (2, *CAMERA_SHAPE, 3)
    assert sensor.exposures == CAMERA.exposures
    assert sensor.frame_dtype == np.uint16


def test_a_mosaic_is_filled_in_before_the_resampling_and_its_noise_counted_once() -> None:
    camera = replace(CAMERA, bayer="GRBG")
    resampling = random_resampling()
    sensor = ResampledSensor(camera, resampling)
    light = np.random.default_rng(2).random((*CAMERA_SHAPE, 3), np.float32)
    black = black_of(camera, 3)
    merged = sensor.merge(frames_of(camera, light, 800), black)
    raw = camera.merge(frames_of(camera, light, 3), black)
    assert sensor.frame_shape(SHAPE, 3) == (2, *CAMERA_SHAPE)
    assert merged.radiance[:3] == pytest.approx(resampled(resampling, raw.radiance), rel=1e-4)
    # the mean over rays and colours of measured over predicted variance; frames share `black`,
    # whose noise is part of the prediction: read noise, small compared with shot noise
    ratio = merged.radiance.var(axis=0) / merged.variance.mean(axis=0)
    assert ratio.mean() == pytest.approx(1, abs=0.03)


def test_an_invisible_ray_has_no_light_and_causes_no_error() -> None:
    complete = random_resampling()
    rows = complete.matrix.toarray()
    rows[5] = 0
    unseen = replace(complete, matrix=normalised(csr_array(rows)))
    sensor = ResampledSensor(CAMERA, unseen)
    light = np.ones((*CAMERA_SHAPE, 1), np.float32)
    frames, black = frames_of(CAMERA, light), black_of(CAMERA, 1)
    merged = sensor.merge(frames, black)
    assert merged.radiance[:, 1, 1].tolist() == [[0], [0]]
    assert merged.variance[:, 1, 1].tolist() == [[0], [0]]
    check_floodlit(merged.radiance, merged.variance)
    assert not sensor.resampling.visible[1, 1]
    assert sensor.resampling.visible.sum() == 11
    references = estimate_references(sensor, [np.stack([black, black]).astype(np.uint16)], [frames])
    assert references.floodlit.shape == (*SHAPE, 1)


def test_defective_pixels_have_no_weight() -> None:
    resampling = random_resampling()
    mask = np.zeros(CAMERA_SHAPE, bool)
    mask[2, 3:6] = True
    clean = resampling.without(mask)
    assert clean.matrix[:, [23, 24, 25]].nnz == 0
    assert clean.matrix.sum(axis=1) == pytest.approx(np.ones(12), rel=1e-5)


def test_a_ray_without_a_good_pixel_is_unknown() -> None:
    rows = np.eye(12, dtype=np.float32)
    rows[7] = 0  # a ray that the camera doesn't see is dark with certainty
    sensor = ResampledSensor(CAMERA, Resampling(SHAPE, SHAPE, csr_array(rows)))
    light = np.full((*SHAPE, 1), 0.5, np.float32)
    dark, frames = frames_of(CAMERA, np.zeros_like(light), 8), frames_of(CAMERA, light, 2)
    dark[:, :, 0, 1], frames[:, :, 0, 1] = 3000, 3000
    references = estimate_references(sensor, [dark], [frames])
    for image, spread in (
        (references.floodlit, references.floodlit_variance),
        (references.merge(frames, 0).radiance[1], references.merge(frames, 0).variance[1]),
    ):
        assert np.flatnonzero(np.isinf(spread)).tolist() == [1]
        assert np.flatnonzero(image == 0).tolist() == [1, 7]


@pytest.mark.parametrize(
    "sensor",
    [
        ExactSensor(),
        CAMERA,
        replace(CAMERA, bayer="RGGB"),
        ResampledSensor(replace(CAMERA, bayer="RGGB"), random_resampling()),
    ],
)
def test_sensors_are_restored_from_their_description(sensor) -> None:
    description = json.loads(json.dumps(sensor.describe()))
    arrays = sensor.arrays() if isinstance(sensor, ResampledSensor) else None
    restored = sensor_from_description(description, arrays)
    assert json.dumps(restored.describe()) == json.dumps(sensor.describe())


def test_wrong_descriptions_are_refused() -> None:
    sensor = ResampledSensor(CAMERA, random_resampling())
    with pytest.raises(InputError, match="different calibrations"):
        sensor_from_description(sensor.describe(), random_resampling(seed=1).arrays())
