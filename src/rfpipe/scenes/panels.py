"""Rectangles with a regular grid of texels: the surfaces of scenes that several views look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rfpipe.scenes.diffuse import Patches
from rfpipe.scenes.geometry import Points, Rectangle, Vector

__all__ = ["Panel", "TexelGrid"]


@dataclass(frozen=True)
class Panel(Rectangle):
    """A rectangle with texels.

    Parameters
    ----------
    name, centre, edge_u, edge_v
        As of any `Rectangle`.
    surface
        ``"white"`` or ``"texture"``.
    tint
        Factors of the albedo in red, green and blue; grey takes the middle one.
    encloses
        Whether it bounds the room, so that nothing of the scene is behind it.
    """

    surface: str
    tint: Vector
    encloses: bool = False


class TexelGrid:
    """The texels of some panels, numbered panel by panel and row by row.

    Parameters
    ----------
    panels
        The panels.
    pitch
        Side of a texel, scene units; a panel has a whole number of texels either way, so that
        they may be a little smaller or larger.
    """

    def __init__(self, panels: Sequence[Panel], pitch: float) -> None:
        self.panels = tuple(panels)
        sides = 2 * np.linalg.norm([(panel.edge_v, panel.edge_u) for panel in panels], axis=2)
        self.shapes: NDArray[np.int64] = np.maximum(1, np.rint(sides / pitch)).astype(np.int64)
        counts = self.shapes.prod(axis=1)
        self.starts: NDArray[np.int64] = np.concatenate([[0], np.cumsum(counts)])
        self._areas = sides.prod(axis=1) / counts

    def overlaps(
        self, panel: NDArray[np.int64], place: NDArray[np.float64], width: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Share boxes out between the texels that they overlap, two along either edge.

        Parameters
        ----------
        panel
            int64 (n,): the panel on which each box lies.
        place, width
            float64 (n, 2): centres and widths along edge_u and edge_v, on which a panel goes from
            -1 to 1. Boxes broader than a texel count as one texel broad, parts beyond an edge as
            at the edge.

        Returns
        -------
        texel, share
            int64 and float64 (n, 4): texels and what they have of each box; shares add up to 1.
        """
        counts = self.shapes[panel, ::-1]
        middle = (place + 1) / 2 * counts  # in texels
        half = np.clip(width * counts / 2, np.finfo(np.float64).tiny, 1) / 2
        low = np.floor(middle - half)
        upper = np.clip((middle + half - low - 1) / (2 * half), 0, 1)
        shares = np.stack([1 - upper, upper])
        column, row = np.clip(np.stack([low, low + 1]), 0, counts - 1).astype(np.int64).T
        start = self.starts[panel, None]
        texel = [start + row[:, [i]] * counts[:, :1] + column for i in (0, 1)]
        share = [shares[i, :, 1:] * shares[:, :, 0].T for i in (0, 1)]
        return np.concatenate(texel, axis=1), np.concatenate(share, axis=1)

    def points(self, texels: NDArray[np.int64]) -> Points:
        """The centres of some texels, given by ascending number."""
        panel = np.searchsorted(self.starts, texels, "right") - 1
        row, column = np.divmod(texels - self.starts[panel], self.shapes[panel, 1])
        v, u = (2 * (np.stack([row, column]) + 0.5) / self.shapes[panel].T - 1)[..., None]
        centre, edge_u, edge_v = (
            np.array([getattr(panel, name) for panel in self.panels])[panel]
            for name in ("centre", "edge_u", "edge_v")
        )
        areas = self._areas[panel]
        return Points(
            tuple(panel.plane if panel.encloses else panel for panel in self.panels),
            panel,
            centre + u * edge_u + v * edge_v,
            areas,
            float(areas.mean()),
        )

    def patches(self, texels: NDArray[np.int64], side: int) -> Patches:
        """Take texels, given by ascending number, together in squares of `side` x `side`."""
        points = self.points(texels)
        columns = self.shapes[points.surface, 1]
        row, column = np.divmod(texels - self.starts[points.surface], columns)
        # the number of the texel in its square's corner tells squares apart
        corner = texels - row % side * columns - column % side
        _, first, patch = np.unique(corner, return_index=True, return_inverse=True)
        count = np.bincount(patch)
        centres = np.stack([np.bincount(patch, x) / count for x in points.positions.T], axis=1)
        areas = np.bincount(patch, points.areas).astype(np.float64)
        surface = points.surface[first]
        clamp = float(areas.mean())
        return Patches(Points(points.surfaces, surface, centres, areas, clamp), patch)
