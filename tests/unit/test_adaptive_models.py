"""Properties of all models that the adaptive loop fits."""

from __future__ import annotations

import numpy as np
import pytest
from tests.rigs.known_matrix import scene_matrices

from rfpipe.blocks import RayDomain
from rfpipe.methods.adaptive.loop import AdaptiveMethod
from rfpipe.methods.adaptive.model import AdaptiveModel
from rfpipe.methods.base import ErrorOptions
from rfpipe.methods.footprints.method import Footprints
from rfpipe.methods.images import Pictures, relight_white
from rfpipe.methods.near_far.method import NearFar
from rfpipe.methods.residual.model import CameraCells

SHAPE = (16, 18)
RAYS = RayDomain(SHAPE)
MATRIX = scene_matrices("IV", SHAPE, 1)
METHODS = pytest.mark.parametrize("method", [NearFar(), Footprints()], ids=lambda it: it.name)


def pictures_of(lit: np.ndarray) -> Pictures:
    """Return exact pictures of patterns (P, *shape)."""
    lit = lit.reshape(len(lit), -1)
    radiance = np.einsum("cmn,pn->pcm", MATRIX, lit).astype(np.float32)
    return Pictures(lit, radiance, np.full_like(radiance, 1e-8))


WHITE = pictures_of(np.ones((1, *SHAPE), np.bool_))


def first_model(method: AdaptiveMethod) -> AdaptiveModel:
    return method.first_model(method.start(RAYS, RAYS, 1, ErrorOptions()), WHITE)


def fitted(method: AdaptiveMethod) -> AdaptiveModel:
    """Return the model fitted to the pictures of one round."""
    model = first_model(method)
    count = method.rounds(RAYS)["model"][0]
    patterns = model.next_patterns(1, count)
    pictures = pictures_of(np.concatenate([np.ones((1, *SHAPE), np.bool_), patterns]))
    return model.fit([model.prepared(pictures)])


@METHODS
def test_before_a_fit_the_model_relights_the_floodlit_image(method: AdaptiveMethod) -> None:
    model = first_model(method)
    assert model.is_suitable
    assert not model.counts
    relit = relight_white(model.transport([]), WHITE.lit)
    np.testing.assert_allclose(relit[0], WHITE.floodlit, rtol=1e-5)


@METHODS
def test_a_fit_reduces_the_error_on_other_patterns(method: AdaptiveMethod) -> None:
    test_pictures = pictures_of(first_model(method).next_patterns(99, 4))
    errors = [
        np.linalg.norm(
            relight_white(model.transport([]), test_pictures.lit) - test_pictures.radiance
        )
        for model in (first_model(method), fitted(method))
    ]
    assert errors[1] < 0.5 * errors[0]


@METHODS
def test_patterns_depend_on_the_key_and_the_index_alone(method: AdaptiveMethod) -> None:
    model = fitted(method)
    patterns = model.next_patterns(2, 6)
    assert patterns.shape == (6, *SHAPE)
    np.testing.assert_array_equal(model.next_patterns(2, 3), patterns[:3])
    assert (model.next_patterns(3, 6) != patterns).any(axis=(1, 2)).all()


@METHODS
def test_a_residual_is_added_to_the_fit(method: AdaptiveMethod) -> None:
    model, light = fitted(method), WHITE.lit
    part = first_model(method).transport([])
    without_residual = model.transport([])
    with_residual = model.transport([], [part])
    assert len(with_residual.parts) == len(without_residual.parts) + 1
    assert np.isfinite(relight_white(with_residual, light)).all()


@METHODS
def test_pixels_without_direct_light_and_projector_cells_fit_the_rig(
    method: AdaptiveMethod,
) -> None:
    model = fitted(method)
    lit = np.zeros((2, RAYS.size), np.bool_)
    lit[1] = True
    dark = model.dark_pixels(lit)
    assert dark[0].all()
    assert not dark[1].any()
    camera = CameraCells.of_pictures(SHAPE, WHITE)
    projector = model.projector_cells(camera, model.transport([]))
    assert projector.factor.shape == (1, RAYS.size)
    assert projector.is_coaxial is method.needs_coaxial_rig
