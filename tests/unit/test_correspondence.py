"""Correspondence of camera and projector pixels: confidence, mask, and noise."""

from pathlib import Path

import numpy as np
import pytest

import rfpipe
from rfpipe.errors import InputError
from rfpipe.rigs import SimulatedRig
from rfpipe.scenes import planes_scene, reference_scene
from rfpipe.scenes.geometries import GEOMETRIES
from rfpipe.scenes.pinholes import Pinhole, first_hits
from rfpipe.transport import Transport, open_transport, save_transport
from rfpipe.transport.correspondence import _agreement, _probability
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.regrouping import crop
from rfpipe.transport.sum import SumTransport

CAMERA, PROJECTOR = (20, 24), (26, 30)
DARK = np.s_[:, 18:]
NOISE = 0.05


@pytest.fixture(scope="module")
def noisy_transport() -> tuple[DenseTransport, np.ndarray, np.ndarray]:
    """Return a noisy transport, true positions, and a mask of pixels at random positions."""
    rng = np.random.default_rng(1)
    row, column = np.indices(CAMERA)
    # rotated by 90 degrees, with 0.9 rays per pixel
    places = np.stack([2.2 + 0.9 * column, 2.7 + 0.9 * row], axis=-1)
    wrong = rng.uniform(size=CAMERA) < 0.08
    displayed = np.where(wrong[..., None], rng.uniform(2, 24, (*CAMERA, 2)), places)
    weights = [
        np.maximum(0, 1 - np.abs(np.arange(length) + 0.5 - displayed[..., axis, None]))
        for axis, length in enumerate(PROJECTOR)
    ]
    direct = weights[0][..., :, None] * weights[1][..., None, :]
    direct[DARK] = 0
    entries = direct.reshape(row.size, -1)
    # smooth indirect light, a fifth of the direct light
    entries[: row.size] += 0.2 / entries.shape[1] * (entries.sum(axis=1, keepdims=True) > 0)
    entries += rng.normal(0, NOISE / entries.shape[1] ** 0.5, entries.shape)
    arrays = {"matrix": entries[None].astype(np.float32)}
    return DenseTransport(CAMERA, PROJECTOR, 1, [], arrays), places, wrong


def test_confidence_separates_right_places_from_wrong_ones(noisy_transport) -> None:
    transport, truth, wrong = noisy_transport
    result = transport.correspondence()
    lit = np.ones(CAMERA, bool)
    lit[DARK] = False
    off = np.linalg.norm(result.places - truth, axis=-1)
    right = off <= 1
    assert right[lit & ~wrong].mean() > 0.99
    assert not right[lit & wrong].any()
    assert (result.confidence[lit & right] > 0.9).mean() > 0.95
    assert (result.confidence[lit & ~right] < 0.5).all()
    assert result.mask[lit & right].mean() > 0.97
    assert ((result.confidence >= 0) & (result.confidence <= 1)).all()
    np.testing.assert_array_equal(result.mask, result.confidence >= 0.5)


@pytest.mark.parametrize("deviation", [NOISE, 0.1])
def test_dark_pixels_are_outside_the_mask(noisy_transport, deviation: float) -> None:
    transport, _, _ = noisy_transport
    known = DenseTransport(CAMERA, PROJECTOR, 1, [], transport._content)
    known.noise = np.full(CAMERA, deviation)
    result = known.correspondence()
    floodlit = known.relight(np.ones(PROJECTOR))[..., 0]
    assert (result.confidence[floodlit <= 8 * deviation] == 0).all()
    assert not result.mask[DARK].any()
    assert result.mask[:, :18].mean() > 0.85


def test_pixels_with_infinite_noise_are_outside_the_mask(noisy_transport) -> None:
    transport, _, wrong = noisy_transport
    known = DenseTransport(CAMERA, PROJECTOR, 1, [], transport._content)
    known.noise = np.where(np.arange(CAMERA[1]) < 9, np.inf, NOISE) * np.ones((CAMERA[0], 1))
    mask = known.correspondence().mask
    assert not mask[:, :9].any()
    assert mask[:, 11:18][~wrong[:, 11:18]].mean() > 0.9


