"""Transports in stores as views: what their pages say of them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from rfpipe.store import open_arrays
from rfpipe.store.places import Place
from rfpipe.transport import open_transport
from rfpipe.transport.base import estimates
from rfpipe.viewer.build import Compared, View, Written, write_view

__all__ = ["view_of", "write_acquisition"]

# Bytes stored of two transports on one page.
_TOGETHER = 15 * 10**6


def view_of(
    path: Path | Place, title: str | None = None, compared: Compared | None = None
) -> tuple[View, dict[str, Any]]:
    """Return the view of a stored transport, and what the store says of it.

    Parameters
    ----------
    path : Path or Place
        A ``transport.zarr``.
    title : str, optional
        By default scene and method.
    compared : Compared, optional

    Raises
    ------
    StoreError
        If there is no transport.
    """
    transport = open_transport(path)
    attributes = open_arrays(path).attributes
    scene, method = (str(attributes.get(name, "")) for name in ("scene", "method"))
    named = " by ".join(filter(None, (scene, method))) or Path(str(path)).stem
    patterns = sum(int(row.get("patterns", 0)) for row in transport.level_rows)
    steps = estimates(transport.level_rows)
    error = f"{100 * steps[-1]['estimated_error']:.2g} % by the method's estimate" if steps else ""
    facts = {
        "Scene": scene,
        "Method": method,
        "Camera": _rays(transport.camera_shape),
        "Projector": _rays(transport.projector_shape),
        "Patterns": f"{patterns:,}" if patterns else "",
        "Stored": f"{transport.nbytes / 1e6:.3g} MB",
        "Error of relit pictures": error,
    }
    about = [(name, value) for name, value in facts.items() if value]
    return View(transport, title or named, about=about, compared=compared), attributes


def _rays(shape: tuple[int, ...]) -> str:
    return f"{' x '.join(map(str, shape))}, {math.prod(shape):,} rays"


def write_acquisition(store: Path, others: Sequence[Path], page: Path) -> Written:
    """Write the page of a run's transport, with the smallest of others to compare, if it has room.

    Parameters
    ----------
    store : Path
        A ``transport.zarr``.
    others : sequence of Path
        Those of the same scene by other methods.
    page : Path
        See `rfpipe.viewer.write_view`.
    """
    view, _ = view_of(store)
    shapes = view.transport.camera_shape, view.transport.projector_shape
    beside = (view_of(other)[0] for other in others)
    alike = (
        each
        for each in beside
        if (each.transport.camera_shape, each.transport.projector_shape) == shapes
    )
    smallest = min(alike, key=lambda each: each.transport.nbytes, default=None)
    if smallest is not None and view.transport.nbytes + smallest.transport.nbytes < _TOGETHER:
        view = replace(view, compared=Compared(smallest.transport, smallest.title))
    return write_view(view, page)
