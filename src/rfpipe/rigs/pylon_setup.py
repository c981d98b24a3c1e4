"""A Basler camera's settings, as its driver pylon reaches them."""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from rfpipe.errors import CaptureError, installing
from rfpipe.rigs.cameras.genicam import RefusedError, Value

__all__ = ["PylonNodes", "load_pylon", "said"]


@dataclass(frozen=True)
class PylonNodes:
    """An `rfpipe.rigs.cameras.genicam.Nodes`.

    Parameters
    ----------
    camera : pypylon.pylon.InstantCamera
        Open.
    """

    camera: Any

    def is_writable(self, name: str) -> bool:
        """Tell whether the camera has the setting, and takes values for it now."""
        return bool(load_pylon()[1].IsWritable(getattr(self.camera, name)))

    def write(self, name: str, value: Value) -> Value:
        """Make one setting, or say what the camera has against it."""
        node = getattr(self.camera, name)
        try:
            node.Value = value
            taken: Value = node.Value
        except (load_pylon()[1].GenericException, TypeError) as error:
            raise RefusedError(
                f"camera: refuses {name} = {value}: {said(error)}{_choices(node)}"
            ) from error
        return taken

    def execute(self, name: str) -> None:
        """Have the camera do what a command says."""
        getattr(self.camera, name).Execute()

    def bounds(self, name: str) -> tuple[float, float]:
        """Return the least and the largest value of a number."""
        node = getattr(self.camera, name)
        return node.Min, node.Max

    def number(self, name: str) -> float | None:
        """Return a number; None where the camera doesn't tell it."""
        with suppress(Exception):
            return float(getattr(self.camera, name).Value)
        return None

    def choices(self, name: str) -> tuple[str, ...]:
        """Return the values of an enumeration."""
        return tuple(getattr(self.camera, name).Symbolics)


def load_pylon() -> tuple[Any, Any]:
    """Return the driver's modules ``pylon`` and ``genicam``, or raise CaptureError."""
    try:
        with warnings.catch_warnings():
            # its wrapper's types warn, and end the process where a warning is an error
            warnings.simplefilter("ignore", DeprecationWarning)
            from pypylon import genicam, pylon
    except ImportError as error:
        raise CaptureError(
            f"pypylon can't be loaded: {error}. To install it, {installing('rig')}"
        ) from error
    return pylon, genicam


def said(error: Exception) -> str:
    """Return an error of the driver without the names of its source files."""
    return re.split(r" : \w+ thrown", str(error))[0].strip().rstrip(".")


def _choices(node: Any) -> str:
    """Return what a node would take, for an error message."""
    with suppress(Exception):
        return f". It takes {', '.join(node.Symbolics)}"
    with suppress(Exception):
        return f". It takes {node.Min} to {node.Max} in steps of {node.Inc}"
    return ""
