"""The residual model: light that another model of the transport leaves unexplained.

    T = M + f K f + diag(d)        coaxial rigs, K symmetric
    T = M + f K g                  other rigs

M is any transport: a near/far or footprint model, or a hierarchy. K connects cells
of pixels, at most 4096 on either side, in Haar wavelets: ``K = W^T C W'``. Its entries have any
sign; where they are negative they take back light of M. The factors f and g carry the texture: half
of the light that a surface returns is in proportion to the light that it receives, half to the
light that it sends, so both are roots of the images.

======  ===================  ============  =========================================================
symbol  name in the code     shape         meaning and unit
======  ===================  ============  =========================================================
``M``   `model`              (M, N)        the model, M camera and N projector pixels, radiance
``f``   `factor`             (C, M)        root of the floodlit image, mean 1, no unit
``g``   `projector_factor`   (C, N)        root of the light that each projector ray sends, mean 1
``W``   `cells.haar`         (m, cells)    Haar transform of the cells, orthonormal
``C``   `cores`              (C, pairs)    non-zero entries between wavelets, radiance
``d``    `direct`             (C, cells)    light that a cell returns to itself; it is fitted to
                                           keep it out of K, and then dropped: direct light is
                                           the floodlit image minus all other parts
======  ===================  ============  =========================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.methods.base import LevelImages
from rfpipe.methods.images import Pictures, planar_batches
from rfpipe.methods.states import joined
from rfpipe.transport.base import Transport
from rfpipe.transport.footprints import FootprintTransport, sparse_arrays
from rfpipe.transport.wavelet import Cells, WaveletTransport, cell_side

MOST_CELLS = 4096
"""Largest number of cells; the covariance of all pairs of them takes 64 MiB."""

# Light added before the root, as a share of the mean: dim pixels may exchange light too.
_DIM_LIGHT = 0.02


def residual_cells(shape: tuple[int, ...]) -> Cells:
    """Return the smallest cells of a ray domain of which there are at most `MOST_CELLS`."""
    return Cells(shape, cell_side(shape, MOST_CELLS))


def root_factor(light: Float) -> Float:
    """Compute the root of an image (C, rays), scaled to a mean of 1."""
    bright = np.maximum(light, 0)
    root = np.sqrt(bright + np.float32(_DIM_LIGHT) * bright.mean(axis=1, keepdims=True))
    mean = root.mean(axis=1, keepdims=True)
    factor: Float = np.divide(root, mean, out=np.zeros_like(root), where=mean > 0)
    return factor


@dataclass(frozen=True)
class CellPictures:
    """Pictures summed over the camera's cells, see `CameraCells.summed`.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The patterns.
    radiance, variance : ndarray of float32, shape (P, C, cells)
        Radiance over f. The variance is infinite where a cell has no known pixel.
    """

    lit: NDArray[np.bool_]
    radiance: Float
    variance: Float


@dataclass(frozen=True)
class CameraCells:
    """The camera's cells and their factor f.

    Attributes
    ----------
    cells : Cells
    known : ndarray of bool, shape (M,)
        Pixels that the pictures show.
    brightest : ndarray of float32, shape (C,)
        Maximum of the floodlit image, in radiance.
    factor : ndarray of float32, shape (C, M)
        f.
    """

    cells: Cells
    known: NDArray[np.bool_]
    brightest: Float
    factor: Float

    @classmethod
    def of(cls, cells: Cells, floodlit: Float, known: NDArray[np.bool_]) -> CameraCells:
        """Compute the factor from the floodlit image (C, M)."""
        brightest: Float = np.maximum(floodlit, 0).max(axis=1)
        return cls(cells, known, brightest, root_factor(floodlit))

    @classmethod
    def of_pictures(cls, shape: tuple[int, ...], pictures: Pictures) -> CameraCells:
        """Compute the factor from pictures; channels of noise alone are dark."""
        shining = [pictures.channel(index).has_light() for index in range(pictures.channels)]
        floodlit = pictures.floodlit * np.reshape(shining, (-1, 1))
        return cls.of(residual_cells(shape), floodlit, pictures.known)

    @cached_property
    def weight(self) -> Float:
        """Sums of f^2 over the known pixels of each cell, (C, cells)."""
        return np.ascontiguousarray(self.cells.total(self.factor**2 * self.known).T)

    def averaged(self, images: Float) -> Float:
        """Fit f times a constant in each cell to images.

        Parameters
        ----------
        images : ndarray of float32, shape (P, C, M)

        Returns
        -------
        ndarray of float32, shape (P, C, cells)
            The constants; 0 where a cell has no known pixel.
        """
        planes = [
            self._sums_over(weight, images[:, channel], self.factor[channel] * self.known)
            for channel, weight in enumerate(self.weight)
        ]
        return np.stack(planes, axis=1)

    def summed(self, lit: NDArray[np.bool_], radiance: Float, variance: Float) -> CellPictures:
        """Average pictures (P, C, M) of patterns (P, N) over cells."""
        variance = np.where(self.known, variance, 0)
        planes = [
            self._sums_over(weight**2, variance[:, channel], np.square(self.factor[channel]))
            for channel, weight in enumerate(self.weight)
        ]
        cell_variance = np.where(self.weight > 0, np.stack(planes, axis=1), np.float32(np.inf))
        return CellPictures(lit, self.averaged(radiance), cell_variance)

    def read(self, images: LevelImages, first: int = 0) -> CellPictures:
        """Read a level's images from index `first` on, a few at a time, and average them."""
        channels, rays = self.factor.shape
        lit = images.schedule.batch(first, images.schedule.count) > 0
        lit = lit.reshape(len(lit), -1)
        parts = [
            self.summed(lit[part], np.moveaxis(radiance, 0, 1), np.moveaxis(variance, 0, 1))
            for part, radiance, variance in planar_batches(images, channels, rays, first)
        ]
        return joined(parts, axis=0)

    def _sums_over(self, weight: Float, images: Float, factor: Float) -> Float:
        sums = self.cells.total(images * factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)


