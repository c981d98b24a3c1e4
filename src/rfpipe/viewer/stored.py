"""Pages of stored transports, with facts from their stores."""

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
from rfpipe.viewer.build import Comparison, PageContent, WrittenPage, write_view

__all__ = ["view_of", "write_acquisition"]

# Maximum stored size of two transports on one page, in bytes.
_MAX_BYTES_OF_TWO = 15 * 10**6


def view_of(
    path: Path | Place, title: str | None = None, comparison: Comparison | None = None
) -> tuple[PageContent, dict[str, Any]]:
    """Return the view of a stored transport, and the store's attributes.

    Parameters
    ----------
    path : Path or Place
        A ``transport.zarr``.
    title : str, optional
        By default scene and method.
    comparison : Comparison, optional

    Raises
    ------
    StoreError
        If there is no transport at this path.
    """
    transport = open_transport(path)
    attributes = open_arrays(path).attributes
    scene, method = (str(attributes.get(name, "")) for name in ("scene", "method"))
    default_title = " by ".join(filter(None, (scene, method))) or Path(str(path)).stem
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
    rows = [(name, value) for name, value in facts.items() if value]
    return PageContent(
        transport, title or default_title, facts=rows, comparison=comparison
    ), attributes


def _rays(shape: tuple[int, ...]) -> str:
    return f"{' x '.join(map(str, shape))}, {math.prod(shape):,} rays"


def write_acquisition(store: Path, alternatives: Sequence[Path], page: Path) -> WrittenPage:
    """Write the page of a run's transport, with the smallest alternative if it fits.

    Parameters
    ----------
    store : Path
        A ``transport.zarr``.
    alternatives : sequence of Path
        Transports of the same scene by different methods.
    page : Path
        See `rfpipe.viewer.write_view`.
    """
    view, _ = view_of(store)
    shapes = view.transport.camera_shape, view.transport.projector_shape
    candidates = (view_of(path)[0] for path in alternatives)
    comparable = (
        candidate
        for candidate in candidates
        if (candidate.transport.camera_shape, candidate.transport.projector_shape) == shapes
    )
    smallest = min(comparable, key=lambda candidate: candidate.transport.nbytes, default=None)
    if (
        smallest is not None
        and view.transport.nbytes + smallest.transport.nbytes < _MAX_BYTES_OF_TWO
    ):
        view = replace(view, comparison=Comparison(smallest.transport, smallest.title))
    return write_view(view, page)
