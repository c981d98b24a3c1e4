"""Pictures under lights between measured lights: kriging on the sphere, with a Lambertian trend.

A picture under light from direction ``d`` is a weighted sum of the pictures ``y_j`` of L lights
plus a Lambertian part, which is fitted to each pixel (`rfpipe.lights.shading`)::

    y(d) = sum_j w_j(d) y_j + s(d) max(b . d, 0) - sum_j v_j(d) max(b . l_j, 0)

=====================  =============  ======================================================
symbol                 name           meaning
=====================  =============  ======================================================
``w``                  weights        of the measured pictures
``s``                  share          of the models that have the Lambertian trend
``v``                  shading        weights of those models, which krige what the trend leaves
=====================  =============  ======================================================

The weights are averaged over several models. Each model is universal kriging [N. Cressie,
Statistics for Spatial Data, 1993, section 3.4] with a trend and a covariance over the angle ``t``
between two lights::

    K(t) = a ((sin t + (pi - t) cos t) / pi) + c(t / scale) + nugget [t = 0]

The first part is the covariance of Lambertian shading over normals of all directions [Y. Cho and
L. K. Saul, Kernel methods for deep learning, NIPS 2009], ``c`` is exponential or Matern 3/2. The
parameters are chosen, and the models averaged, by their errors at lights that are left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Bools, Double
from rfpipe.lights.shading import fit_shading, shaded

REACH = 2.0
"""Angle, over the lights' spacing, up to which directions have light."""

MOST_LIGHTS = 1024
"""More lights are so dense that each direction takes its nearest light."""

_LIGHTS_COMPARED = 128
"""Lights that models are compared on, at most: their covariances are inverted for each model."""

_TEMPERATURE = 0.03
"""Relative difference of errors at which a model's share falls by a factor e."""

_OPTIMISM = 1.2
"""Factor, over the number of lights, by which the chosen linear model's error is too small."""

_NEAR = 0.3
"""Angle from a light, over the lights' spacing, within which its picture is blended in."""


class KrigingModel(NamedTuple):
    """Parameters of a kriging model: trend and covariance."""

    trend: str
    lambertian: float
    scale: float
    nugget: float
    form: str


@dataclass(frozen=True, eq=False)
class Interpolation:
    """Weights of measured lights for light from any direction.

    Attributes
    ----------
    directions : ndarray of float64, shape (L, 3)
        Unit vectors towards the lights.
    models : tuple of KrigingModel
    shares : tuple of float
        Of the models; they sum to 1. Without models, each direction takes its nearest light.
    solutions : tuple of ndarray of float64, shape (L + trend functions, L)
        Of each model: weights are the covariances and trend functions at a direction times this.
    spacing : float
        Radians; see `light_spacing`.
    errors : ndarray of float64, shape (L,)
        Relative error of each light's picture when that light is left out; NaN where unknown.
    """

    directions: Double
    models: tuple[KrigingModel, ...]
    shares: tuple[float, ...]
    solutions: tuple[Double, ...]
    spacing: float
    errors: Double

    @property
    def has_shading(self) -> bool:
        """True if some models have the Lambertian trend of each pixel."""
        return any(model.trend == "shading" for model in self.models)

    def covered(self, directions: Double) -> Bools:
        """Return whether unit vectors (D, 3) are within `REACH` times the spacing of a light."""
        return nearest_light(self.directions, directions)[0] <= REACH * self.spacing + 1e-6

    def weights(self, directions: Double) -> tuple[Double, Double, Double]:
        """Return the weights for light from unit vectors (D, 3).

        Returns
        -------
        weights : ndarray of float64, shape (D, L)
            ``w``; 0 for directions that aren't covered.
        share : ndarray of float64, shape (D,)
            ``s``.
        shading : ndarray of float64, shape (D, L)
            ``v``.
        """
        lights = len(self.directions)
        angle, nearest = nearest_light(self.directions, directions)
        at_light = np.zeros((len(directions), lights))
        at_light[np.arange(len(directions)), nearest] = 1
        if not self.models:
            covered = self.covered(directions)[:, None]
            return at_light * covered, np.zeros(len(directions)), np.zeros_like(at_light)
        angles = angles_between(directions, self.directions)
        weights, shading = np.zeros_like(at_light), np.zeros_like(at_light)
        for model, share, solution in zip(self.models, self.shares, self.solutions, strict=True):
            functions = np.hstack([covariance(angles, model), trend(model.trend, directions)])
            part = share * (functions @ solution)
            weights += part
            if model.trend == "shading":
                shading += part
        shares = [s for s, m in zip(self.shares, self.models, strict=True) if m.trend == "shading"]
        # the picture of a light itself at its direction, the models' further away
        nearness = np.clip(1.5 - 1.5 * angle / (_NEAR * self.spacing + 1e-9), 0, 1)[:, None]
        visible = self.covered(directions)[:, None]
        weights = visible * ((1 - nearness) * weights + nearness * at_light)
        shading = visible * (1 - nearness) * shading
        return weights, (visible * (1 - nearness))[:, 0] * sum(shares), shading


