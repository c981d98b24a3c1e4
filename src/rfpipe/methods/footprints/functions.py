"""Functions and factors of indirect light, on the sides of the camera and of the projector.

Indirect light is ``diag(f) L S R^T diag(g)``. L are B-splines over a chart of the camera's rays
(`rfpipe.methods.footprints.charts`). No image shows the scene from the projector. Therefore the
footprints D map L and f to its side: a projector pixel has the mean value of the camera pixels that
it lights directly. With the direct light ``D 1`` and the floodlit image F,

    V = diag(1 / D^T 1) D^T
    b = (D^T 1) / (V F)              divided by its median
    v = b / (b + 0.15)               0 where b is at most 0.05
    R = diag(v) V L
    h = F - D 1                      at least 0.03 F
    f = h median(F / h)              the median over lit pixels, at most 20
    g = v (V f) + (1 - v) median(F)

b is the brightness of a projector pixel in the camera's image, relative to typical ones. Where the
camera does not see the pixel, R is 0, and its indirect light is left to the residual model. The
factor f equals F at a typical lit pixel; unlike F it has no edge at a shadow.

======  ==============================  ======  ====================================================
symbol  name in the code                shape   meaning and unit
======  ==============================  ======  ====================================================
``D``   `direct`                        (M, N)  footprints, radiance
``F``   `floodlit`                      (M,)    floodlit image, radiance
``V``   `CameraToProjector.means`       (N, M)  means over camera pixels
``v``   `CameraToProjector.visibility`  (N,)    0 to 1
``L``   `IndirectBasis.L`               (M, n)  functions over camera rays
``R``   `IndirectBasis.R`               (N, n)  functions over projector rays
``S``   `core_matrix`                   (n, n)  light between functions, inverse radiance
``f``   `camera_factor`                 (M,)    indirect light received, radiance
``g``   `projector_factor`              (N,)    indirect light sent, radiance
======  ==============================  ======  ====================================================

S is not symmetric. For each pair of functions (a, b) there are two unknowns: the symmetric part
``(S_ab + S_ba) / 2``, and the antisymmetric part ``(S_ab - S_ba) / 2``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.array_types import Float, Index
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.charts import ChartBasis
from rfpipe.methods.smooth_light import prior_areas
from rfpipe.transport.multiscale import MultiscaleBasis

if TYPE_CHECKING:
    from scipy.sparse import csr_array

# Relative brightness of projector pixels: at most this is invisible; this is half visible.
_INVISIBLE, _HALF_VISIBLE = 0.05, 0.15
# Expected size of the antisymmetric part of S, relative to the symmetric part.
_ANTISYMMETRY = 0.2


@dataclass(frozen=True)
class CameraToProjector:
    """Map of functions over camera rays to functions over projector rays.

    Attributes
    ----------
    means : csr_array of float32, shape (N, M)
        V; rows have the sum 1, or 0 where no camera pixel sees the projector pixel.
    visibility : ndarray of float32, shape (N,)
        v, 0 to 1.
    shared_rays : bool
        True if camera and projector have the same rays, so that V is the identity.
    """

    means: csr_array[np.float32]
    visibility: Float
    shared_rays: bool = False


def camera_to_projector(direct: csr_array[np.float32], floodlit: Float) -> CameraToProjector:
    """Compute V and v from the footprints (M, N) and the floodlit image (M,)."""
    from scipy.sparse import diags_array

    sent: Float = np.asarray(direct.sum(axis=0)).ravel()
    inverse = np.divide(1, sent, out=np.zeros_like(sent), where=sent > 0)
    means = (diags_array(inverse) @ direct.T).tocsr().astype(np.float32)
    typical = means @ floodlit
    brightness = np.divide(sent, typical, out=np.zeros_like(sent), where=typical > 0)
    # several projector pixels that one camera pixel covers share its light
    is_bright = brightness > 0
    median = float(np.median(brightness[is_bright])) if is_bright.any() else 1.0
    brightness = brightness / median
    visibility = np.where(
        brightness > _INVISIBLE, brightness / (brightness + _HALF_VISIBLE), 0
    ).astype(np.float32)
    return CameraToProjector(means, visibility)


def identity_map(size: int) -> CameraToProjector:
    """Return the map between the two sides of a coaxial rig with `size` rays."""
    from scipy.sparse import eye_array

    return CameraToProjector(
        eye_array(size, dtype=np.float32).tocsr(), np.ones(size, np.float32), True
    )


def camera_factor(direct: csr_array[np.float32], floodlit: Float) -> Float:
    """Compute f from the footprints (M, N) and the floodlit image (M,)."""
    lit: Float = np.asarray(direct.sum(axis=1)).ravel()
    indirect = np.maximum(floodlit - lit, 1e-6 * floodlit)
    mask = (lit > 0.5 * floodlit) & (indirect > 0)
    ratio = np.clip(np.median(floodlit[mask] / indirect[mask]), 1, 20.0) if mask.any() else 1.0
    factor: Float = (np.clip(indirect, 0.03 * floodlit, floodlit) * ratio).astype(np.float32)
    return factor


def projector_factor(mapping: CameraToProjector, factor: Float, floodlit: Float) -> Float:
    """Compute g from f, (M,), and the floodlit image (M,)."""
    positive = floodlit[floodlit > 0]
    typical = float(np.median(positive)) if len(positive) else 0.0
    visibility = mapping.visibility
    light: Float = visibility * (mapping.means @ factor) + (1 - visibility) * np.float32(typical)
    return light.astype(np.float32)


@dataclass(frozen=True)
class IndirectBasis:
    """Functions of indirect light on both sides, and the pairs of functions that exchange light.

    Attributes
    ----------
    camera : MultiscaleBasis
        Functions over the camera rays, and the pairs.
    projector : RayDomain
    mapping : CameraToProjector
    """

    camera: MultiscaleBasis
    projector: RayDomain
    mapping: CameraToProjector

    @property
    def core_count(self) -> int:
        """Number of unknowns of S: symmetric parts of all pairs, then antisymmetric parts."""
        return 2 * len(self.camera.first)

    @cached_property
    def L(self) -> csr_array[np.float32]:  # noqa: N802
        """Functions over the camera rays, (M, n)."""
        return self.camera.weights

    @cached_property
    def R(self) -> csr_array[np.float32]:  # noqa: N802
        """Functions over the projector rays, (N, n)."""
        from scipy.sparse import diags_array

        if isinstance(self.camera, ChartBasis):
            arriving = self.camera.at(np.asarray(self.mapping.means @ self.camera.places))
        else:
            arriving = self.mapping.means @ self.L
        visible: Any = diags_array(self.mapping.visibility) @ arriving
        matrix: csr_array[np.float32] = visible.tocsr().astype(np.float32)
        return matrix

    @cached_property
    def R_by_view(self) -> list[csr_array[np.float32]]:  # noqa: N802
        """Functions over the rays of each projector view, (N / views, n)."""
        views, size = self.projector.views, self.projector.rays_per_image
        if views == 1:
            return [self.R]
        return [self.R[view * size : (view + 1) * size] for view in range(views)]

    @property
    def _projector_density(self) -> float:
        """Number of projector rays, in all views, that light the surface of a camera ray."""
        if isinstance(self.camera, ChartBasis):
            return float(self.projector.views)
        return float(self.projector.size / np.prod(self.camera.shape))

    def prior_deviations(self, indirect: float, floodlit: float) -> Float:
        """Compute the standard deviations of the cores before any fit, (core_count,).

        Parameters
        ----------
        indirect : float
            Mean indirect light of the floodlit image, radiance.
        floodlit : float
            Mean of the floodlit image, radiance.
        """
        area = prior_areas(self.camera)
        level = indirect / (max(floodlit, float(np.finfo(np.float32).tiny)) ** 2)
        symmetric = level / (area * self._projector_density)
        return np.concatenate([symmetric, _ANTISYMMETRY * symmetric]).astype(np.float32)

    @cached_property
    def core_groups(self) -> Index:
        """Number of each core's group, (core_count,).

        Cores of a group share one standard deviation: pairs of the same two scales, at distances
        that differ by less than half of the coarser scale. Symmetric and antisymmetric parts are
        in different groups.
        """
        basis = self.camera
        scales = basis.scales[basis.first], basis.scales[basis.second]
        key = np.zeros(len(basis.first), np.int64)
        for scale in (np.maximum(*scales), np.minimum(*scales)):
            # in quarters of an octave
            key = key * 1024 + np.rint(4 * np.log2(scale)).astype(np.int64)
        distance = np.minimum(2 * basis.distances() / np.maximum(*scales), 255).astype(np.int64)
        key = key * 256 + distance
        group: Index = np.unique(np.concatenate([key, key + (1 << 40)]), return_inverse=True)[1]
        return group

    def core_matrix(self, cores: Float) -> csr_array[np.float32]:
        """Return S, (n, n), from the cores (core_count,)."""
        from scipy.sparse import coo_array

        basis, (symmetric, antisymmetric) = self.camera, np.split(cores, 2)
        off_diagonal = basis.first != basis.second
        rows = np.concatenate([basis.first, basis.second[off_diagonal]])
        columns = np.concatenate([basis.second, basis.first[off_diagonal]])
        values = np.concatenate(
            [symmetric + antisymmetric, (symmetric - antisymmetric)[off_diagonal]]
        ).astype(np.float32)
        return coo_array((values, (rows, columns)), shape=(len(basis), len(basis))).tocsr()
