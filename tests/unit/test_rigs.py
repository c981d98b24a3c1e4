"""Rigs of known light transport, and the dot test."""

import json
import os
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, aslinearoperator

import rfpipe
from rfpipe.errors import CaptureError, InputError
from rfpipe.photometry import CameraModel
from rfpipe.rigs import OperatorRig
from rfpipe.testing import dot_test

CAMERA_SHAPE, PROJECTOR_SHAPE = (4, 5), (3, 7)
MATRICES = np.random.default_rng(0).random((3, 20, 21))
PATTERNS = np.random.default_rng(1).random((5, *PROJECTOR_SHAPE)).astype(np.float32)
KEYS = [(1, index) for index in range(5)]


class Callable:
    """An operator on patterns, with the interface of a scene."""

    channels = 3
    shape = (3, 7)

    def __init__(self, images: Any = None) -> None:
        self._images = images

    def apply(self, patterns: np.ndarray) -> np.ndarray:
        if self._images is not None:
            return np.asarray(self._images)
        return np.einsum("cmn,bn->bmc", MATRICES[:, :20], patterns)

    def describe(self) -> dict[str, Any]:
        return {"what": "a test's matrices"}


def rig_of(matrix: Any, **settings: Any) -> OperatorRig:
    return OperatorRig(matrix, CAMERA_SHAPE, PROJECTOR_SHAPE, **settings)


@pytest.mark.parametrize(
    "matrix",
    [
        MATRICES,
        list(MATRICES.astype(np.float32)),
        [sparse.coo_matrix(part) for part in MATRICES],
        [aslinearoperator(part) for part in MATRICES],
        Callable(),
    ],
    ids=["dense", "list", "sparse", "linear", "apply"],
)
def test_exact_frames_are_the_matrix_product(matrix: Any) -> None:
    rig = rig_of(matrix)
    frames = rig.capture(PATTERNS, KEYS)
    assert (rig.channels, frames.shape, frames.dtype) == (3, (5, 1, 4, 5, 3), np.float32)
    expected = np.einsum("cmn,bn->bmc", MATRICES, PATTERNS.reshape(5, -1))
    np.testing.assert_allclose(frames.reshape(expected.shape), expected, rtol=1e-6)


@pytest.mark.parametrize("size", [1, 37, 130])
@pytest.mark.parametrize("kind", ["dense", "sparse"])
def test_a_patterns_bytes_do_not_depend_on_its_batch(size: int, kind: str) -> None:
    matrix = np.random.default_rng(0).random((size, size))
    rig = OperatorRig(
        sparse.csr_array(matrix) if kind == "sparse" else matrix, (1, size), (1, size)
    )
    patterns = np.random.default_rng(1).random((37, 1, size)).astype(np.float32)
    keys = [(1, index) for index in range(37)]
    frames = rig.capture(patterns, keys)
    for first, last in ((0, 1), (3, 20), (36, 37), (5, 37)):
        part = rig.capture(patterns[first:last], keys[first:last])
        np.testing.assert_array_equal(part, frames[first:last])


def test_threads_draw_the_same_noise() -> None:
    single = rig_of(MATRICES, noise=CameraModel(), seed=3).capture(PATTERNS, KEYS)
    together = rig_of(MATRICES, noise=CameraModel(), seed=3, threads=3).capture(PATTERNS, KEYS)
    np.testing.assert_array_equal(together, single)
    described = rig_of(MATRICES).describe()
    assert rig_of(MATRICES, threads=3).describe() == described  # it captures the same pictures


