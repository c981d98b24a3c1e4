"""Fit of the indirect light: regularised least squares over all pictures.

The pictures of the patterns p are ``c = D p + z + noise`` with the indirect light

    z = diag(f) L S J,    J = R^T diag(g) p

Row i has the pictures of camera ray i. The weights in D are marginalised
(`rfpipe.methods.footprints.weights`), so that each camera ray has a precision Lambda_i, and every
ray takes part, lit or dark. S minimises

    sum_i (c_i - z_i)^T Lambda_i (c_i - z_i) + sum (core parts / sigma)^2

by conjugate gradients in the unknowns *core parts* / sigma, where the core parts are the symmetric
and antisymmetric parts of S (`rfpipe.methods.footprints.functions`). The deviations sigma are
learned from the fitted core parts (`rfpipe.methods.smooth_light`). Then the *gains*, factors of g
and of f with prior mean 1, are fitted with S fixed: one for each projector ray and camera ray.

==========  ============================  ===============  =========================================
symbol      name in the code              shape            meaning and unit
==========  ============================  ===============  =========================================
``p``       `ViewPictures.patterns`       (N, P) per view  patterns, 0 to 1
``c``       `FitData.radiance`            (M, P)           pictures, radiance
``z``       `CoreOperator.forward`        (M, P)           indirect light in the pictures, radiance
``Lambda``  `FitData.precisions`          (P, P) per ray   precisions of the rows of c, by their
                                                           factors, see `MarginalPrecision`
``f``       `IndirectLight.f`             (M,)             scale factors with gains, radiance
``g``       `IndirectLight.g`             (N,)             scale factors with gains, radiance
``L``       `IndirectBasis.L`             (M, n)           functions over camera rays, sparse
``R``       `IndirectBasis.R`             (N, n)           functions over projector rays, sparse
``S``       `IndirectLight.core_matrix`   (n, n)           cores, sparse, inverse radiance
core parts  `IndirectLight.core_parts`    (part_count,)    the unknowns of S, inverse radiance
``sigma``   `deviations`                  (part_count,)    their prior standard deviations
``J``       `CoreOperator.pattern_light`  (n, P)           light of the patterns on the functions
``gamma``   `projector_gain`              (N,)             gains of projector rays, no unit
``tau``     `spread`                      (N,)             their prior standard deviations
==========  ============================  ===============  =========================================

With several projector views, P counts the pictures of all views, one view after the other, and p is
block-diagonal. A fit may be restricted to some of the camera rays; then M is their number.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from rfpipe.array_types import Float, Index
from rfpipe.methods.footprints.candidates import Candidates
from rfpipe.methods.footprints.functions import IndirectBasis
from rfpipe.methods.footprints.pictures import IndirectPictures, ViewArrays, ViewPictures
from rfpipe.methods.footprints.weights import MarginalPrecision, marginal_precision
from rfpipe.methods.least_squares import conjugate_gradients
from rfpipe.methods.smooth_light import learned_deviations
from rfpipe.steps import step

if TYPE_CHECKING:
    from scipy.sparse import csr_array


class Accuracy(NamedTuple):
    """Tolerance of `conjugate_gradients`, and its largest number of iterations."""

    tolerance: float
    iterations: int


ROUGH, GOOD, BEST = Accuracy(1e-2, 40), Accuracy(1e-3, 120), Accuracy(3e-4, 200)

_GAIN_ACCURACY = Accuracy(1e-2, 25)
_LEAST_GAIN, _LARGEST_GAIN = 0.2, 4.0
# Prior standard deviations of gains: of projector rays that the camera sees, of those that it does
# not see, and of camera rays.
_VISIBLE_SPREAD, _HIDDEN_SPREAD, _CAMERA_SPREAD = 0.05, 0.3, 0.1


@dataclass(frozen=True)
class IndirectLight:
    """Indirect light ``diag(f) L S R^T diag(g)`` of one channel.

    Attributes
    ----------
    basis : IndirectBasis
        L, R and the pairs of functions.
    camera_factor : ndarray of float32, shape (camera rays,)
    projector_factor : ndarray of float32, shape (projector rays,)
        Scale factors without gains, see `rfpipe.methods.footprints.functions`.
    camera_gain : ndarray of float32, shape (camera rays,)
    projector_gain : ndarray of float32, shape (projector rays,)
        1 where the pictures do not determine them.
    core_parts : ndarray of float32, shape (basis.part_count,)
        Symmetric parts of S, then antisymmetric parts.
    """

    basis: IndirectBasis
    camera_factor: Float
    projector_factor: Float
    camera_gain: Float
    projector_gain: Float
    core_parts: Float

    @property
    def f(self) -> Float:
        """Scale factors of the camera rays, with gains, (camera rays,)."""
        return self.camera_factor * self.camera_gain

    @property
    def g(self) -> Float:
        """Scale factors of the projector rays, with gains, (projector rays,)."""
        return self.projector_factor * self.projector_gain

    def core_matrix(self) -> csr_array[np.float32]:
        """Return S, (n, n)."""
        return self.basis.core_matrix(self.core_parts)

    def learned_deviations(self) -> Float:
        """Return the root mean square of the core parts of each group, (part_count,)."""
        return learned_deviations(self.basis.part_groups, self.core_parts)

    def in_pictures(self, pictures: Sequence[ViewPictures]) -> Iterator[IndirectPictures]:
        """Compute the indirect light in the pictures of each projector view, one by one.

        Only the patterns are used.
        """
        f, views = self.f, zip(self.basis.R_by_view, pictures, strict=True)
        factors = self.g.reshape(len(pictures), -1, 1)
        for (R, view), factor in zip(views, factors, strict=True):
            light = np.ascontiguousarray(R.T @ (view.patterns * factor), np.float32)
            operator = CoreOperator(self.basis, self.basis.L, f, light)
            yield IndirectPictures(operator.L, f, operator.exchanged(self.core_parts))


@dataclass(frozen=True)
class FitData:
    """Pictures of the camera rays that take part in a fit.

    Attributes
    ----------
    pictures : tuple of ViewArrays
        One for each projector view.
    precisions : tuple of MarginalPrecision
        One for each projector view.
    camera_rays : ndarray of int64, optional
        Numbers of the M rays in the fit, ascending; None for all.
    """

    pictures: tuple[ViewArrays, ...]
    precisions: tuple[MarginalPrecision, ...]
    camera_rays: Index | None

    @cached_property
    def radiance(self) -> Float:
        """Pictures of all views, (M, P)."""
        return np.concatenate([view.radiance for view in self.pictures], axis=1)

    def apply_precision(self, images: Float) -> Float:
        """Multiply images like the pictures, (M, P), by the precision of each camera ray."""
        parts = zip(self.precisions, _split(images, self.pictures), strict=True)
        return np.concatenate([precision.apply(part) for precision, part in parts], axis=1)


def fit_data(
    pictures: Sequence[ViewPictures], footprints: Iterable[Candidates], camera_rays: Index | None
) -> FitData:
    """Select the camera rays of a fit, and marginalise the weights of their footprints."""
    parts = (part.at(camera_rays) for part in footprints)
    in_fit = tuple(view.at(camera_rays) for view in pictures)
    precisions = tuple(map(marginal_precision, parts, in_fit))
    return FitData(in_fit, precisions, camera_rays)


@dataclass(frozen=True)
class CoreOperator:
    """Linear map from the core parts to the indirect light in the pictures.

    ``S -> z = diag(f) L S J`` with ``J = R^T diag(g) p``.

    Attributes
    ----------
    basis : IndirectBasis
    L : csr_array of float32, shape (M, n)
    f : ndarray of float32, shape (M,)
    pattern_light : ndarray of float32, shape (n, P)
        J.
    """

    basis: IndirectBasis
    L: csr_array[np.float32]
    f: Float
    pattern_light: Float

    def forward(self, core_parts: Float) -> Float:
        """Compute the indirect light of core parts (part_count,) in the pictures, (M, P)."""
        images: Float = self.L @ self.exchanged(core_parts)
        images *= self.f[:, None]
        return images

    def exchanged(self, core_parts: Float) -> Float:
        """Compute ``S J``, the light that each function receives in each picture, (n, P)."""
        from rfpipe.transport.pair_kernels import AsymmetricCores, couple_asymmetric

        received = np.zeros_like(self.pattern_light)
        S = AsymmetricCores(*self.basis.camera.pairs, *np.split(core_parts, 2))
        couple_asymmetric(S, self.pattern_light, received)
        return received

    def adjoint(self, images: Float) -> Float:
        """Apply the transpose of `forward` to images (M, P); returns (part_count,)."""
        from rfpipe.transport.pair_kernels import AsymmetricCores, correlate_asymmetric

        received = self.L.T @ (images * self.f[:, None])
        received = np.ascontiguousarray(received, np.float32)
        result = np.empty(self.basis.part_count, np.float32)
        S = AsymmetricCores(*self.basis.camera.pairs, *np.split(result, 2))  # views of the result
        correlate_asymmetric(received, self.pattern_light, S)
        return result

    def normal_diagonal(self, data: FitData) -> Float:
        """Estimate the diagonal of ``forward^T Lambda forward``, (part_count,)."""
        basis = self.basis.camera
        trace = sum(precision.trace for precision in data.precisions)
        precision = trace / self.pattern_light.shape[1] * np.square(self.f)
        weight = self.L.multiply(self.L).T @ precision
        power = np.einsum("aq,aq->a", self.pattern_light, self.pattern_light)
        forth = weight[basis.first] * power[basis.second]
        mirrored = weight[basis.second] * power[basis.first]
        diagonal = np.where(basis.first == basis.second, forth, forth + mirrored)
        return np.concatenate([diagonal, diagonal]).astype(np.float32)


def core_operator(
    light: IndirectLight, pictures: Sequence[ViewPictures], camera_rays: Index | None
) -> CoreOperator:
    """Build the operator of the pictures of some camera rays; None for all."""
    rays = slice(None) if camera_rays is None else camera_rays
    L = light.basis.L if camera_rays is None else light.basis.L[camera_rays]
    pattern_light = _pattern_light(light.basis, light.g, pictures)
    return CoreOperator(light.basis, L, light.f[rays], pattern_light)


def fit_cores(
    light: IndirectLight, data: FitData, deviations: Float, accuracy: Accuracy
) -> IndirectLight:
    """Fit S, starting from the S of `light`, with prior deviations sigma (part_count,)."""
    operator = core_operator(light, data.pictures, data.camera_rays)

    def project(images: Float) -> Float:
        return deviations * operator.adjoint(data.apply_precision(images))

    def normal(unknowns: Float) -> Float:
        return project(operator.forward(deviations * unknowns)) + unknowns

    start = np.zeros_like(deviations)
    np.divide(light.core_parts, deviations, out=start, where=deviations > 0)
    diagonal = 1 + operator.normal_diagonal(data) * np.square(deviations)
    scaling = np.float32(1) / diagonal
    target = project(data.radiance)
    solution = conjugate_gradients(normal, target, scaling.__mul__, start, *accuracy)
    step()
    return replace(light, core_parts=deviations * solution)


def fit_gains(light: IndirectLight, data: FitData) -> IndirectLight:
    """Fit the gains of projector rays, then of camera rays, with S fixed.

    Gains stay the same if the fit is restricted to some camera rays.
    """
    if data.camera_rays is not None:
        return light
    return _fit_camera_gains(_fit_projector_gains(light, data), data)


def _fit_projector_gains(light: IndirectLight, data: FitData) -> IndirectLight:
    """Fit the gains gamma of projector rays, with prior standard deviations tau.

    They minimise

        sum_i (c_i - z_i)^T Lambda_i (c_i - z_i) + sum_j ((gamma_j - 1) / tau_j)^2

    for ``z = diag(f) L S R^T diag(gamma) diag(projector_factor) p``, by conjugate gradients in
    ``(gamma - 1) / tau``.
    """
    basis, pictures = light.basis, data.pictures
    visible = basis.mapping.visibility > 1 / 2
    spread = np.where(visible, _VISIBLE_SPREAD, _HIDDEN_SPREAD).astype(np.float32)
    S, f, factor = light.core_matrix(), light.f, light.projector_factor

    def forward(gain: Float) -> Float:
        J = _pattern_light(basis, gain * factor, pictures)
        images: Float = (basis.L @ (S @ J)) * f[:, None]
        return images

    def project(images: Float) -> Float:
        received = basis.L.T @ (data.apply_precision(images) * f[:, None])
        on_views = _split(S.T @ received, pictures)
        change = [
            np.einsum("jq,jq->j", view.patterns, R @ on_view)
            for R, on_view, view in zip(basis.R_by_view, on_views, pictures, strict=True)
        ]
        gradient: Float = spread * factor * np.concatenate(change)
        return gradient

    def normal(change: Float) -> Float:
        return project(forward(spread * change)) + change

    target = project(data.radiance - forward(np.ones_like(spread)))
    start = ((light.projector_gain - 1) / spread).astype(np.float32)
    change = conjugate_gradients(normal, target, np.copy, start, *_GAIN_ACCURACY)
    gain = np.clip(1 + spread * change, _LEAST_GAIN, _LARGEST_GAIN)
    return replace(light, projector_gain=gain)


def _fit_camera_gains(light: IndirectLight, data: FitData) -> IndirectLight:
    """Fit the gain of each camera ray, with a prior standard deviation of 0.1.

    For the indirect light z without the gain, the gain is
    ``(z^T Lambda c + 1 / 0.1^2) / (z^T Lambda z + 1 / 0.1^2)``.
    """
    views = light.in_pictures(data.pictures)
    images = np.concatenate([view[:] for view in views], axis=1)
    images /= light.camera_gain[:, None]
    weighted, prior = data.apply_precision(images), np.float32(1 / _CAMERA_SPREAD**2)
    normal = np.einsum("iq,iq->i", weighted, images) + prior
    gain = (np.einsum("iq,iq->i", weighted, data.radiance) + prior) / normal
    return replace(light, camera_gain=np.clip(gain, _LEAST_GAIN, _LARGEST_GAIN))


class Misfit(NamedTuple):
    """Differences between pictures and model, for each camera ray of a fit.

    Attributes
    ----------
    chi_square : ndarray of float32, shape (M,)
        ``(c - z)^T Lambda (c - z)``.
    degrees_of_freedom : ndarray of int64, shape (M,)
        Approximate mean of chi_square if only noise is left: P - k, at least half of P; 0 for an
        masked pixel. It is about that where weights are much smaller than their prior deviations.
        It would be P for weights distributed as their prior.
    allowed : ndarray of float32, shape (M,)
        Value of chi_square for an allowed error.
    """

    chi_square: Float
    degrees_of_freedom: Index
    allowed: Float


def misfit(light: IndirectLight, data: FitData, allowed: float) -> Misfit:
    """Compare the pictures with the model; `allowed` is a fraction of the floodlit image."""
    operator = core_operator(light, data.pictures, data.camera_rays)
    images = _split(operator.forward(light.core_parts), data.pictures)
    views = []
    for view, precision, image in zip(data.pictures, data.precisions, images, strict=True):
        residual = view.radiance - image
        count = view.patterns.shape[1]
        # the prior determines the weights of many candidates, which thus fit less noise
        fitted_weights = np.minimum(precision.candidate_counts, count // 2)
        freedom = np.where(view.known, count - fitted_weights, 0)
        chi_square = np.einsum("iq,iq->i", residual, precision.apply(residual))
        views.append((chi_square, freedom, precision.trace * np.square(allowed * view.floodlit)))
    return Misfit(*(sum(terms[1:], terms[0]) for terms in zip(*views, strict=True)))


def _pattern_light(basis: IndirectBasis, g: Float, pictures: Sequence[ViewPictures]) -> Float:
    """Compute ``J = R^T diag(g) p`` of the patterns of all views, (n, P)."""
    factors = g.reshape(len(pictures), -1, 1)
    views = zip(basis.R_by_view, pictures, factors, strict=True)
    light = [R.T @ (view.patterns * factor) for R, view, factor in views]
    return np.ascontiguousarray(np.concatenate(light, axis=1), np.float32)


def _split(images: Float, pictures: Sequence[ViewPictures]) -> list[Float]:
    """Split arrays (..., P) of all views by projector view."""
    ends = np.cumsum([view.patterns.shape[1] for view in pictures])
    return np.split(images, ends[:-1], axis=1)
