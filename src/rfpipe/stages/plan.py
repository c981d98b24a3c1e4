"""Plan of an acquisition: its method with options, and its rays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from rfpipe.blocks import RayDomain
from rfpipe.methods import (
    Method,
    MethodDescription,
    Options,
    StateArrays,
    get_method,
    options_of,
)
from rfpipe.methods.base import DEFAULT_TARGET, check_rays
from rfpipe.references.symmetry import is_coaxial, log_asymmetry, read_asymmetry
from rfpipe.rigs.calibrated import was_coaxial
from rfpipe.storage.base import Storage


@dataclass(frozen=True)
class Plan:
    """Method, options and rays of an acquisition.

    Attributes
    ----------
    name : str
        Name of the method's section in the settings, and of the results' folder.
    description : MethodDescription
        The method of the settings, which may choose another one by the rig's symmetry.
    method : Method
        The method that acquires. Until the symmetry is measured, it is chosen by the rays' shapes.
    camera, projector : RayDomain
        Rays of the rig.
    channels : int
        Colour channels, 1 or 3.
    options : Options
        The method's options.
    accepted_asymmetry : float
        Accepted error in relit pictures, relative to their norm, of treating the rig as coaxial.
        `for_measured_rig` chooses the method by it.
    """

    name: str
    description: MethodDescription
    method: Method[Any]
    camera: RayDomain
    projector: RayDomain
    channels: int
    options: Options
    accepted_asymmetry: float

    @classmethod
    def of(
        cls,
        name: str,
        method: str | MethodDescription,
        rays: tuple[Sequence[int], Sequence[int], int],
        options: Mapping[str, Any] | None = None,
        accepted_asymmetry: float = 0.05,
    ) -> Plan:
        """Make the plan of a method.

        Parameters
        ----------
        method : str or MethodDescription
            See `rfpipe.methods.get_method`.
        rays : (sequence of int, sequence of int, int)
            Shapes of the camera's and of the projector's `RayDomain`, and number of channels.
        options : mapping, optional
            Options that differ from their defaults.

        Raises
        ------
        InputError
            If the method has no such option, or doesn't fit the rays.
        """
        description = get_method(method)
        camera_shape, projector_shape, channels = rays
        camera, projector = RayDomain(tuple(camera_shape)), RayDomain(tuple(projector_shape))
        check_rays(description, camera, projector)
        return cls(
            name,
            description,
            description.for_rig(camera, projector),
            camera,
            projector,
            channels,
            options_of(description, **(options or {})),
            accepted_asymmetry,
        )

    @property
    def measures_symmetry(self) -> bool:
        """True if the rig's symmetry is measured by patterns captured with level 0."""
        return self.description.measures_symmetry(self.camera, self.projector)

    @property
    def target_error(self) -> float:
        """Target of the estimated error; 1 % for methods that don't estimate their error."""
        return self.options.error_target or DEFAULT_TARGET

    @property
    def expected_patterns(self) -> int:
        """Number of patterns that the method is expected to show."""
        forecast = self.description.forecast(
            self.camera, self.projector, self.channels, self.options
        )
        return forecast.patterns

    def start(self) -> Any:
        """Return the method's state before level 0."""
        return self.method.start(self.camera, self.projector, self.channels, self.options)

    def restored_state(self, storage: Storage, level: int) -> Any:
        """Read the method's state before a level; large arrays are read when first used.

        Errors: see `Storage.open`.
        """
        start = self.start()
        levels = []
        for earlier in range(level):
            arrays, attributes = storage.open(earlier, "refine")
            levels.append(StateArrays(arrays, attributes["state"]))
        return type(start).from_arrays(start, levels)

    def for_measured_rig(self, storage: Storage, *, is_logged: bool = False) -> Plan:
        """Choose the method by the rig's symmetry that level 0's merge measured.

        Parameters
        ----------
        is_logged : bool
            Whether to log why.

        Raises
        ------
        CaptureError
            When the method needs a coaxial rig, and the rig isn't coaxial.
        """
        measured = read_asymmetry(storage)
        if measured is None:
            return self
        coaxial = is_coaxial(
            measured, self.description, self.options, self.accepted_asymmetry,
            was_coaxial=was_coaxial(storage.read_manifest(0, "capture")["rig"]),
        )  # fmt: skip
        method = self.description.for_rig(self.camera, self.projector, coaxial)
        if is_logged:
            is_chosen = method.name != self.description.name
            log_asymmetry(measured, self.accepted_asymmetry, method if is_chosen else None)
        return replace(self, method=method)

    def describe(self) -> dict[str, Any]:
        """Describe the plan as plain data, for fingerprints."""
        return {
            "name": self.name,
            "method": self.method.name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            "options": self.options.options(),
        }