def between(lights: NDArray[np.floating]) -> Interpolation:
    """Return an interpolation that depends on directions alone; its weights sum to 1.

    Parameters
    ----------
    lights : ndarray, shape (L, 3)
        Directions of any length, none of them 0.
    """
    directions = unit(lights)
    spacing = light_spacing(directions)
    unknown = np.full(len(directions), np.nan)
    if not 3 < len(directions) <= MOST_LIGHTS:
        return Interpolation(directions, (), (), (), spacing, unknown)
    model = KrigingModel("constant", 2.0, min(2 * spacing, 1.0), 0.05, "exponential")
    return Interpolation(
        directions, (model,), (1.0,), (_solution(model, directions),), spacing, unknown
    )


def interpolate(
    pictures: NDArray[np.floating],
    lights: NDArray[np.floating],
    *,
    with_shading: bool = True,
    most_folds: int = 32,
) -> Interpolation:
    """Choose an interpolation by the errors of pictures whose lights are left out.

    Parameters
    ----------
    pictures : ndarray, shape (L, P)
        Radiance of some pixels under each light.
    lights : ndarray, shape (L, 3)
        Directions of any length, none of them 0.
    with_shading : bool
        Whether models with the Lambertian trend of each pixel are compared, too.
    most_folds : int
        Lights that are left out one by one, at most; `Interpolation.errors` has their errors.
    """
    directions, y = unit(lights), np.asarray(pictures, np.float64)
    norms = np.linalg.norm(y, axis=1)
    simple = between(directions)
    if not simple.models or np.count_nonzero(norms) < 4:
        return simple
    subset = np.unique(np.linspace(0, len(y) - 1, _LIGHTS_COMPARED).astype(int))
    subset = subset[norms[subset] > 0]
    folds = np.unique(np.linspace(0, len(subset) - 1, most_folds).astype(int))
    compared = _Compared.of(y[subset], directions[subset], folds)
    linear = _averaged(compared, list(_linear_models(compared.directions)))
    matt = _averaged(compared, list(_shading_models())) if with_shading else linear
    share = (
        1.0
        if not with_shading
        else _linear_share(linear.error * (1 + _OPTIMISM / len(subset)), matt.error)
    )
    residual = share * linear.residual + (1 - share) * matt.residual
    errors = np.full(len(y), np.nan)
    errors[subset[folds]] = compared.errors(residual)
    terms = [(m, share * s) for m, s in zip(linear.models, linear.shares, strict=True)]
    terms += [(m, (1 - share) * s) for m, s in zip(matt.models, matt.shares, strict=True)]
    models = tuple(model for model, s in terms if s > 0)
    solutions = tuple(_solution(model, directions) for model in models)
    shares = tuple(s for _, s in terms if s > 0)
    return Interpolation(directions, models, shares, solutions, simple.spacing, errors)


def _linear_share(linear_error: float, matt_error: float) -> float:
    """Return the share of linear models beside those with the Lambertian trend, 0 to 1."""
    if linear_error <= 1e-6:
        return 1.0
    ratio = min(matt_error / linear_error, 10.0) ** 8
    return ratio / (1 + ratio)


