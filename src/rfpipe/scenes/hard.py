"""Small scenes that are numerically hard to acquire, each by name.

Most are given by their matrix. They are ground truth for tests and reports: a method has to get
through each without a crash, a NaN or an error out of proportion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError
from rfpipe.provenance import fingerprint, generator
from rfpipe.scenes.base import CoaxialScene, apply_in_batches
from rfpipe.scenes.rooms import REFERENCE_SCENES, planes_scene, reference_scene
from rfpipe.scenes.surfaces import Occluder

_SHAPE = (16, 16)
_SEED = 0

# A plate in the plane x = 0, edge-on to the rig and so unseen, between the planes of a wedge.
PLATE = Occluder(centre=(0, 0, 2.6), edge_u=(0, 0.5, 0), edge_v=(0, 0, 0.25))


class DenseScene(CoaxialScene):
    """A scene given by its matrix.

    Parameters
    ----------
    name
        What the scene is called in its description.
    matrix
        (N, N), or one a channel (C, N, N): rows are camera rays, columns projector rays; finite
        and not negative.
    shape
        Shape of the ray domain of N rays.

    Raises
    ------
    InputError
        If the matrix doesn't fit the shape, or an entry is negative or not finite.
    """

    def __init__(self, name: str, matrix: ArrayLike, shape: tuple[int, ...]) -> None:
        matrices = np.asarray(matrix, dtype=np.float64)
        if matrices.ndim == 2:
            matrices = matrices[None]
        rays = int(np.prod(shape))
        if matrices.ndim != 3 or matrices.shape[1:] != (rays, rays):
            raise InputError(
                f"scene {name}: matrix of shape {matrices.shape}, expected (channels, {rays}, "
                f"{rays}) for the ray domain {tuple(shape)}"
            )
        if not (np.isfinite(matrices).all() and (matrices >= 0).all()):
            raise InputError(f"scene {name}: every entry should be finite and at least 0")
        super().__init__(tuple(shape), len(matrices))
        self.name = name
        self._matrices = matrices

    @property
    def albedo(self) -> NDArray[np.float32]:
        """What each ray sends straight back, the matrix' diagonal: float32 (*shape, C)."""
        diagonal = np.diagonal(self._matrices, axis1=1, axis2=2)
        return diagonal.T.reshape(*self.shape, self.channels).astype(np.float32)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, N, C) under patterns (B, N) or (B, *shape).

        Raises
        ------
        InputError
            If the patterns have another shape, or a weight is not finite.
        """
        return apply_in_batches(
            lambda weights: (self._matrices @ weights).transpose(1, 2, 0),
            patterns,
            self.shape,
            self.channels,
        )

    def dense(self, channel: int = 0) -> NDArray[np.float64]:
        """The whole matrix (N, N) of one channel."""
        matrix: NDArray[np.float64] = self._matrices[channel].copy()
        return matrix

    def describe(self) -> dict[str, Any]:
        """Everything that shapes the transport, as plain data for fingerprints (JSON)."""
        return {
            "scene": self.name,
            "shape": list(self.shape),
            "matrix": fingerprint(self._matrices),
        }


def with_flare(matrix: NDArray[np.float64], fraction: float) -> NDArray[np.float64]:
    """Let the camera's lens spread a fraction of each image's light evenly: rows only.

    Parameters
    ----------
    matrix
        (N, N), rows are camera rays.
    fraction
        Of the light, between 0 and 1.
    """
    flared: NDArray[np.float64] = (1 - fraction) * matrix + fraction * matrix.mean(axis=0)
    return flared


def with_misalignment(
    matrix: NDArray[np.float64], shape: tuple[int, int], pixels: float
) -> NDArray[np.float64]:
    """Shift the camera sideways against the projector, by linear interpolation of the rows.

    Parameters
    ----------
    matrix
        (N, N), rows are camera rays.
    shape
        Height and width of the ray domain.
    pixels
        Shift to the right, between 0 and 1; beyond the image's edge the last column goes on.
    """
    images = matrix.reshape(*shape, -1)
    shifted = np.concatenate([images[:, :1], images[:, :-1]], axis=1)
    return ((1 - pixels) * images + pixels * shifted).reshape(matrix.shape)


def with_unequal_gains(
    matrix: NDArray[np.float64], gains: Sequence[float] | NDArray[np.float64]
) -> NDArray[np.float64]:
    """Give each camera ray a gain of its own.

    Parameters
    ----------
    matrix
        (N, N), rows are camera rays.
    gains
        (N,), around 1.
    """
    return np.asarray(gains)[:, None] * matrix


def hard_cases() -> dict[str, Callable[[], DenseScene]]:
    """Name the hard cases; call one's value to make it, the same each time.

    Returns
    -------
    dict
        Name to maker of a `DenseScene` of at most 377 rays.
    """

    def case(name: str, matrix: Callable[[], ArrayLike]) -> Callable[[], DenseScene]:
        return lambda: DenseScene(name, matrix(), _SHAPE)

    return {
        "bright_direct": case("bright direct light", _bright_direct),
        # so dark that a camera counts few photons; the noise itself is the rig's
        "photon_starved": case("photon-starved", lambda: 1e-4 * _wedge()),
        "no_interreflection": lambda: _reference("I", _SHAPE),
        "zero_transport": case("zero transport", lambda: np.zeros((256, 256))),
        "diffuse_cavity": case("diffuse cavity", _diffuse_cavity),
        "mirror": case("mirror", _mirror),
        "random_permutation": case("random permutation", _random_permutation),
        "random_dense": case("random dense", _random_dense),
        "occluder": lambda: _reference("IV", _SHAPE, [PLATE]),
        "caustics": case("caustics", _caustics),
        "dark_channel": case("dark channel", _dark_channel),
        "one_row": lambda: _reference("IV", (1, 37)),
        "prime_sides": lambda: _reference("IV", (13, 29)),
        "one_pixel": lambda: _reference("I", (1, 1)),
        # a twentieth of the light spread over the image by the camera's lens
        "asymmetric_flare": case("flare", lambda: with_flare(_wedge(), 0.05)),
        "asymmetric_alignment": case(
            "misaligned", lambda: with_misalignment(_wedge(), _SHAPE, 0.5)
        ),
        "asymmetric_gains": case(
            "unequal gains",
            lambda: with_unequal_gains(_wedge(), generator(_SEED, 4).uniform(0.9, 1.1, 256)),
        ),
    }


def _reference(name: str, shape: tuple[int, int], occluders: Sequence[Occluder] = ()) -> DenseScene:
    """A grey reference scene as its matrix."""
    scene = planes_scene(*REFERENCE_SCENES[name], shape, channels=1, occluders=occluders)
    return DenseScene(scene.name, scene.dense(), shape)


def _wedge(bounces: int = 3) -> NDArray[np.float64]:
    """Grey matrix of two textured planes."""
    return reference_scene("IV", _SHAPE, channels=1, bounces=bounces).dense()


def _bright_direct() -> NDArray[np.float64]:
    """Direct light 10^5 times the indirect, by the maxima of their floodlit images."""
    direct = np.diag(np.diag(_wedge(bounces=1)))
    indirect = _wedge() - direct
    return np.asarray(direct + 1e-5 * direct.sum(1).max() / indirect.sum(1).max() * indirect)


def _diffuse_cavity() -> NDArray[np.float64]:
    """An integrating cavity: whatever is lit, the walls glow alike, each by its albedo."""
    albedo = generator(_SEED, 0).uniform(0.1, 0.9, 256)
    return np.asarray(np.outer(albedo, albedo) / albedo.sum())


def _mirror() -> NDArray[np.float64]:
    """A mirror that sends each ray back along its mirror image, left for right."""
    image = np.arange(256).reshape(_SHAPE)[:, ::-1].ravel()
    return 0.9 * np.eye(256)[image]


def _random_permutation() -> NDArray[np.float64]:
    """Rays that are paired at random, each lit by its partner alone."""
    partners = generator(_SEED, 1).permutation(256).reshape(-1, 2)
    matrix = np.zeros((256, 256))
    matrix[partners[:, 0], partners[:, 1]] = matrix[partners[:, 1], partners[:, 0]] = 0.9
    return matrix


def _random_dense() -> NDArray[np.float64]:
    """Symmetric, every entry random: nothing to compress."""
    upper = np.triu(generator(_SEED, 2).random((256, 256)))
    return upper + np.triu(upper, 1).T


def _caustics() -> NDArray[np.float64]:
    """Two textured planes, and a few pairs of rays joined by strong focused light."""
    matrix = _wedge()
    random = generator(_SEED, 3)
    pairs = random.permutation(256)[:32].reshape(-1, 2)
    strength = random.uniform(5, 50, len(pairs)) * matrix.diagonal().mean()
    matrix[pairs[:, 0], pairs[:, 1]] += strength
    matrix[pairs[:, 1], pairs[:, 0]] += strength
    return matrix


def _dark_channel() -> NDArray[np.float64]:
    """Two textured planes that reflect no blue at all."""
    scene = reference_scene("IV", _SHAPE)
    return np.stack([scene.dense(0), scene.dense(1), np.zeros((256, 256))])
