"""Hot, dead and stuck pixels, unlit pixels, and floodlit images without light."""

from dataclasses import replace

import numpy as np
import pytest

from rfpipe.photometry import CameraModel, Sensor
from rfpipe.photometry.defects import (
    DarkFrames,
    DefectMap,
    FrameRange,
    check_floodlit,
    find_defects,
)

CAMERA = CameraModel()


def capture(
    camera: CameraModel, image: np.ndarray, count: int = 8
) -> tuple[np.ndarray, np.ndarray]:
    """Return all-off brackets and floodlit ones."""
    dark = np.zeros_like(image)
    off = np.stack([camera.expose(dark, 1, (10**6, index)) for index in range(count)])
    return off, camera.expose(image, 1, (0, 0))


def defects_of(off: np.ndarray, lit: np.ndarray, sensor: Sensor) -> DefectMap:
    lit_range = FrameRange()
    lit_range.add(lit[None])
    return find_defects(DarkFrames.of(off), lit_range, sensor)


def texture(shape: tuple[int, ...] = (40, 50, 3)) -> np.ndarray:
    """Return random albedos of 0.15 and 0.85, one pixel wide."""
    return np.where(np.random.default_rng(0).random(shape) < 0.5, 0.15, 0.85).astype(np.float32)


@pytest.mark.parametrize("count", [1, 2, 8])
@pytest.mark.parametrize("bayer", [None, "RGGB"])
def test_a_good_camera_has_no_defects(count: int, bayer: str | None) -> None:
    camera = replace(CAMERA, bayer=bayer)
    defects = defects_of(*capture(camera, texture(), count), camera)
    assert defects.mask.shape == (40, 50)
    assert not defects.mask.any()
    assert (defects.hot, defects.dead) == (0, 0)


@pytest.mark.parametrize("bayer", [None, "GBRG"])
def test_surfaces_without_reflection_are_not_defects(bayer: str | None) -> None:
    camera = replace(CAMERA, bayer=bayer)
    image = texture()
    image[10:20, 10:20] = 0  # an occluder
    image[30:, :, 0] = 0  # a surface without red
    assert not defects_of(*capture(camera, image), camera).mask.any()


@pytest.mark.parametrize("black", [0, 64])
def test_constant_counts_are_no_defect_if_rounding_hides_the_noise(black: int) -> None:
    quiet = {"read_noise_electrons": 0.2, "dark_current_electrons": 0.0}
    camera = replace(CAMERA, black_level_counts=black, **quiet)
    image = texture()
    image[8, 9] = 0
    off, lit = capture(camera, image)
    assert (lit[:, 8, 9] == off[:, :, 8, 9]).all()
    assert not defects_of(off, lit, camera).mask.any()


def test_a_black_level_of_zero_clips_noise() -> None:
    camera = replace(CAMERA, black_level_counts=0, read_noise_electrons=15.0)
    image = texture((80, 90, 3))
    image[8:20, 9:30] = 0
    off, lit = capture(camera, image, 2)
    assert (np.concatenate([off, lit[None]]) == 0).all(axis=(0, 1)).any()
    assert not defects_of(off, lit, camera).mask.any()


def test_hot_and_noisy_pixels_and_a_dead_channel() -> None:
    off, lit = capture(CAMERA, texture())
    off[:, 2, 5, 6, 1] += 30
    lit[2, 5, 6, 1] += 30
    off[:, 1, 7, 8, 0] += np.array([0, 40, 0, 0, 35, 0, 60, 0], np.uint16)
    lit[:, 8, 9, 2] = off[:, :, 8, 9, 2] = 65
    defects = defects_of(off, lit, CAMERA)
    assert sorted(map(tuple, np.argwhere(defects.mask))) == [(5, 6), (7, 8), (8, 9)]
    assert (defects.hot, defects.dead) == (2, 1)


@pytest.mark.parametrize("value", [0, 64, 4095])
@pytest.mark.parametrize("pixel", [(5, 6), (0, 0), (39, 20)])
def test_stuck_pixels_are_found(value: int, pixel: tuple[int, int]) -> None:
    off, lit = capture(CAMERA, texture())
    off[(..., *pixel, slice(None))] = value
    lit[(..., *pixel, slice(None))] = value
    defects = defects_of(off, lit, CAMERA)
    assert [tuple(where) for where in np.argwhere(defects.mask)] == [pixel]
    assert defects.hot + defects.dead == 1


def test_a_dead_photosite_also_masks_its_neighbours() -> None:
    camera = replace(CAMERA, bayer="RGGB")
    off, lit = capture(camera, texture())
    lit[:, 8, 9] = off[:, :, 8, 9] = 65
    defects = defects_of(off, lit, camera)
    assert defects.dead == 1
    rows, columns = np.nonzero(defects.mask)
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (7, 9, 8, 10)
    assert defects.mask.sum() == 9


def test_statistics_of_dark_frames_are_accumulated_in_batches() -> None:
    frames = (4000 + np.random.default_rng(0).integers(-9, 9, (7, 2, 4, 5, 3))).astype(np.uint16)
    dark = DarkFrames()
    for first, last in ((0, 1), (1, 4), (4, 7)):
        dark.add(frames[first:last])
    assert (dark.count, dark.smallest.shape, dark.smallest.dtype) == (
        7,
        frames.shape[1:],
        frames.dtype,
    )
    np.testing.assert_array_equal(dark.mean, frames.mean(axis=0, dtype=np.float64))
    expected = frames.var(axis=0, ddof=1, dtype=np.float64)
    np.testing.assert_allclose(dark.variance, expected, rtol=1e-12)
    together = DarkFrames.of(frames)
    np.testing.assert_array_equal(dark.variance, together.variance)


def floodlit(radiance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    off, lit = capture(CAMERA, radiance)
    merged = CAMERA.merge(lit[None], off.mean(axis=0).astype(np.float32), 8)
    return merged.radiance[0], merged.variance[0]


def test_a_floodlit_image_must_have_light() -> None:
    check_floodlit(*floodlit(np.full((20, 30, 3), 1e-4, np.float32)))
    spot = np.zeros((50, 60, 3), np.float32)
    spot[4, 5] = 0.01  # a few lit pixels don't show in the sum
    check_floodlit(*floodlit(spot))
    check_floodlit(spot, np.zeros_like(spot))


def test_few_dark_frames_and_pictures_of_other_patterns_show_dead_pixels() -> None:
    scene = texture((200, 200, 1))
    off, _ = capture(CAMERA, scene, 2)
    lit = np.stack([CAMERA.expose(scene, 1, (0, index)) for index in range(11)])
    for frames in (off, lit):
        frames[:, :, 8, 9] = 65
    few, many = FrameRange(), FrameRange()
    few.add(lit[:1])
    many.add(lit)
    assert find_defects(DarkFrames.of(off), few, CAMERA).dead == 0  # might be chance
    defects = find_defects(DarkFrames.of(off), many, CAMERA)
    assert np.argwhere(defects.mask).tolist() == [[8, 9]]
    assert defects.dead == 1
