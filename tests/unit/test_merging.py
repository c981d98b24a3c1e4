"""The merge of brackets: equal bits for any batches, threads and memory limits."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rfpipe.errors import CaptureError
from rfpipe.jobs.workers import Resources
from rfpipe.photometry import CameraModel, ExactSensor
from rfpipe.photometry.defects import DefectMap
from rfpipe.provenance import generator
from rfpipe.references.reference_images import DefectMaskingMerge, estimate_references

CAMERA = CameraModel()
IMAGE = (11, 13, 3)


def captured(camera: CameraModel, count: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return brackets from dark to saturated, and a mean all-off bracket with a stuck pixel."""
    light = (10.0 ** generator(4).uniform(-5, 1, (count, *IMAGE))).astype(np.float32)
    frames = np.stack([camera.expose(image, 1, (0, index)) for index, image in enumerate(light)])
    dark = np.zeros(IMAGE, np.float32)
    off = np.mean([camera.expose(dark, 1, (9, index)) for index in range(4)], axis=0)
    frames[:, :, 2, 3], off[:, 2, 3] = camera.white_level, camera.white_level
    return frames, off.astype(np.float32)


@pytest.mark.parametrize("camera", [CAMERA, replace(CAMERA, bayer="GRBG"), ExactSensor()])
def test_reference_images_do_not_depend_on_batches(camera: Any) -> None:
    image = generator(2).uniform(0.2, 1, IMAGE).astype(np.float32)
    off = np.stack([camera.expose(np.zeros_like(image), 1, (9, index)) for index in range(5)])
    on = np.stack([camera.expose(image, 1, (8, index)) for index in range(6)])
    if camera is CAMERA:
        off[:, :, 4, 5] = 3000  # hot
    together = estimate_references(camera, [off], [on])
    apart = estimate_references(
        camera, (off[i : i + 2] for i in range(0, 5, 2)), [on[i : i + 1] for i in range(6)]
    )
    np.testing.assert_array_equal(apart.merge.black, together.merge.black)
    for name in ("floodlit", "floodlit_variance"):
        np.testing.assert_array_equal(getattr(apart, name), getattr(together, name))
    assert together.merge.black_count == apart.merge.black_count == 5
    if camera is CAMERA:
        assert together.merge.defects is not None
        assert apart.merge.defects is not None
        assert np.argwhere(apart.merge.defects.mask).tolist() == [[4, 5]]
        assert (together.floodlit[4, 5] == 0).all()
        unknown = np.isinf(together.floodlit_variance)
        assert np.argwhere(unknown.all(axis=-1)).tolist() == [[4, 5]]
        assert unknown.sum() == 3


def test_defects_are_masked_in_single_images_and_in_batches() -> None:
    frames, off = captured(CAMERA, 4)
    mask = np.zeros(IMAGE[:2], bool)
    mask[0, 0] = mask[2, 3] = mask[5:8, 6:9] = True
    merge = DefectMaskingMerge(CAMERA, off, 4, DefectMap(mask, 1, 1))
    plain = CAMERA.merge(frames, off, 4)
    together = merge(frames, 0)
    np.testing.assert_array_equal(together.radiance[:, ~mask], plain.radiance[:, ~mask])
    np.testing.assert_array_equal(together.variance[:, ~mask], plain.variance[:, ~mask])
    assert (together.radiance[:, mask] == 0).all()
    assert np.isposinf(together.variance[:, mask]).all()
    for index in range(4):
        single = merge(frames[index : index + 1], index)
        np.testing.assert_array_equal(single.radiance[0], together.radiance[index])
        np.testing.assert_array_equal(single.variance[0], together.variance[index])
    assert together.radiance.dtype == together.variance.dtype == np.float32


def test_a_camera_with_no_good_pixel_is_refused() -> None:
    camera = replace(CAMERA, bayer="RGGB")
    off = np.stack([camera.expose(np.zeros((2, 2, 3)), 1, (9, index)) for index in range(8)])
    on = np.stack([camera.expose(np.ones((2, 2, 3)), 1, (8, index)) for index in range(8)])
    off[:, :, 0, 0], on[:, :, 0, 0] = (
        4000,
        4000,
    )  # interpolation of the mosaic spreads it to all four pixels
    with pytest.raises(CaptureError, match=r"all 4 camera pixels.*merge.mask_defects"):
        estimate_references(camera, [off], [on])


def test_workers_keep_the_order_and_limit_results_in_memory(tmp_path: Path) -> None:
    lock = threading.Lock()
    begun: list[int] = []

    def work(first: int, last: int) -> int:
        with lock:
            begun.append(first)
        time.sleep(0.002 * (5 - first % 5))  # later items end earlier
        return first * 100 + last

    pieces = [(index, index + 1) for index in range(20)]
    with Resources(threads=3).workers(1, tmp_path) as workers:
        assert workers.in_flight == 6
        results = workers.results(work, pieces)
        assert next(results) == 1
        assert len(begun) <= 7
        assert list(results) == [100 * first + last for first, last in pieces[1:]]


def test_workers_stop_at_the_first_error_in_order(tmp_path: Path) -> None:
    begun: list[int] = []

    def work(first: int, _last: int) -> int:
        begun.append(first)
        if first in (2, 3):
            raise CaptureError(f"pattern {first}")
        time.sleep(0.005)
        return first

    pieces = [(index, index + 1) for index in range(100)]
    with (
        pytest.raises(CaptureError, match="pattern 2"),
        Resources(threads=2).workers(1, tmp_path) as workers,
    ):
        list(workers.results(work, pieces))
    assert len(begun) < 10


@pytest.mark.parametrize("threads", [1, 2])
def test_matrix_products_take_the_threads_of_the_resources(threads: int) -> None:
    from threadpoolctl import threadpool_info

    def blas_threads() -> list[int]:
        return [pool["num_threads"] for pool in threadpool_info() if pool["user_api"] == "blas"]

    before = blas_threads()
    with Resources(threads=threads).blas_threads():
        assert set(blas_threads()) == {threads}
    assert blas_threads() == before


def test_resources_use_fewer_threads_where_memory_is_short(tmp_path: Path) -> None:
    few = Resources(memory_gib=1.0, threads=4)
    assert few.fitting_count(few.data_bytes // 3, 16) == 3
    assert few.fitting_count(2 * few.data_bytes, 16) == 1
    for size, in_flight in ((1, 8), (few.data_bytes // 4, 4), (few.data_bytes, 1)):
        with few.workers(size, tmp_path) as workers:
            assert workers.in_flight == in_flight
            pieces = list(workers.results(lambda a, b: (a, b), [(1, 2), (2, 3)]))
            assert pieces == [(1, 2), (2, 3)]


def test_the_floodlit_image_has_the_variance_of_a_mean() -> None:
    image = generator(5).uniform(0.2, 1, IMAGE).astype(np.float32)
    off = np.stack([CAMERA.expose(np.zeros_like(image), 1, (9, index)) for index in range(64)])
    on = np.stack([CAMERA.expose(image, 1, (8, index)) for index in range(6)])
    references = estimate_references(CAMERA, [off], [on])
    single_variance = CAMERA.merge(on, references.merge.black, 64).variance
    np.testing.assert_allclose(
        references.floodlit_variance, single_variance.mean(axis=0) / 6, rtol=1e-5
    )
    deviation = np.square(references.floodlit - image) / references.floodlit_variance
    assert deviation.mean() == pytest.approx(1, abs=5 * np.sqrt(2 / image.size))
