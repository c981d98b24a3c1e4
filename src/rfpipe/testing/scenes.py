"""Contract of simulated scenes: tests that every scene must pass."""

from __future__ import annotations

from math import prod

import numpy as np
from numpy.testing import assert_array_equal
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.scenes.base import Scene
from rfpipe.testing.checks import require, require_close, require_equal_descriptions


class SceneContract:
    """Tests that any scene must pass.

    Subclass it as ``Test...`` and define `make_scene`.

    Attributes
    ----------
    coaxial : bool
        Whether camera and projector share their rays, so that the transport is symmetric.
    tolerance : float
        Largest relative difference allowed; float32 arithmetic reaches about 1e-6.
    """

    coaxial: bool = True
    tolerance: float = 1e-5

    def make_scene(self) -> Scene:
        """Return a new, preferably small scene with the same settings at every call."""
        raise NotImplementedError(f"{type(self).__name__} must define make_scene()")

    def test_light(self) -> None:
        """Radiance is float32 (B, M, C) for flat or shaped patterns, in the camera's range."""
        scene = self.make_scene()
        for shape in (scene.camera_shape, scene.projector_shape):
            require(len(shape) >= 2 and min(shape) > 0, f"a ray domain is {shape}")
        require(scene.channels in (1, 3), f"channels is {scene.channels}, not 1 or 3")
        for count in (1, 3):
            patterns = _patterns(scene, count)
            images = scene.apply(patterns)
            _require_light(images, (count, prod(scene.camera_shape), scene.channels), "radiance")
            flat = scene.apply(patterns.reshape(count, -1))
            assert_array_equal(flat, images, "apply() of patterns (B, N)")
        white = scene.apply(np.ones((1, *scene.projector_shape), np.float32))
        require(white.max() > 0, "no light reaches the camera")
        maximum = CameraModel().full_scale_radiance
        brightest = np.quantile(white, 0.99)
        require(
            brightest <= maximum, f"radiance is {brightest:.3g}; the default camera takes {maximum}"
        )
        _require_light(scene.albedo, (*scene.camera_shape, scene.channels), "albedo")

    def test_linearity(self) -> None:
        """The image of a sum of patterns is the sum of their images; black gives no light."""
        scene = self.make_scene()
        patterns = _patterns(scene, 2)
        weighted_sum, dark = 0.25 * patterns[0] + 0.5 * patterns[1], np.zeros_like(patterns[0])
        first, second, mixed, black = scene.apply(np.stack([*patterns, weighted_sum, dark]))
        require(not black.any(), "a black pattern gives light")
        require_close(mixed, 0.25 * first + 0.5 * second, self.tolerance, "the image of a sum")

    def test_same_bytes_in_any_batch(self) -> None:
        """A pattern's image doesn't depend on the other patterns of its batch.

        Otherwise a resumed capture would differ from an undisturbed one. `apply_in_batches` ensures
        this property.
        """
        patterns = _patterns(self.make_scene(), 19)
        images = self.make_scene().apply(patterns)
        for first, last in ((0, 1), (1, 5), (16, 19)):
            part = self.make_scene().apply(patterns[first:last])
            assert_array_equal(part, images[first:last], "patterns of another batch")

    def test_dense(self) -> None:
        """Each channel's matrix agrees with `apply`.

        For a coaxial scene it is symmetric, and each row and column of the projector lights some
        part of the scene.
        """
        scene = self.make_scene()
        light = np.zeros(scene.projector_shape)
        patterns = _patterns(scene, 2)
        images = scene.apply(patterns)
        for channel in range(scene.channels):
            matrix = scene.dense(channel)
            predicted = patterns.reshape(2, -1) @ matrix.T
            require_close(images[..., channel], predicted, self.tolerance, f"dense({channel})")
            if self.coaxial:
                require_close(matrix, matrix.T, self.tolerance, "the transposed matrix")
            light += matrix.sum(axis=0).reshape(light.shape)
        is_lit = light.any(axis=-1).all() and light.any(axis=-2).all()
        require(is_lit or not self.coaxial, "a row or column of the projector lights nothing")

    def test_description(self) -> None:
        """`describe` gives plain data that JSON can store, equal for equal scenes."""
        require_equal_descriptions(self.make_scene, lambda scene: scene.apply(_patterns(scene, 1)))


def _require_light(image: NDArray[np.floating], shape: tuple[int, ...], name: str) -> None:
    is_expected = image.shape == shape and image.dtype == np.float32
    require(is_expected, f"{name} is {image.dtype} {image.shape}; expected float32 {shape}")
    require(np.isfinite(image).all() and image.min() >= 0, f"{name} is negative, or not finite")


def _patterns(scene: Scene, count: int) -> Float:
    """Random patterns (count, *projector_shape) in [0, 1)."""
    return generator(count).random((count, *scene.projector_shape), dtype=np.float32)
