"""Small scenes that are numerically hard to acquire, each by name.

They are ground truth for tests and reports: a method has to get through each without a crash, a
NaN or an error out of proportion.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from rfpipe.array_types import Double
from rfpipe.provenance import generator
from rfpipe.scenes.matrix import MatrixScene
from rfpipe.scenes.rooms import REFERENCE_SCENES, planes_scene, reference_scene
from rfpipe.scenes.surfaces import Occluder

_SHAPE = (16, 16)
_SEED = 0

# A plate in the plane x = 0, edge-on to the rig and so unseen, between the planes of a wedge.
PLATE = Occluder(centre=(0, 0, 2.6), edge_u=(0, 0.5, 0), edge_v=(0, 0, 0.25))


def hard_cases() -> dict[str, Callable[[], MatrixScene]]:
    """Name the hard cases, of at most 377 rays; call one to make it, the same each time."""

    def reference(
        name: str, shape: tuple[int, int], occluders: Sequence[Occluder] = ()
    ) -> Callable[[], MatrixScene]:
        def make() -> Double:
            made = planes_scene(*REFERENCE_SCENES[name], shape, channels=1, occluders=occluders)
            return made.dense()

        return case(make, shape)

    def case(
        make: Callable[[], Double], shape: tuple[int, int] = _SHAPE
    ) -> Callable[[], MatrixScene]:
        return lambda: MatrixScene(make(), shape, shape)

    matrices: dict[str, Callable[[], Double]] = {
        "bright_direct": _bright_direct,
        # so dark that a camera counts few photons; the noise itself is the rig's
        "photon_starved": lambda: 1e-4 * _wedge(),
        "zero_transport": lambda: np.zeros((256, 256)),
        "diffuse_cavity": _diffuse_cavity,
        "mirror": _mirror,
        "random_permutation": _random_permutation,
        "random_dense": _random_dense,
        "caustics": _caustics,
        "dark_channel": _dark_channel,
        "asymmetric_flare": _flare,
        "asymmetric_alignment": _misalignment,
        # each camera ray has another gain
        "asymmetric_gains": lambda: generator(_SEED, 4).uniform(0.9, 1.1, (256, 1)) * _wedge(),
    }
    return {name: case(make) for name, make in matrices.items()} | {
        "no_interreflection": reference("I", _SHAPE),
        "occluder": reference("IV", _SHAPE, [PLATE]),
        "one_row": reference("IV", (1, 37)),
        "prime_sides": reference("IV", (13, 29)),
        "one_pixel": reference("I", (1, 1)),
    }


def _wedge(bounces: int = 3) -> Double:
    """Grey matrix of two textured planes."""
    return reference_scene("IV", _SHAPE, channels=1, bounces=bounces).dense()


def _flare() -> Double:
    """Let the camera's lens spread a twentieth of each image's light evenly, of rows alone."""
    matrix = _wedge()
    return np.asarray(0.95 * matrix + 0.05 * matrix.mean(axis=0))


def _misalignment() -> Double:
    """Shift the camera to the right by half a pixel, by linear interpolation of the rows."""
    images = _wedge().reshape(*_SHAPE, -1)
    shifted = np.concatenate([images[:, :1], images[:, :-1]], axis=1)
    return np.asarray(0.5 * images + 0.5 * shifted).reshape(256, 256)


def _bright_direct() -> Double:
    """Direct light 10^5 times the indirect, by the maxima of their floodlit images."""
    direct = np.diag(np.diag(_wedge(bounces=1)))
    indirect = _wedge() - direct
    return np.asarray(direct + 1e-5 * direct.sum(1).max() / indirect.sum(1).max() * indirect)


def _diffuse_cavity() -> Double:
    """An integrating cavity: whatever is lit, the walls glow alike, each by its albedo."""
    albedo = generator(_SEED, 0).uniform(0.1, 0.9, 256)
    return np.asarray(np.outer(albedo, albedo) / albedo.sum())


def _mirror() -> Double:
    """A mirror that sends each ray back along its mirror image, left for right."""
    image = np.arange(256).reshape(_SHAPE)[:, ::-1].ravel()
    return 0.9 * np.eye(256)[image]


def _random_permutation() -> Double:
    """Rays that are paired at random, each lit by its partner alone."""
    partners = generator(_SEED, 1).permutation(256).reshape(-1, 2)
    matrix = np.zeros((256, 256))
    matrix[partners[:, 0], partners[:, 1]] = matrix[partners[:, 1], partners[:, 0]] = 0.9
    return matrix


def _random_dense() -> Double:
    """Symmetric, every entry random: nothing to compress."""
    upper = np.triu(generator(_SEED, 2).random((256, 256)))
    return upper + np.triu(upper, 1).T


def _caustics() -> Double:
    """Two textured planes, and a few pairs of rays joined by strong focused light."""
    matrix = _wedge()
    random = generator(_SEED, 3)
    pairs = random.permutation(256)[:32].reshape(-1, 2)
    strength = random.uniform(5, 50, len(pairs)) * matrix.diagonal().mean()
    matrix[pairs[:, 0], pairs[:, 1]] += strength
    matrix[pairs[:, 1], pairs[:, 0]] += strength
    return matrix


def _dark_channel() -> Double:
    """Two textured planes that reflect no blue at all."""
    scene = reference_scene("IV", _SHAPE)
    return np.stack([scene.dense(0), scene.dense(1), np.zeros((256, 256))])