@pytest.mark.parametrize("wrap", [np.asarray, sparse.csr_array, lambda matrix: [matrix] * 3])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_impossible_entries_are_named(wrap: Any, value: float) -> None:
    matrix = MATRICES[0].copy()
    matrix[7, 8] = value
    with pytest.raises(InputError, match=rf"channel 0 is {value} at row 7, column 8"):
        rig_of(wrap(matrix))


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.ones((21, 20)), r"channel 0 has the shape \(21, 20\).*\(20 camera rays, 21 projector"),
        (MATRICES.astype(complex), "dtype complex128; expected real numbers"),
        (sparse.csr_array(MATRICES[0].astype(complex)), "dtype complex128; expected real numbers"),
        (aslinearoperator(MATRICES[0].astype(complex)), "dtype complex128; expected real"),
        ([], "no channels"),
        (MATRICES[:2], "2 channels; expected 1 or 3"),
        (np.moveaxis(MATRICES, 0, -1), r"shape \(21, 3\).*channels first"),
    ],
)
def test_invalid_matrices_are_refused(matrix: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        rig_of(matrix)


def test_an_operator_with_a_wrong_result_raises_an_error() -> None:
    with pytest.raises(CaptureError, match=r"shape \(5, 19, 3\) for patterns \(1, 0\) to \(1, 4\)"):
        rig_of(Callable(np.ones((5, 19, 3)))).capture(PATTERNS, KEYS)
    images = np.ones((5, 20, 3))
    images[3, 6, 1] = np.nan
    with pytest.raises(CaptureError, match=r"pattern \(1, 3\) holds nan at pixel \(1, 1, 1\)"):
        rig_of(Callable(images)).capture(PATTERNS, KEYS)
    negative = aslinearoperator(-MATRICES[0])
    with pytest.raises(CaptureError, match=r"pattern \(1, 0\) holds -.* not negative"):
        rig_of(negative).capture(PATTERNS, KEYS)


def test_descriptions_of_different_rigs_differ() -> None:
    changed = MATRICES.copy()
    changed[2, 3, 4] *= 1.001
    rigs = [rig_of(matrix) for matrix in (MATRICES, changed)]
    rigs += [rig_of([sparse.csr_array(part) for part in MATRICES])]
    rigs += [rig_of([aslinearoperator(part) for part in matrix]) for matrix in (MATRICES, changed)]
    rigs += [rig_of(MATRICES, seed=1), rig_of(MATRICES, noise=CameraModel())]
    described = [json.dumps(rig.describe(), sort_keys=True) for rig in rigs]
    assert len(set(described)) == len(described)
    assert described[0] == json.dumps(rig_of(list(MATRICES)).describe(), sort_keys=True)


@pytest.mark.parametrize(
    ("matvec", "rmatvec", "message"),
    [
        (lambda x: MATRICES[0] @ x, lambda y: MATRICES[1].T @ y, "relative difference"),
        (lambda _: np.full(20, np.nan), lambda _: np.ones(21), "nan"),
    ],
)
def test_dot_test_finds_a_wrong_transpose(matvec: Any, rmatvec: Any, message: str) -> None:
    wrong = LinearOperator((20, 21), matvec=matvec, rmatvec=rmatvec, dtype=float)
    with pytest.raises(AssertionError, match=message):
        dot_test(wrong)


THREADS_SCRIPT = """
import hashlib
import numpy as np
from rfpipe.rigs import OperatorRig
random = np.random.default_rng(0)
rig = OperatorRig(random.random((500, 777)), (1, 500), (1, 777))
patterns = random.random((19, 1, 777)).astype(np.float32)
frames = rig.capture(patterns, [(0, index) for index in range(19)])
print(hashlib.sha256(frames.tobytes()).hexdigest())
"""


def test_frames_do_not_depend_on_the_number_of_threads() -> None:
    digests = set()
    for threads in ("1", "2", "3"):
        environment = {**os.environ, "OPENBLAS_NUM_THREADS": threads}
        script = [sys.executable, "-c", THREADS_SCRIPT]
        digests.add(subprocess.check_output(script, env=environment, timeout=60))
    assert len(digests) == 1


def test_the_error_for_a_matrix_explains_how_to_make_a_rig() -> None:
    with pytest.raises(InputError, match=r"ndarray can't capture; .*OperatorRig\(matrix"):
        rfpipe.acquire(np.eye(4))  # type: ignore[arg-type]
