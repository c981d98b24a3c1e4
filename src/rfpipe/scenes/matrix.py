"""Scenes with a given transport matrix, and captured scenes, whose transport is unknown."""

from __future__ import annotations

from collections.abc import Sequence
from math import prod
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, PositiveFloat

from rfpipe.config.base import Text
from rfpipe.config.scenes import AnyRig, SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene, weights_of
from rfpipe.transport.matrix_reading import RayOrder, read_matrix
from rfpipe.transport.operators import Transportish, as_pattern_operator


class MatrixOptions(AnyRig):
    """Options of a transport matrix in a file."""

    files: ClassVar[tuple[str, ...]] = ("file",)

    file: Text = Field(
        description="File of the matrix: .npy, .npz, .mat, .h5, .hdf5, a zarr folder, or a "
        "transport.zarr.",
    )
    dataset: Text | None = Field(
        None,
        description="Name of the dataset in a file with several, or comma-separated names for "
        "channels; null: the only dataset.",
    )
    order: RayOrder = Field(
        "rows",
        description="Order of rays: rows (as in NumPy) or columns (as in MATLAB's image(:)).",
    )
    brightest: PositiveFloat | None = Field(
        None,
        description="Radiance of the brightest camera ray in the floodlit image, above 0, to which "
        "the matrix is scaled; null: unscaled.",
    )


class MatrixScene(Scene):
    """Light transport in a file: NumPy, HDF5, MATLAB or zarr, dense or sparse.

    Parameters
    ----------
    matrix : Transportish
        As in `rfpipe.OperatorRig`.
    camera_shape, projector_shape : tuple of int
    brightest : float, optional
        Radiance of the brightest camera ray in the floodlit image, above 0, to which the matrix is
        scaled; None: unscaled.

    Raises
    ------
    InputError
        When the matrix doesn't fit the shapes, has an entry that is negative or not finite, or is
        zero and should be scaled.
    """

    Options: ClassVar[type[SceneSettings]] = MatrixOptions

    def __init__(
        self,
        matrix: Transportish,
        camera_shape: Sequence[int],
        projector_shape: Sequence[int],
        brightest: float | None = None,
    ) -> None:
        camera, projector = tuple(camera_shape), tuple(projector_shape)
        self._operator = as_pattern_operator(matrix, prod(camera), prod(projector))
        super().__init__(camera, projector, self._operator.channels)
        self._scale = np.float32(1)
        if brightest is not None:
            largest = float(self.apply(np.ones((1, prod(projector)), np.float32)).max())
            if not largest > 0:
                raise InputError(
                    "the floodlit image of the matrix is black, so brightest can't be reached. Set "
                    "it to null"
                )
            self._scale = np.float32(brightest / largest)

    @classmethod
    def make(cls, options: Any) -> Scene:
        """Read the file; raise InputError where it doesn't match the options."""
        camera, projector = options.camera_ray_shape, options.ray_shape
        matrix = read_matrix(options.file, camera, projector, options.dataset, options.order)
        if len(matrix) != options.channels:
            raise InputError(
                f"{options.file}: has {len(matrix)} channels; the scene's channels is "
                f"{options.channels}. Set it to {len(matrix)}"
            )
        return cls(matrix, camera, projector, options.brightest)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape)."""
        weights = weights_of(patterns, self.projector_shape)
        images = self._operator.apply(weights.astype(np.float32))
        # a stored transport is rounded, also to negative values
        light: NDArray[np.float32] = np.maximum(np.asarray(images, np.float32), 0) * self._scale
        return light

    def describe(self) -> dict[str, Any]:
        """Plain data of everything that determines the transport, for fingerprints (JSON)."""
        describe = getattr(self._operator, "describe", None)
        return {
            "kind": "matrix",
            "operator": describe() if describe else type(self._operator).__name__,
            "scale": float(self._scale),
        }


class CapturedOptions(AnyRig):
    """Options of the rig of a real scene."""

    is_captured: ClassVar[bool] = True


class Captured(Scene):
    """A real scene, whose light transport is unknown."""

    Options: ClassVar[type[SceneSettings]] = CapturedOptions

    @classmethod
    def make(cls, options: Any) -> Scene:  # noqa: ARG003
        """Raise InputError: a captured scene can't be simulated."""
        raise InputError(
            "a scene of kind captured can't be simulated; use plane, wedge or another kind"
        )