@pytest.mark.parametrize(
    ("geometry", "position"), [("wedge", (0.6, 0.1, 0.2)), ("corner", (0.7, -0.3, 0.2))]
)
@pytest.mark.slow
def test_confidence_does_not_exceed_the_fraction_of_right_places(geometry, position) -> None:
    lamp = Pinhole((28, 34), position, (0.1, 0.0, 3.0), width=0.8)
    surfaces = ("texture", "white", "texture")[: len(GEOMETRIES[geometry])]
    scene = planes_scene(geometry, surfaces, (24, 30), projector=lamp, channels=1)
    dim = rfpipe.CameraModel(electrons_per_radiance=3000)
    rig = rfpipe.OperatorRig(scene, (24, 30), lamp.shape, dim, seed=1)
    result = rfpipe.acquire(rig, "brute_force", progress=False).transport.correspondence()
    truth = lamp.project(first_hits(Pinhole((24, 30)), GEOMETRIES[geometry]).positions)
    right = np.linalg.norm(result.places - truth.reshape(24, 30, 2), axis=-1) <= 1
    assert result.mask.sum() > 50
    for lower, upper in ((0.5, 0.9), (0.9, 1.1)):
        in_range = (result.confidence >= lower) & (result.confidence < upper)
        # three standard deviations of the fraction of correct positions
        spread = 3 * 0.5 / np.sqrt(in_range.sum())
        assert right[in_range].mean() > result.confidence[in_range].mean() - spread


def test_agreement_is_high_on_affine_places_and_low_at_outliers() -> None:
    row, column = np.indices((9, 11)).astype(float)
    places = np.stack([3 * row - column, 0.2 * row + 2 * column], axis=-1)[None]
    lit = np.ones((1, 9, 11), bool)
    np.testing.assert_allclose(_agreement(places, lit)[0, 4, 5], 20.5 / 21)
    # a corner has three lines and no pair of opposite neighbours
    np.testing.assert_allclose(_agreement(places, lit)[0, 0, 0], 3.5 / 4)
    places[0, 4, 5] += 5
    agreement = _agreement(places, lit)[0]
    np.testing.assert_allclose(agreement[4, 5], 0.5 / 21)
    # one pair and one line contain the outlier
    np.testing.assert_allclose(agreement[4, 4], 18.5 / 21)
    lit[0, :, 6:] = False
    assert _agreement(places, lit)[0, 2, 5] < agreement[2, 5]


def test_agreement_does_not_cross_views() -> None:
    row, column = np.indices((6, 6)).astype(float)
    view = np.stack([row, column], axis=-1)
    agreement = _agreement(np.stack([view, view + 40]), np.ones((2, 6, 6), bool))
    np.testing.assert_allclose(agreement[0], agreement[1])
    assert agreement.min() > 0.7


def test_probability_follows_the_equation() -> None:
    agreement, share = np.array([1.0, 0.5, 0.5]), np.array([1.0, 1.0, 0.5])
    odds = np.exp(2) * np.array([1, 0.5**3, 0.5**3 * 0.5**4])
    actual = _probability(agreement, share, (2.0, 3.0, 4.0))
    np.testing.assert_allclose(actual, odds / (1 + odds))


def test_noise_is_stored_with_the_transport(noisy_transport, tmp_path: Path) -> None:
    rig = SimulatedRig(reference_scene("IV", (12, 14), channels=1))
    acquired = rfpipe.acquire(rig, tolerance=1e-2, progress=False).transport
    doubled = SumTransport([acquired, acquired], acquired.level_rows)
    transports: list[Transport] = [noisy_transport[0].with_content([], noisy_transport[0]._content)]
    for number, transport in enumerate([*transports, acquired, doubled]):
        path = tmp_path / f"{number}.zarr"
        light = transport.relight(np.ones(transport.projector_shape))
        save_transport(transport, path)
        assert open_transport(path).noise is None
        transport.noise = np.random.default_rng(1).uniform(0, 1, transport.camera_shape)
        save_transport(transport, path)
        opened = open_transport(path)
        np.testing.assert_array_equal(opened.noise, transport.noise)
        assert opened.noise.dtype == np.float32
        np.testing.assert_allclose(opened.relight(np.ones(opened.projector_shape)), light)
        copy = tmp_path / f"{number} copy.zarr"
        save_transport(opened, copy)
        np.testing.assert_array_equal(open_transport(copy).noise, transport.noise)


def test_crop_selects_the_noise_of_its_rays(noisy_transport) -> None:
    transport = noisy_transport[0].with_content([], noisy_transport[0]._content)
    transport.noise = np.arange(480).reshape(CAMERA)
    assert transport.with_content([], transport._content).noise is not None
    np.testing.assert_array_equal(crop(transport, np.s_[2:5, 3:9]).noise, transport.noise[2:5, 3:9])
    assert crop(transport, np.s_[2:5, 3:9]).correspondence().mask.shape == (3, 6)
    assert transport.T.noise is None
    transport.noise = None
    assert crop(transport, np.s_[2:5, 3:9]).noise is None


@pytest.mark.parametrize(
    ("noise", "match"),
    [
        (np.ones(480), r"shape \(480,\); expected .* \(20, 24\)"),
        (np.ones((24, 20)), "shape"),
        (np.full(CAMERA, np.nan), "NaN or negative"),
        (np.full(CAMERA, -1.0), "NaN or negative"),
    ],
)
def test_invalid_noise_is_rejected(noisy_transport, noise, match: str) -> None:
    with pytest.raises(InputError, match=match):
        noisy_transport[0].noise = noise
