"""The response of a non-linear camera, recovered from a bracket [DM97]."""

import numpy as np
import pytest

from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel, MergeOptions, Response, recover_response

EXPOSURES = tuple(2.0**-k for k in range(6, -1, -1))


def ramp() -> np.ndarray:
    """An evenly lit, textured scene over three decades."""
    steps = np.geomspace(2e-3, 1.8, 60)[None, :, None]
    return (steps * np.random.default_rng(0).uniform(0.5, 1, (40, 60, 3))).astype(np.float32)


def bracket(camera: CameraModel, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    off = [camera.expose(np.zeros_like(image), 0, (9, index)) for index in range(8)]
    return camera.expose(image, 0, (0, 0)), np.mean(off, axis=0).astype(np.float32)


@pytest.mark.parametrize("gamma", [0.7, 1.0, 2.2])
def test_merge_with_the_recovered_response_is_as_good_as_with_the_true_one(gamma: float) -> None:
    camera = CameraModel(exposures=EXPOSURES, response_gamma=gamma)
    image = ramp()
    frames, black = bracket(camera, image)
    response = recover_response(frames, EXPOSURES, black, camera.white_level)
    errors = []
    for given in (None, response):
        merged = camera.merge(frames[None], black, MergeOptions(8, response=given))
        ratio = merged.radiance[0] / image
        errors.append(np.std(ratio / np.median(ratio)))  # a response is known up to a factor
    assert errors[1] < 2 * errors[0]
    assert errors[1] < 0.02


def test_recovered_response_is_monotone_and_the_cameras_curve() -> None:
    camera = CameraModel(exposures=EXPOSURES, response_gamma=2.2)
    response = recover_response(*_arguments(camera))
    assert (np.diff(response.level) > 0).all()
    assert (np.diff(response.exposure) > 0).all()
    level = np.linspace(0.15, 0.95, 30)
    ratio = response.linearise(level) / level**2.2
    np.testing.assert_allclose(ratio / np.median(ratio), 1, atol=0.05)


def test_recovery_depends_on_its_seed_alone() -> None:
    camera = CameraModel(exposures=EXPOSURES, response_gamma=1.8)
    one, two = (recover_response(*_arguments(camera)) for _ in range(2))
    np.testing.assert_array_equal(one.exposure, two.exposure)


def test_recovery_needs_two_exposures_and_light() -> None:
    camera = CameraModel(exposures=EXPOSURES)
    frames, exposures, black, white = _arguments(camera)
    with pytest.raises(CaptureError, match="from one exposure"):
        recover_response(frames[:1], exposures[:1], black[:1], white)
    with pytest.raises(CaptureError, match="between black and saturated"):
        recover_response(np.full_like(frames, white), exposures, black, white)
    with pytest.raises(InputError, match="don't belong together"):
        recover_response(frames, exposures[:2], black, white)


def test_response_is_odd_about_the_black_level() -> None:
    response = Response(np.array([0, 0.5, 1]), np.array([0, 0.25, 1]))
    np.testing.assert_allclose(response.linearise([-0.5, 0, 0.25, 1]), [-0.25, 0, 0.125, 1])


@pytest.mark.parametrize(
    "exposure", [[0, 0.5, 0.4, 1], [0, 0.5, 1], [0, 0.5, np.nan, 1], [0.1, 0.2, 0.3, 1]]
)
def test_a_table_that_is_no_response(exposure: list[float]) -> None:
    with pytest.raises(InputError, match="a response"):
        Response(np.linspace(0, 1, 4), np.array(exposure))


def _arguments(
    camera: CameraModel,
) -> tuple[np.ndarray, tuple[float, ...], np.ndarray, int]:
    frames, black = bracket(camera, ramp())
    return frames, camera.exposures, black, camera.white_level


def test_recovery_leaves_out_stuck_pixels() -> None:
    frames, exposures, black, white = _arguments(CameraModel(exposures=EXPOSURES))
    frames[:, 3, 4, 0] = black[:, 3, 4, 0] = white
    response = recover_response(frames, exposures, black, white)
    assert response.linearise(0.5) == pytest.approx(0.5, rel=0.1)
