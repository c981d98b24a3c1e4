"""The residual model: light that another model of the transport leaves unexplained.

    T = T0 + f A K A^T f - diag(e)       coaxial rigs; K is symmetric, e = f A K A^T f 1
    T = T0 + f A K A'^T g                other rigs

T0 is the transport of any model: near/far, footprints, or a hierarchy. A and A' divide the pixels
of the camera and of the projector into cells, at most 4096 on either side. K is the exchange of
light between cells, described by coefficients X of Haar wavelets, ``K = W^T X W'``. Its entries
have any sign; negative entries reduce light of T0.

The factors f and g carry the texture within cells. Light between two surfaces is proportional to
the albedo of both. The floodlit image is the albedo times the incident light; the albedo alone
isn't known. A root of the floodlit image is a compromise between it and a constant, which isn't
derived. f and g are the roots of an image plus 2 % of its mean, scaled to a mean of 1
(`root_factor`).

On coaxial rigs direct light is the floodlit image minus all other parts. It is computed again once
there is a residual (`near_far_transport`), which subtracts e, the residual under full light. The
fit to cells has an unknown d for the direct light of each cell, which keeps direct light out of K
(`rfpipe.methods.residual.posterior`). It is not part of T.

=========  ==================  ============  =======================================================
symbol     name in the code    shape         meaning and unit
=========  ==================  ============  =======================================================
``T0``     `model`             (M, N)        transport of the model, between M camera and N
                                             projector pixels, radiance
``f``      `factor`            (C, M)        root of the floodlit image of each channel, no unit
``g``      `projector_factor`  (C, N)        root of the light that each projector pixel sends
``A, A'``  `cells.of_ray`      (M, M'),      1 where a pixel is in a cell, of M' camera and N'
                               (N, N')       projector cells
``K``                          (M', N')      exchange of light between cells, radiance
``e``                          (C, M)        residual under full light, radiance
``W, W'``  `cells.haar`        (m, M'),      Haar transforms of the cells, orthonormal
                               (n, N')
``X``      `cores`             (C, pairs)    coefficients of the pairs of wavelets where they aren't
                                             0, for C channels, radiance
=========  ==================  ============  =======================================================
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
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
"""Largest number of cells; one prior variance for each pair of cells takes 64 MiB."""

# Light added before the root, as a share of the mean: dim pixels may exchange light too.
_DIM_LIGHT = 0.02


@lru_cache(maxsize=4)
def residual_cells(shape: tuple[int, ...]) -> Cells:
    """Divide a ray domain into the smallest cells of which there are at most `MOST_CELLS`."""
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
    """Pictures fitted to the camera's cells, see `CameraCells.fitted_to_cells`.

    Attributes
    ----------
    lit : ndarray of bool, shape (P, N)
        The P patterns.
    radiance, variance : ndarray of float32, shape (P, C, M')
        Radiance over f, and its variance, which is infinite where a cell has no known pixel.
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
        """Sums of f^2 over the known pixels of each cell, (C, M')."""
        return np.ascontiguousarray(self.cells.total(self.factor**2 * self.known).T)

    def fitted_to_cells(self, images: Float) -> Float:
        """Fit a constant times f to the known pixels of each cell, by least squares.

        For an image c, the constant of a cell is ``sum f c / sum f^2``, with sums over its known
        pixels.

        Parameters
        ----------
        images : ndarray of float32, shape (P, C, M)

        Returns
        -------
        ndarray of float32, shape (P, C, M')
            The constants; 0 where a cell has no known pixel.
        """
        planes = [
            self._sums_over_weight(weight, images[:, channel], self.factor[channel] * self.known)
            for channel, weight in enumerate(self.weight)
        ]
        return np.stack(planes, axis=1)

    def cell_pictures(
        self, lit: NDArray[np.bool_], radiance: Float, variance: Float
    ) -> CellPictures:
        """Fit the cells to pictures (P, C, M) of patterns (P, N), with their variances."""
        variance = np.where(self.known, variance, 0)
        planes = [
            self._sums_over_weight(weight**2, variance[:, channel], np.square(self.factor[channel]))
            for channel, weight in enumerate(self.weight)
        ]
        cell_variance = np.where(self.weight > 0, np.stack(planes, axis=1), np.float32(np.inf))
        return CellPictures(lit, self.fitted_to_cells(radiance), cell_variance)

    def read(self, images: LevelImages, first: int = 0) -> CellPictures:
        """Read a level's images from index `first` on, a few at a time, and fit the cells."""
        channels, rays = self.factor.shape
        lit = images.schedule.batch(first, images.schedule.count) > 0
        lit = lit.reshape(len(lit), -1)
        parts = [
            self.cell_pictures(lit[part], np.moveaxis(radiance, 0, 1), np.moveaxis(variance, 0, 1))
            for part, radiance, variance in planar_batches(images, channels, rays, first)
        ]
        return joined(parts, axis=0)

    def _sums_over_weight(self, weight: Float, images: Float, factor: Float) -> Float:
        """Divide the sums of images times a factor over each cell by a weight of each cell."""
        sums = self.cells.total_of_products(images, factor).T
        return np.divide(sums, weight, out=np.zeros(sums.shape, np.float32), where=weight > 0)


@dataclass(frozen=True)
class ProjectorCells:
    """The projector's cells and their factor g.

    Attributes
    ----------
    cells : Cells
    factor : ndarray of float32, shape (C, N)
        g; on coaxial rigs f.
    places : ndarray of float32, shape (N', 2), optional
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
        X, in radiance.
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