class _Compared(NamedTuple):
    """Pictures on which models are compared: L lights, of which F are left out one by one.

    `products` (F, 2 L, 2 L) are inner products of the pictures and their Lambertian fits, which
    are fitted without the light that is left out.
    """

    directions: Double
    folds: NDArray[np.intp]
    products: Double
    norms: Double

    @classmethod
    def of(cls, y: Double, directions: Double, folds: NDArray[np.intp]) -> _Compared:
        """Fit the shading without each of the lights that are left out."""
        products = []
        for fold in folds:
            training = np.delete(np.arange(len(y)), fold)
            b = fit_shading(y[training], directions[training]).vectors
            stacked = np.vstack([y, shaded(b, directions)])
            products.append(stacked @ stacked.T)
        return cls(directions, folds, np.array(products), np.linalg.norm(y[folds], axis=1))

    def errors(self, residual: Double) -> Double:
        """Return relative errors (F,) of residuals (F, 2 L) in pictures and their shading."""
        squares = ((self.products @ residual[..., None])[..., 0] * residual).sum(axis=1)
        errors: Double = np.sqrt(np.maximum(squares, 0)) / self.norms
        return errors


class _Averaged(NamedTuple):
    """Models, averaged: shares that sum to 1, residuals (F, 2 L) and their mean error."""

    models: list[KrigingModel]
    shares: list[float]
    residual: Double
    error: float


def _averaged(compared: _Compared, models: list[KrigingModel]) -> _Averaged:
    """Average the models of the least errors at lights that are left out."""
    angles = angles_between(compared.directions, compared.directions)
    scored: list[tuple[float, KrigingModel, Double]] = []
    inverses: dict[KrigingModel, Double] = {}
    for model in models:
        alike = model._replace(trend="")
        if alike not in inverses:
            system = covariance(angles, model) + model.nugget * np.eye(len(angles))
            inverses[alike] = np.asarray(np.linalg.inv(system), np.float64)
        residual = _residuals(model, inverses[alike], compared)
        if residual is not None:
            scored.append((float(compared.errors(residual).mean()), model, residual))
    scored.sort(key=lambda score: score[0])
    least = max(scored[0][0], 1e-9)
    best = [score for score in scored[:12] if score[0] <= least * (1 + 3 * _TEMPERATURE)]
    shares = np.exp(-(np.array([error for error, _, _ in best]) / least - 1) / _TEMPERATURE)
    shares /= shares.sum()
    residuals = np.array([residual for _, _, residual in best])
    mean: Double = np.asarray(np.tensordot(shares, residuals, 1), np.float64)
    error = float(compared.errors(mean).mean())
    return _Averaged([model for _, model, _ in best], shares.tolist(), mean, error)


def _residuals(model: KrigingModel, inverse: Double, compared: _Compared) -> Double | None:
    """Return residuals of lights that are left out, as weights (F, 2 L) of pictures and shading.

    With ``B = K^-1 - K^-1 F (F^T K^-1 F)^-1 F^T K^-1``, F the trend functions, the residual of
    light i is ``(B y)_i / B_ii`` [O. Dubrule, Cross validation of kriging in a unique
    neighborhood, Mathematical Geology 15 (1983)]. None if another light can't be predicted.
    """
    count = len(inverse)
    functions = trend(model.trend, compared.directions)
    if functions.shape[1]:
        if functions.shape[1] > count - 2:
            return None
        explained = inverse @ functions
        projection = explained @ np.linalg.pinv(functions.T @ explained) @ explained.T
        inverse = np.asarray(inverse - projection, np.float64)
    diagonal = np.diag(inverse)
    if diagonal.min() <= 1e-9 * diagonal.max():
        return None
    rows = (inverse / diagonal[:, None])[compared.folds]
    return np.hstack([rows, -rows if model.trend == "shading" else np.zeros_like(rows)])


def _solution(model: KrigingModel, directions: Double) -> Double:
    """Return the matrix (L + p, L) that turns covariances and p trend functions into weights."""
    count, functions = len(directions), trend(model.trend, directions)
    angles = angles_between(directions, directions)
    system = np.zeros((count + functions.shape[1],) * 2)
    system[:count, :count] = covariance(angles, model) + model.nugget * np.eye(count)
    system[:count, count:] = functions
    system[count:, :count] = functions.T
    solution: Double = np.linalg.pinv(system, hermitian=True)[:, :count]
    return solution


