"""Prior of an acquisition: the transport of an earlier one with the same rig."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from rfpipe.errors import InputError, StoreError
from rfpipe.methods.base import MethodDescription
from rfpipe.store.arrays import open_arrays
from rfpipe.store.places import METADATA
from rfpipe.transport import Transport, open_transport
from rfpipe.transport.filling import looks_coaxial
from rfpipe.transport.storage import find_transport

_REMEDY = (
    "give the folder transport.zarr of an earlier acquisition with the same rig, relative to the "
    "run's folder, or leave prior out"
)


@dataclass(frozen=True)
class Prior:
    """Transport of an earlier acquisition with the same rig.

    Attributes
    ----------
    transport : Transport
    path : str, optional
        Its folder as in the settings; None for a transport in memory.
    digest : str, optional
        Digest of its arrays and attributes; None for a transport in memory.
    """

    transport: Transport
    path: str | None = None
    digest: str | None = None

    @cached_property
    def is_coaxial(self) -> bool:
        """True if the transport is symmetric: the rig is coaxial."""
        return looks_coaxial(self.transport)

    def describe(self) -> dict[str, Any]:
        """Describe the prior as plain data, for fingerprints and manifests."""
        if self.path is None:
            return {"transport": repr(self.transport)}
        return {"path": self.path, "digest": self.digest}

    def check(
        self,
        description: MethodDescription,
        rays: tuple[tuple[int, ...], tuple[int, ...], int],
    ) -> None:
        """Raise InputError if the method can't use a prior, or the prior is of another rig.

        Parameters
        ----------
        description : MethodDescription
        rays : (tuple of int, tuple of int, int)
            Shapes of the camera's and of the projector's rays, and number of channels.
        """
        method = description.title.lower()
        if not description.uses_prior:
            raise InputError(
                f"{method} can't begin with a prior; use auto, near_far or footprints, or leave "
                "prior out"
            )
        it = self.transport
        if (it.camera_shape, it.projector_shape, it.channels) != rays:
            raise InputError(
                f"the prior is {it}, but the rig has camera {rays[0]}, projector {rays[1]}, "
                f"{rays[2]} channels; a prior is a transport of the same rig",
                place=self.path,
            )
        if description.needs_coaxial_rig and not self.is_coaxial:
            raise InputError(
                f"the prior isn't symmetric, but {method} needs a coaxial rig; use auto or "
                "footprints",
                place=self.path,
            )


def prior_file(path: str) -> Path:
    """Return the file of a stored prior that changes with its content.

    Raises
    ------
    InputError
        If there is no transport in a folder of this path.
    """
    if not Path(path).is_dir():
        raise InputError("there is no folder of a prior", value=path, remedy=_REMEDY)
    try:
        folder = find_transport(path)
    except StoreError as error:
        raise InputError(
            "there is no single transport in the folder of the prior", value=path, remedy=_REMEDY
        ) from error
    if not isinstance(folder, Path) or not (folder / METADATA).is_file():
        raise InputError("the folder of the prior isn't a transport", value=path, remedy=_REMEDY)
    return folder / METADATA


def read_prior(path: str) -> Prior:
    """Open a stored prior; its arrays are read when first used.

    Raises
    ------
    InputError
        If there is no transport in a folder of this path.
    StoreError
        If its attributes are damaged, or a later version of rfpipe wrote it.
    """
    folder = prior_file(path).parent
    return Prior(open_transport(folder), path, open_arrays(folder).digest)
