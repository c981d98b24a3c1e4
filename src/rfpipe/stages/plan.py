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
from rfpipe.methods.adaptive.prior import PATTERNS_WITH_PRIOR
from rfpipe.methods.base import DEFAULT_TARGET, Forecast, check_rays
from rfpipe.references.symmetry import is_coaxial, log_asymmetry, read_asymmetry
from rfpipe.rigs.calibrated import was_coaxial
from rfpipe.stages.prior import Prior, read_prior
from rfpipe.storage.base import Storage
from rfpipe.transport.base import Transport


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
    prior : Prior, optional
        Transport of an earlier acquisition with this rig.
    """

    name: str
    description: MethodDescription
    method: Method[Any]
    camera: RayDomain
    projector: RayDomain
    channels: int
    options: Options
    accepted_asymmetry: float
    prior: Prior | None = None

    @classmethod
    def of(
        cls,
        name: str,
        method: str | MethodDescription,
        rays: tuple[Sequence[int], Sequence[int], int],
        options: Mapping[str, Any] | None = None,
        accepted_asymmetry: float = 0.05,
        prior: Transport | None = None,
    ) -> Plan:
        """Make the plan of a method.

        Parameters
        ----------
        method : str or MethodDescription
            See `rfpipe.methods.get_method`.
        rays : (sequence of int, sequence of int, int)
            Shapes of the camera's and of the projector's `RayDomain`, and number of channels.
        options : mapping, optional
            Options that differ from their defaults, among them the path of a stored prior.
        prior : Transport, optional
            A prior in memory. A prior shows whether the rig is coaxial, which isn't measured again.

        Raises
        ------
        InputError
            If the method has no such option, or doesn't fit the rays or the prior, or if there is
            no transport at the prior's path.
        StoreError
            If the stored prior is damaged, or a later version of rfpipe wrote it.
        """
        description = get_method(method)
        camera_shape, projector_shape, channels = rays
        camera, projector = RayDomain(tuple(camera_shape)), RayDomain(tuple(projector_shape))
        check_rays(description, camera, projector)
        checked = options_of(description, **(options or {}))
        used = None if prior is None else Prior(prior)
        if used is None and checked.prior_path is not None:
            used = read_prior(checked.prior_path)
        if used is not None:
            used.check(description, (camera.shape, projector.shape, channels))
        return cls(
            name,
            description,
            description.for_rig(camera, projector, None if used is None else used.is_coaxial),
            camera,
            projector,
            channels,
            checked,
            accepted_asymmetry,
            used,
        )

    @property
    def measures_symmetry(self) -> bool:
        """True if the rig's symmetry is measured by patterns captured with level 0."""
        return self.prior is None and self.description.measures_symmetry(
            self.camera, self.projector
        )

    @property
    def target_error(self) -> float:
        """Target of the estimated error; 1 % for methods that don't estimate their error."""
        return self.options.error_target or DEFAULT_TARGET

    @property
    def expected_patterns(self) -> int:
        """Number of patterns that the method is expected to show."""
        return self.forecast().patterns

    def forecast(self) -> Forecast:
        """Forecast the acquisition; with a prior, that of an unchanged scene."""
        forecast = self.description.forecast(
            self.camera, self.projector, self.channels, self.options
        )
        if self.prior is None:
            return forecast
        patterns = min(PATTERNS_WITH_PRIOR, forecast.max_patterns)
        return replace(forecast, patterns=patterns, quartiles=None)

    @property
    def without_prior(self) -> Plan:
        """The plan without its prior, which a scene that changed much follows."""
        return replace(self, prior=None)

    def start(self) -> Any:
        """Return the method's state before level 0."""
        state = self.method.start(self.camera, self.projector, self.channels, self.options)
        return state if self.prior is None else replace(state, prior=self.prior.transport)

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
        """Describe the plan as plain data, for fingerprints.

        With a prior, the description has its path and digest, and the number of patterns that an
        unchanged scene takes.
        """
        described = {
            "name": self.name,
            "method": self.method.name,
            "camera_shape": list(self.camera.shape),
            "projector_shape": list(self.projector.shape),
            "channels": self.channels,
            "options": self.options.options(),
        }
        if self.prior is not None:
            described |= {
                "prior": self.prior.describe(),
                "expected_patterns": self.expected_patterns,
            }
        return described
