"""Transports of a collection as one field: positions x camera x projector."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rfpipe.errors import InputError, StoreError
from rfpipe.pictures.files import natural
from rfpipe.store.location import locate
from rfpipe.store.places import Place
from rfpipe.transport.algebra import MEMORY_BUDGET
from rfpipe.transport.base import Transport
from rfpipe.transport.storage import STORE_NAME, open_transport, transports_in

__all__ = ["Collection", "open_collection"]


class Collection(Mapping[str, Transport]):
    """Transports by the names of their scenes, such as the positions of a camera or a lamp.

    Each transport is opened at each use. Create a collection with `open_collection`.
    """

    def __init__(self, places: Mapping[str, Path | Place], memory_budget: int) -> None:
        self._places = dict(places)
        self._memory_budget = memory_budget

    def __getitem__(self, name: str) -> Transport:
        return open_transport(self._places[name], self._memory_budget)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of positions, camera rays, projector rays; InputError if transports differ."""
        shapes = {(it.camera_shape, it.projector_shape): name for name, it in self.items()}
        if len(shapes) > 1:
            sizes = "; ".join(f"{name}: {camera}, {lit}" for (camera, lit), name in shapes.items())
            raise InputError(
                f"the transports have different rays, so that they are not one field: {sizes}"
            )
        (camera, projector), *_ = shapes
        return (len(self), *camera, *projector)

    def relight(self, pattern: ArrayLike) -> Iterator[tuple[str, NDArray[np.float32]]]:
        """Yield name and picture of each position under one pattern, as `Transport.relight`."""
        for name, transport in self.items():
            yield name, transport.relight(np.asarray(pattern))


def open_collection(
    path: str | Path, method: str | None = None, memory_budget: int = MEMORY_BUDGET
) -> Collection:
    """Open the transports of a run, one for each scene, by the names of the scenes.

    They are sorted by name, with numbers in names by their value: left_2 before left_10.

    Parameters
    ----------
    path : path or address
        The ``results`` of a run, the output of ``rfpipe collection pack``, or a zip file of either,
        local or on a server.
    method : str, optional
        Needed if scenes have transports by several methods.
    memory_budget : int
        Bytes of each transport, see `rfpipe.open_transport`.

    Raises
    ------
    StoreError
        If there is no transport or no transport by this method, or `path` is the folder of a scene.
    """
    place = locate(path)
    stores: dict[str, dict[str, str]] = {}
    for name in transports_in(place):
        *_, scene, made_by = ["", "", *name.removesuffix(STORE_NAME).strip("/").split("/")]
        if not scene:
            raise StoreError(
                f"{place}: holds transports without folders of scenes; give the run's results, "
                "which these lie in, or open one with rfpipe.open_transport"
            )
        stores.setdefault(made_by, {})[scene] = name
    methods = ", ".join(sorted(stores))
    if method is None and len(stores) > 1:
        raise StoreError(
            f"{place}: scenes have transports by {methods}; say which, as in "
            f"open_collection(..., method={min(stores)!r})"
        )
    chosen = stores.get(method or methods)
    if chosen is None:
        what = f"has no transports{f' by {method}' if method else ''}"
        advice = f"there are some by {methods}" if stores else "give the results of a run"
        raise StoreError(f"{place}: {what}; {advice}")
    scenes = sorted(chosen, key=natural)
    return Collection({scene: place / chosen[scene] for scene in scenes}, memory_budget)
