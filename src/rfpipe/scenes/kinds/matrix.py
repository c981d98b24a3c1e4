"""A scene whose light transport is in a file."""

from __future__ import annotations

from typing import Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PositiveFloat

from rfpipe.config.base import Text
from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe.scenes.kinds.views import AnyRig
from rfpipe.transport.matrix_in import RayOrder

__all__ = ["Matrix", "MatrixOptions"]


class MatrixOptions(AnyRig):
    """What is to be known of a matrix in a file."""

    files: ClassVar[tuple[str, ...]] = ("file",)

    file: Text = Field(
        description="File of the matrix, relative to where rfpipe runs: .npy, .npz (arrays, or a "
        "scipy sparse matrix), .mat of any version, .h5 or .hdf5, a zarr folder, or the "
        "transport.zarr of an acquisition.",
    )
    dataset: Text | None = Field(
        None,
        description="Name of the dataset in a file that holds several; names with commas between "
        "them for channels in datasets of their own. null: the only one.",
    )
    order: RayOrder = Field(
        "rows",
        description="How rays are numbered: rows (row by row, as NumPy does) or columns (column "
        "by column, as MATLAB's image(:) does).",
    )
    brightest: PositiveFloat | None = Field(
        None,
        description="Radiance of the brightest camera ray under floodlight, above 0, to which the "
        "matrix is scaled, so that the camera can see it; null leaves it as it stands.",
    )

    negative: Literal["refuse", "zero"] = Field(
        "refuse",
        description="What to do with negative entries, as noise leaves them in a matrix that was "
        "measured: refuse, or zero to take them for dark.",
    )


class Matrix(SceneKind):
    """Light transport in a file: NumPy, HDF5, MATLAB or zarr, dense or sparse."""

    Options: ClassVar[type[SceneSettings]] = MatrixOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:  # noqa: ARG003
        """Read the file.

        Raises
        ------
        InputError
            When it can't be read, or holds another shape or number of channels.
        """
        from rfpipe.scenes.matrix import MatrixScene
        from rfpipe.transport.matrix_in import read_matrix

        camera, projector = options.camera_ray_shape, options.ray_shape
        matrix = read_matrix(options.file, camera, projector, options.dataset, options.order)
        if len(matrix) != options.channels:
            raise InputError(
                f"{options.file}: holds {len(matrix)} channels; the scene's channels is "
                f"{options.channels}. Set it to {len(matrix)}"
            )
        if options.negative == "zero":
            matrix = [_lifted(channel) for channel in matrix]
        return MatrixScene(matrix, camera, projector, options.brightest)


def _lifted(matrix: Any) -> Any:
    """Return a matrix whose negative entries are zero; an operator has none that it tells."""
    if isinstance(matrix, np.ndarray):
        return np.maximum(matrix, 0)
    return matrix.maximum(0) if hasattr(matrix, "maximum") else matrix