@dataclass(frozen=True)
class ProjectorCells:
    """The projector's cells and their factor g.

    Attributes
    ----------
    cells : Cells
    factor : ndarray of float32, shape (C, N)
        g; on coaxial rigs f.
    places : ndarray of float32, shape (cells, 2), optional
        Row and column, in the camera's cells, of the spot that each cell lights; None on coaxial
        rigs.
    """

    cells: Cells
    factor: Float
    places: Float | None

    @property
    def is_coaxial(self) -> bool:
        """True if these are the camera's cells."""
        return self.places is None


def coaxial_projector(camera: CameraCells) -> ProjectorCells:
    """Return the projector's cells of a coaxial rig."""
    return ProjectorCells(camera.cells, camera.factor, None)


@dataclass(frozen=True)
class Residual:
    """Residual light between wavelets.

    Attributes
    ----------
    pairs : ndarray of int32, shape (2, pairs)
        Wavelets of the camera and of the projector with a non-zero core.
    cores : ndarray of float32, shape (C, pairs)
        C, in radiance.
    projector_factor : ndarray of float32, shape (C, N)
        g; (C, 0) on coaxial rigs, where it is f.
    """

    pairs: NDArray[np.int32]
    cores: Float
    projector_factor: Float

    @property
    def is_coaxial(self) -> bool:
        """True on a coaxial rig, where each pair is stored once."""
        return not self.projector_factor.size

    def transport(self, camera: CameraCells, projector_shape: tuple[int, ...]) -> Transport:
        """Return the residual as a transport of pixels."""
        cells, channels = camera.cells, len(camera.factor)
        if self.is_coaxial:
            arrays = {
                "side": np.array([cells.side], np.int32),
                "factor": camera.factor,
                "pairs": self.pairs,
                "cores": self.cores,
            }
            return WaveletTransport(cells.shape, cells.shape, channels, [], arrays)
        from scipy.sparse import csr_array

        projector_cells, pixels = residual_cells(projector_shape), camera.known.size
        entries: Any = (np.ones(self.pairs.shape[1], np.float32), tuple(self.pairs))
        cores = csr_array(entries, shape=(cells.haar.size, projector_cells.haar.size))
        no_footprints: Any = csr_array((pixels, projector_cells.of_ray.size), dtype=np.float32)
        arrays = {
            **sparse_arrays("footprints", no_footprints, [no_footprints.data] * channels),
            **sparse_arrays("left", cells.functions()),
            **sparse_arrays("right", projector_cells.functions()),
            **sparse_arrays("cores", cores, list(self.cores)),
            "camera_factor": camera.factor,
            "projector_factor": self.projector_factor,
        }
        return FootprintTransport(cells.shape, projector_shape, channels, [], arrays)
