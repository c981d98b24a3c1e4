"""Functions and scale factors of indirect light, on the sides of the camera and of the projector.

Indirect light is ``diag(f) L S R^T diag(g)``. L are B-splines over a chart of the camera's rays
(`rfpipe.methods.footprints.charts`). No image shows the scene from the projector. Therefore the
footprints D map L and f to its side: a projector pixel has the mean value of the camera pixels that
it lights directly. With the direct light ``D 1`` and the floodlit image F,

    V = diag(1 / D^T 1) D^T
    brightness = (D^T 1) / (V F)                   divided by its median
    v = brightness / (brightness + 0.15)           0 where the brightness is at most 0.05
    R = diag(v) V L                                one projector view
    R = diag(v) L(V places)                        several views
    h = F - D 1                                    at least 0.03 F, at most F
    f = h median(F / (F - D 1))                    the median from 1 to 20, over the pixels where
                                                   most light is direct: D 1 > F / 2
    g = v (V f) + (1 - v) median(F)                the median over F > 0

With several views, L are functions of places on a chart, and R has their values at the mean places
of the camera rays that each projector ray lights. The brightness of a projector pixel is its
direct light in the camera's image, relative to the floodlit radiance of the camera pixels that it
lights. Where the camera does not see it, R is 0, and its indirect light is left to the residual
model.

f and g are not light, but factors proportional to it: f is proportional to the indirect light of
the floodlit image, and equals F at a typical pixel with mostly direct light. Unlike F it has no
edge at a shadow. S has the remaining scale.

======  ==============================  ======  ====================================================
symbol  name in the code                shape   meaning and unit
======  ==============================  ======  ====================================================
``D``   `direct`                        (M, N)  footprints, radiance
``F``   `floodlit`                      (M,)    floodlit image, radiance
``V``   `CameraToProjector.means`       (N, M)  means over camera rays
``v``   `CameraToProjector.visibility`  (N,)    0 to 1
``L``   `IndirectBasis.L`               (M, n)  functions over camera rays
``R``   `IndirectBasis.R`               (N, n)  functions over projector rays
``S``   `IndirectBasis.core_matrix`     (n, n)  cores: light between functions, inverse radiance
``h``   `indirect`                      (M,)    estimate of indirect light, radiance
``f``   `camera_factor`                 (M,)    scale factor of each camera ray, radiance
``g``   `projector_factor`              (N,)    scale factor of each projector ray, radiance
======  ==============================  ======  ====================================================

A *core* is an entry of S, which is sparse and not symmetric. For each pair (a, b) of functions that
exchange light, the fit has two unknowns, the *core parts*: the symmetric part
``(S_ab + S_ba) / 2``, and the antisymmetric part ``(S_ab - S_ba) / 2``. An array of core parts has
the symmetric parts of all pairs, then their antisymmetric parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from rfpipe.array_types import TINY, Float, Index
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


def camera_to_projector(
    direct: Iterable[csr_array[np.float32]], floodlit: Float
) -> CameraToProjector:
    """Compute V and v from the footprints on each projector view, and the floodlit image (M,)."""
    from scipy.sparse import diags_array, vstack

    transposed: Any = vstack([on_view.T.tocsr() for on_view in direct])
    light: Float = np.asarray(transposed.sum(axis=1)).ravel()
    inverse = np.divide(1, light, out=np.zeros_like(light), where=light > 0)
    means = (diags_array(inverse) @ transposed).tocsr().astype(np.float32)
    typical = means @ floodlit
    brightness = np.divide(light, typical, out=np.zeros_like(light), where=typical > 0)
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


def camera_factor(direct_light: Float, floodlit: Float) -> Float:
    """Compute f from ``D 1`` and the floodlit image, (M,) each."""
    indirect = np.maximum(floodlit - direct_light, 1e-6 * floodlit)
    is_mostly_direct = (direct_light > 0.5 * floodlit) & (indirect > 0)
    ratios = floodlit[is_mostly_direct] / indirect[is_mostly_direct]
    ratio = np.clip(np.median(ratios), 1, 20.0) if len(ratios) else 1.0
    factor: Float = (np.clip(indirect, 0.03 * floodlit, floodlit) * ratio).astype(np.float32)
    return factor


def projector_factor(mapping: CameraToProjector, factor: Float, floodlit: Float) -> Float:
    """Compute g, (N,), from f, (M,), and the floodlit image (M,)."""
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
    def part_count(self) -> int:
        """Number of core parts: two for each pair of functions."""
        return 2 * len(self.camera.first)

    @cached_property
    def L(self) -> csr_array[np.float32]:  # noqa: N802
        """Functions over the camera rays, (M, n)."""
        return self.camera.weights

    @cached_property
    def R(self) -> csr_array[np.float32]:  # noqa: N802
        """Functions over the projector rays, (N, n)."""
        from scipy.sparse import diags_array

        if self.mapping.shared_rays:
            return self.L
        if isinstance(self.camera, ChartBasis):
            mapped = self.camera.at(np.asarray(self.mapping.means @ self.camera.places))
        else:
            mapped = self.mapping.means @ self.L
        visible: Any = diags_array(self.mapping.visibility) @ mapped
        matrix: csr_array[np.float32] = visible.tocsr().astype(np.float32)
        return matrix

    @property
    def R_by_view(self) -> Iterator[csr_array[np.float32]]:  # noqa: N802
        """Functions over the rays of each projector view, (N / views, n)."""
        views, size = self.projector.views, self.projector.rays_per_image
        if views == 1:
            return iter([self.R])
        return (self.R[view * size : (view + 1) * size] for view in range(views))

    @property
    def _rays_per_surface_point(self) -> float:
        """Number of projector rays, in all views, that light the surface point of a camera ray."""
        if isinstance(self.camera, ChartBasis):
            return float(self.projector.views)
        return float(self.projector.size / np.prod(self.camera.shape))

    def prior_deviations(self, indirect: float, floodlit: float) -> Float:
        """Compute the standard deviations of the core parts before any fit, (part_count,).

        Parameters
        ----------
        indirect : float
            Mean indirect light of the floodlit image, radiance.
        floodlit : float
            Mean of the floodlit image, radiance.
        """
        area = prior_areas(self.camera)
        # f and g are about F, so that S is about indirect light over F^2
        mean_core = indirect / (max(floodlit, TINY) ** 2)
        symmetric = mean_core / (area * self._rays_per_surface_point)
        return np.concatenate([symmetric, _ANTISYMMETRY * symmetric]).astype(np.float32)

    @cached_property
    def part_groups(self) -> Index:
        """Number of each core part's group, (part_count,).

        Core parts of a group share one standard deviation: their pairs have the same two scales,
        and distances that differ by less than half of the coarser scale. A scale is the spacing of
        functions in pixels. Symmetric and antisymmetric parts are in different groups.
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

    def core_matrix(self, core_parts: Float) -> csr_array[np.float32]:
        """Return S, (n, n), from the core parts (part_count,)."""
        from scipy.sparse import coo_array

        basis, (symmetric, antisymmetric) = self.camera, np.split(core_parts, 2)
        off_diagonal = basis.first != basis.second
        rows = np.concatenate([basis.first, basis.second[off_diagonal]])
        columns = np.concatenate([basis.second, basis.first[off_diagonal]])
        values = np.concatenate(
            [symmetric + antisymmetric, (symmetric - antisymmetric)[off_diagonal]]
        ).astype(np.float32)
        return coo_array((values, (rows, columns)), shape=(len(basis), len(basis))).tocsr()
