"""Properties of photometry for any light, exposures and shapes."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rfpipe.photometry import CameraModel
from rfpipe.photometry.normalize import MAXIMUM_GAIN, apply, level_gain

shapes = st.tuples(st.integers(1, 4), st.integers(1, 5), st.sampled_from([1, 3]))
light = st.floats(0, 1e4, width=32)
cameras = st.builds(
    CameraModel,
    exposures=st.sets(st.sampled_from([1e-3, 0.01, 0.1, 1.0, 10.0]), min_size=1).map(
        lambda times: tuple(sorted(times))
    ),
    read_noise_electrons=st.sampled_from([0.0, 2.0, 30.0]),
    dark_current_electrons=st.sampled_from([0.0, 50.0]),
    black_level_counts=st.sampled_from([0, 30, 200]),
    bits=st.sampled_from([8, 12, 16]),
    psf_sigma=st.sampled_from([0.0, 0.8]),
    vignetting=st.sampled_from([0.0, 0.5]),
    flare=st.sampled_from([0.0, 0.1]),
    response_gamma=st.sampled_from([0.6, 1.0, 2.2]),
)


@given(cameras, st.data())
def test_any_light_gives_counts_in_range_and_a_finite_merge(
    camera: CameraModel, data: st.DataObject
) -> None:
    shape = data.draw(shapes)
    image = data.draw(hnp.arrays(np.float32, shape, elements=light))
    frames = camera.expose(image, 0, (1, 2))
    assert frames.dtype == np.uint16
    assert frames.shape == camera.frame_shape(shape[:-1], shape[-1])
    assert frames.max() <= camera.white_level
    black = camera.expose(np.zeros(shape), 0, (9, 9)).astype(np.float32)
    merged = camera.merge(frames[None], black)
    assert np.isfinite(merged.radiance).all()
    assert np.isfinite(merged.variance).all()
    assert (merged.variance > 0).all()
    assert 0 <= merged.saturated <= image.size


@given(cameras, st.data())
def test_any_counts_merge_to_finite_radiance(camera: CameraModel, data: st.DataObject) -> None:
    shape = camera.frame_shape(data.draw(shapes)[:2], 1)
    counts = st.integers(0, camera.white_level)
    frames = data.draw(hnp.arrays(np.uint16, (2, *shape), elements=counts))
    black = data.draw(hnp.arrays(np.uint16, shape, elements=counts)).astype(np.float32)
    merged = camera.merge(frames, black, 3)
    assert np.isfinite(merged.radiance).all()
    assert np.isfinite(merged.variance).all()
    assert (merged.variance > 0).all()


@given(
    hnp.arrays(np.float32, (2, 4, 5, 3), elements=st.floats(0, 10, width=32)),
    st.sampled_from(["RGGB", "GBRG"]),
)
def test_a_mosaic_merges_each_view_separately(images: np.ndarray, pattern: str) -> None:
    camera = CameraModel(bayer=pattern)
    black = camera.expose(np.zeros_like(images), 0, (9, 9)).astype(np.float32)
    frames = camera.expose(images, 0, (0, 0))
    together = camera.merge(frames[None], black).radiance[0]
    for view in range(2):
        single = camera.merge(frames[None, :, view], black[:, view]).radiance[0]
        np.testing.assert_array_equal(together[view], single)


values = st.floats(-10, 10, width=32)
variances = st.floats(0, 10, width=32)


@given(
    hnp.arrays(np.float32, (3, 2, 4, 3), elements=values),
    hnp.arrays(np.float32, (2, 4, 3), elements=values),
    hnp.arrays(np.float32, (2, 4, 3), elements=variances),
    st.sampled_from(["per_channel", "total_energy"]),
)
def test_normalized_images_are_finite_bounded_and_add_up_on_covered_pixels(
    images: np.ndarray, floodlit: np.ndarray, variance: np.ndarray, mode: str
) -> None:
    total = images.sum(axis=0, dtype=np.float64)
    normalization = level_gain(floodlit, total, variance, mode, True, 3.0, 0 * variance)
    corrected, spread = apply(images, np.abs(images), normalization)
    assert np.isfinite(corrected).all()
    assert np.isfinite(spread).all()
    assert (spread >= 0).all()
    assert normalization.gain.min() >= 0
    assert normalization.gain.max() <= MAXIMUM_GAIN * (1 + 1e-6)
    covered = normalization.covered
    expected = floodlit if mode == "per_channel" else np.maximum(floodlit, 0)
    scale = np.abs(images).sum(axis=(0, -1), keepdims=True)[0] * MAXIMUM_GAIN
    error = np.abs(corrected.sum(axis=0, dtype=np.float64) - expected) / np.maximum(scale, 1e-30)
    assert (error[covered] < 1e-5).all()
    np.testing.assert_array_equal(corrected[:, ~covered], images[:, ~covered])