def _linear_models(directions: Double) -> Iterator[KrigingModel]:
    """Yield the models that are linear in the pictures."""
    forms, scales = ("exponential", "matern"), np.radians([8, 15, 30, 60, 120]).tolist()
    nuggets, names = (0.01, 0.05, 0.2, 0.6), ("none", "constant", "linear")
    for form, scale, a, nugget in product(forms, scales, (0, 2, 20), nuggets):
        for name in names:
            yield KrigingModel(name, a, scale, nugget, form)
    for name in ("linear", "harmonics2", "harmonics3"):
        if 1.5 * trend(name, directions).shape[1] < len(directions):
            yield KrigingModel(name, 0, 0, 1, "exponential")
            for scale, nugget in product(np.radians([10, 25, 60]).tolist(), (0.05, 0.5)):
                yield KrigingModel(name, 0, scale, nugget, "exponential")


def _shading_models() -> Iterator[KrigingModel]:
    """Yield the models with the Lambertian trend of each pixel."""
    yield KrigingModel("shading", 0, 0, 1, "exponential")
    for form in ("exponential", "matern"):
        for scale in np.radians([8, 15, 30, 60, 120]):
            for nugget in (0.05, 0.2, 0.6, 2):
                yield KrigingModel("shading", 0, float(scale), nugget, form)


def covariance(angles: Double, model: KrigingModel) -> Double:
    """Return the covariance of a model at angles in radians, without its nugget."""
    if not model.scale:
        values: Double = np.zeros_like(angles)
    elif model.form == "exponential":
        values = np.exp(-angles / model.scale)
    else:
        distance = np.sqrt(3) * 2 * np.sin(angles / 2) / model.scale
        values = (1 + distance) * np.exp(-distance)
    if model.lambertian:
        shading = (np.sin(angles) + (np.pi - angles) * np.cos(angles)) / np.pi
        values = values + model.lambertian * shading
    return values


def trend(name: str, directions: Double) -> Double:
    """Return the trend functions at unit vectors (D, 3), shape (D, functions)."""
    x, y, z = directions.T
    constant: Double = np.ones(len(directions))
    if name == "constant":
        return constant[:, None]
    if name == "linear":
        return directions
    if name not in ("harmonics2", "harmonics3"):
        return np.empty((len(directions), 0))
    # real spherical harmonics, each of the root mean square 1
    functions = [constant, 1.73 * x, 1.73 * y, 1.73 * z]
    functions += [3.87 * x * y, 3.87 * y * z, 3.87 * x * z, 1.94 * (x * x - y * y)]
    functions += [1.12 * (3 * z * z - 1)]
    if name == "harmonics3":
        functions += [2.09 * y * (3 * x * x - y * y), 10.25 * x * y * z]
        functions += [1.62 * y * (5 * z * z - 1), 1.32 * z * (5 * z * z - 3)]
        functions += [1.62 * x * (5 * z * z - 1), 5.12 * z * (x * x - y * y)]
        functions += [2.09 * x * (x * x - 3 * y * y)]
    harmonics: Double = np.stack(functions, axis=1)
    return harmonics


def unit(vectors: NDArray[np.floating]) -> Double:
    """Return vectors (L, 3), none of them 0, at length 1, float64."""
    values = np.asarray(vectors, np.float64)
    directions: Double = values / np.linalg.norm(values, axis=1, keepdims=True)
    return directions


def angles_between(first: Double, second: Double) -> Double:
    """Return the angles, radians, between unit vectors (A, 3) and (B, 3), shape (A, B)."""
    angles: Double = np.arccos(np.clip(first @ second.T, -1, 1))
    return angles


def nearest_light(lights: Double, directions: Double) -> tuple[Double, NDArray[np.intp]]:
    """Return the angle to the nearest light, radians, and its number, of unit vectors (D, 3)."""
    from scipy.spatial import cKDTree

    chord, nearest = cKDTree(lights).query(directions)
    angle: Double = 2 * np.arcsin(np.clip(chord / 2, 0, 1))
    return angle, np.asarray(nearest, np.intp)


def light_spacing(directions: Double) -> float:
    """Return the spacing of lights, radians: pi for one light.

    It is the 0.9 quantile of the angles from each light to its nearest other. Lights within half a
    degree of each other count as one.
    """
    from scipy.spatial import cKDTree

    double = {second for _, second in cKDTree(directions).query_pairs(np.radians(0.5))}
    single = np.delete(directions, sorted(double), axis=0)
    if len(single) < 2:
        return float(np.pi)
    chord = np.asarray(cKDTree(single).query(single, k=2)[0])[:, 1]
    return float(np.quantile(2 * np.arcsin(np.clip(chord / 2, 0, 1)), 0.9))
