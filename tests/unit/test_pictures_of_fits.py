"""Pictures as the fits of near/far and footprint acquisition take them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.model import AdaptiveModel
from rfpipe.methods.footprints.method import FootprintModel
from rfpipe.methods.footprints.pictures import PackedPictures, radiance_unit, split_pictures
from rfpipe.methods.images import Pictures
from rfpipe.methods.near_far.method import NearFarModel
from rfpipe.methods.near_far.pictures import MOST_CELLS, MOST_PIXELS, SplitPictures, fit_cells
from rfpipe.transport.wavelet import Cells

SHAPE = (5, 7)


def some_pictures(count: int, rays: int, *, masked: int) -> Pictures:
    """Draw pictures of two channels; one pixel is masked."""
    random = np.random.default_rng(1)
    lit = random.random((count, rays)) < 0.5
    lit[0] = True
    radiance = random.lognormal(0, 2, (count, 2, rays)).astype(np.float32)
    variance = (1e-4 * radiance).astype(np.float32)
    radiance[..., masked], variance[..., masked] = 0, np.inf
    return Pictures(lit, radiance, variance)


@pytest.mark.parametrize("side", [1, 3])
def test_lit_and_dark_pixels_of_cells_are_summed_without_masked_ones(side: int) -> None:
    pictures, cells = some_pictures(4, 35, masked=8), Cells(SHAPE, side)
    floodlit = pictures.select(slice(0, 1))
    split = SplitPictures.of(cells, floodlit, pictures.probes)
    known = np.arange(35) != 8
    for index, (lit, radiance) in enumerate(
        zip(pictures.probes.lit, pictures.probes.radiance, strict=True)
    ):
        for cell in range(cells.count):
            inside = cells.of_ray == cell
            dark, bright = inside & ~lit & known, inside & lit & known
            np.testing.assert_allclose(
                split.dark[index, :, cell], radiance[:, dark].sum(axis=1), rtol=1e-5
            )
            excess = (radiance - floodlit.floodlit)[:, bright].sum(axis=1)
            np.testing.assert_allclose(split.excess[index, :, cell], excess, rtol=1e-4, atol=1e-4)
            assert np.isfinite(split.lit_variance[index, :, cell]).all()
            assert (split.dark_variance[index, :, cell] > 0).all() == dark.any()
        assert split.dark_count[index] == np.count_nonzero(~lit & known)
    grey = split.grey()
    np.testing.assert_allclose(grey.light[:, 0], split.light.sum(axis=1), rtol=1e-6)


@pytest.mark.parametrize(("shape", "side"), [((310, 350), 1), ((768, 1024), 5), ((1080, 1920), 8)])
def test_cells_of_the_fit_are_limited_in_number(shape: tuple[int, int], side: int) -> None:
    cells = fit_cells(shape)
    assert cells.side == side
    assert cells.count <= (MOST_PIXELS if side == 1 else MOST_CELLS)


def test_packed_pictures_are_rounded_less_than_the_error_of_any_model() -> None:
    pictures = some_pictures(6, 35, masked=8)
    unit = radiance_unit(pictures.select(slice(0, 1)))
    packed = [
        PackedPictures.of(pictures.select(part), unit) for part in (slice(0, 1), slice(1, None))
    ]
    (view,) = split_pictures(packed, slice(None), RayDomain(SHAPE))
    known = np.arange(35) != 8
    np.testing.assert_array_equal(view.patterns.T, pictures.lit)
    np.testing.assert_array_equal(view.known, known)
    grey = pictures.radiance.sum(axis=1).T / unit
    np.testing.assert_allclose(view.radiance[known], grey[known], rtol=5e-4)
    variance = pictures.variance.sum(axis=1).T / unit**2
    np.testing.assert_allclose(view.variance[known], variance[known], rtol=0.07)
    assert np.isinf(view.variance[8]).all()
    some = np.array([2, 8, 20])
    for one, all_pixels in ((view.at(some), view), (view.at(some), view.at(None))):
        np.testing.assert_array_equal(one.radiance, all_pixels.radiance[some])
        np.testing.assert_array_equal(one.variance, all_pixels.variance[some])
    np.testing.assert_array_equal(view.first()[0], view.radiance[:, 0])


def near_far_model(floodlit: Pictures) -> NearFarModel:
    return NearFarModel.of(floodlit.with_masked_filled(SHAPE), SHAPE, None)


def footprint_model(floodlit: Pictures) -> FootprintModel:
    rays = RayDomain(SHAPE)
    return FootprintModel.of(floodlit, rays, rays, limit=0, prior=None)


@pytest.mark.parametrize("make", [near_far_model, footprint_model])
def test_prepared_pictures_are_known_as_they_were_taken(
    make: Callable[[Pictures], AdaptiveModel],
) -> None:
    pictures = some_pictures(6, 35, masked=8)
    model = make(pictures.select(slice(0, 1)))
    taken = model.taken(model.prepared(pictures.probes), pictures.lit[1:])
    assert taken is not None
    np.testing.assert_array_equal(taken.lit, pictures.lit[1:])
    np.testing.assert_array_equal(np.isinf(taken.variance), np.isinf(pictures.variance[1:]))
    np.testing.assert_allclose(taken.radiance, pictures.radiance[1:], rtol=1e-3, atol=1e-4)
    known = np.arange(35) != 8
    # the sum of two variances is rounded to float32
    rounding = 1e-6 * pictures.variance[0][:, known].max()
    np.testing.assert_allclose(
        taken.variance[..., known], pictures.variance[1:, :, known], rtol=0.07, atol=rounding
    )


def test_sums_over_larger_cells_do_not_tell_the_pictures() -> None:
    shape = (512, 512)
    floodlit = Pictures(*(np.ones((1, *size), kind) for size, kind in (
        ((512**2,), np.bool_), ((1, 512**2), np.float32), ((1, 512**2), np.float32)
    )))  # fmt: skip
    model = NearFarModel.of(floodlit, shape, None)
    assert model.taken(model.prepared(floodlit), floodlit.lit) is None


def test_packed_pictures_of_several_views_are_split_by_the_view_that_they_light() -> None:
    views = RayDomain((2, 5, 7))
    pictures = some_pictures(5, 70, masked=8)
    for index, view in ((1, 0), (2, 1), (3, 0), (4, 1)):
        pictures.lit[index].reshape(2, -1)[1 - view] = False
    pictures.lit.reshape(5, 2, -1)[[1, 2], [0, 1]] = True
    packed = [PackedPictures.of(pictures, 1.0)]
    for view, part in enumerate(split_pictures(packed, slice(0, 1), views)):
        numbers = [1 + view, 3 + view]
        np.testing.assert_array_equal(
            part.patterns.T, pictures.lit.reshape(5, 2, -1)[numbers, view]
        )
        expected = pictures.radiance[numbers, 0].T
        np.testing.assert_allclose(part.radiance, expected, rtol=5e-4)
