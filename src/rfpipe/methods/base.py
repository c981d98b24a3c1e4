"""Acquisition methods: their descriptions, options, states and the registry.

A method decides which patterns to show next and computes the transport from their images. The loop
that shows the patterns and takes the pictures is `rfpipe.stages`; a method opens no device, and no
file except temporary ones::

    state = method.start(camera, projector, channels, options)
    while (schedule := method.next_schedule(state)) is not None:
        state = method.refine(state, images_of(schedule), memory_bytes)
    transport = method.transport(state)
"""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, Self, TypeVar

from numpy.typing import NDArray
from pydantic import Field, ValidationError

from rfpipe import plugins
from rfpipe.array_types import Float
from rfpipe.blocks import RayDomain
from rfpipe.config.base import Fraction, MethodSettings, Text
from rfpipe.config.mistakes import mistake_lines
from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4)
"""Tolerances for plots of speed against error, as fractions of the floodlit image's maximum."""

DEFAULT_TARGET = 0.01
"""Target of the estimated error, by default."""

SIGNIFICANCE = 3.0
"""Standard deviations of its noise above which light is significant, by default."""

MEMORY_BYTES = 2**32
"""Default memory for the refinement of a level: 4 GiB."""

PICTURE_VALUE_BYTES = 40
"""Memory of a picture's pixel and channel in forecasts of methods that keep all pictures: float32
radiance, variance and pattern, and copies of them during a fit."""

LIBRARY_BYTES = 200_000_000
"""Memory of Python and its libraries, part of every forecast."""

# Typical error of indirect light over the total error.
_INDIRECT_RATIO = 6.0


class Options(MethodSettings):
    """Options that every method has; methods derive their own from it.

    Each option has a description with its unit and range, from which the settings' schema is made.
    """

    noise_significance: float = Field(
        SIGNIFICANCE,
        ge=0,
        le=100,
        description="Standard deviations of its noise above which light counts as measured.",
    )


class ErrorOptions(Options):
    """Options of methods that stop at a target of their estimated error."""

    patterns: int = Field(
        0,
        ge=0,
        le=1_000_000,
        description="Patterns to show at most; 0 leaves it to the method.",
    )
    target_error: Fraction = Field(
        DEFAULT_TARGET,
        description="Mean error of relit pictures at which to stop, a fraction of their norm.",
    )
    target_indirect: Fraction | None = Field(
        None,
        description="Mean error of their indirect light, on pixels without direct light, at which "
        "to stop, a fraction of that light; null: any.",
    )
    prior: Text | None = Field(
        None,
        description="Folder with the transport of an earlier acquisition of this or a similar "
        "scene by the same rig, with which to begin; null: none.",
    )

    @property
    def error_target(self) -> float:
        """Target of the estimated error, `target_error`."""
        return self.target_error

    @property
    def total_target(self) -> float:
        """Total error that typically meets both targets, of all light and of indirect light."""
        if self.target_indirect is None:
            return self.target_error
        return min(self.target_error, self.target_indirect / _INDIRECT_RATIO)

    @property
    def prior_path(self) -> str | None:
        """Folder of the transport with which an acquisition begins, `prior`."""
        return self.prior


class LevelImages(Protocol):
    """Radiance images of one level, read a few patterns at a time."""

    @property
    def schedule(self) -> Schedule:
        """Patterns under which the images were taken."""

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Read radiance and variance, each float32 ``(last - first, *camera_shape, C)``.

        A masked pixel, which is defective, has a radiance of 0 and an infinite variance in all
        images of an acquisition.
        """


@dataclass(frozen=True)
class Forecast:
    """Forecast of an acquisition, made before any picture is taken.

    Attributes
    ----------
    patterns : int
        Expected number of patterns.
    max_patterns : int
        Largest number of patterns.
    memory_bytes : int
        Peak memory of the process in bytes.
    quartiles : tuple of int, optional
        Numbers of patterns between which half of the benchmark's tuning scenes are. None where the
        number of patterns doesn't depend on the scene.
    """

    patterns: int
    max_patterns: int
    memory_bytes: int
    quartiles: tuple[int, int] | None = None


@dataclass(frozen=True)
class StateArrays:
    """Part of a state that one level added or replaced, ready to be stored.

    Attributes
    ----------
    arrays : mapping of str to ndarray
        Boolean, integer or float arrays. Those of a restored level are read when first used.
    attributes : mapping of str to object
        Plain data, as JSON has it.
    """

    arrays: Mapping[str, NDArray[Any]]
    attributes: Mapping[str, Any]


class State(Protocol):
    """State of a method between two levels: a frozen dataclass.

    Attributes
    ----------
    rows : tuple of dict
        The table of the levels so far, see `Transport.level_rows`.
    """

    @property
    def rows(self) -> tuple[dict[str, Any], ...]:
        """The table of the levels so far, see `Transport.level_rows`."""

    def to_arrays(self, previous: Self) -> StateArrays:
        """Return the arrays and attributes that the last level changed.

        Parameters
        ----------
        previous : State
            The state before the last level. Large sets that only grow, such as leaves or pictures,
            are returned without what `previous` has.
        """

    @classmethod
    def from_arrays(cls, start: Self, levels: Sequence[StateArrays]) -> Self:
        """Restore a state from `Method.start`'s state and what each level changed, in order."""


S = TypeVar("S", bound=State)


class MethodDescription:
    """Description of an acquisition method, for settings, reports, forecasts and benchmarks.

    Most methods are a `Method`, which is its own description. `rfpipe.methods.auto.Auto` is a
    description only: its `for_rig` chooses the `Method` after the rig's symmetry has been measured.

    Methods are found by their name among the entry points of the group ``rfpipe.methods``, or by
    their path, ``module:Class``.

    Attributes
    ----------
    name : str
        Name in settings and in the results' folders: lower-case letters, digits and _.
    title : str
        Title in reports, such as "Dual photography".
    colour, marker, line : str
        Colour, marker and line style in plots, as matplotlib takes them.
    needs_coaxial_rig : bool
        Whether it relies on ``T = T^T``.
    estimates_error : bool
        Whether its rows of levels have an ``estimated_error``.
    uses_prior : bool
        Whether it can begin with the transport of an earlier acquisition; its state then has a
        field ``prior``.
    bytes_per_ray : int or None
        Memory of an acquisition for each camera ray in bytes, measured at 10^3 to 10^5 rays; None
        for methods that keep all pictures in memory.
    Options : type of Options
        Its options: a pydantic model.
    trades : str or None
        The option by which users trade patterns for accuracy.
    trials : tuple of float
        Values of that option, from the coarsest, for plots of speed against error.
    """

    name: str
    title: str
    colour: str
    marker: str = "o"
    line: str = "-"
    needs_coaxial_rig: bool = False
    estimates_error: bool = False
    uses_prior: bool = False
    bytes_per_ray: int | None = None
    Options: type[Options] = Options
    trades: str | None = None
    trials: tuple[float, ...] = ()

    def measures_symmetry(self, camera: RayDomain, projector: RayDomain) -> bool:
        """Test whether a rig of these rays has its symmetry measured by pictures of level 0."""
        return self.needs_coaxial_rig

    def for_rig(
        self, camera: RayDomain, projector: RayDomain, is_coaxial: bool | None = None
    ) -> Method[Any]:
        """Return the method for a rig.

        Parameters
        ----------
        is_coaxial : bool, optional
            Result of the measurement of the rig's symmetry; None if it wasn't measured.
        """
        raise NotImplementedError

    def forecast(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> Forecast:
        """Forecast patterns and memory of an acquisition; here one pattern per projector ray."""
        return self.forecast_of(camera, channels, projector.size, projector.size)

    def forecast_of(
        self, camera: RayDomain, channels: int, patterns: int, max_patterns: int
    ) -> Forecast:
        """Forecast an acquisition of known numbers of patterns, by `bytes_per_ray`."""
        picture_bytes = PICTURE_VALUE_BYTES * channels * patterns
        bytes_per_ray = picture_bytes if self.bytes_per_ray is None else self.bytes_per_ray
        memory_bytes = LIBRARY_BYTES + camera.size * bytes_per_ray
        return Forecast(patterns, max_patterns, memory_bytes)


class Method(MethodDescription, ABC, Generic[S]):
    """An acquisition method: a state machine from the first pattern to the transport.

    `rfpipe.testing.MethodContract` has the tests that every method should pass.
    """

    def for_rig(
        self, camera: RayDomain, projector: RayDomain, is_coaxial: bool | None = None
    ) -> Method[Any]:
        """Return the method itself, which is the same for every rig."""
        return self

    @abstractmethod
    def start(self, camera: RayDomain, projector: RayDomain, channels: int, options: Any) -> S:
        """Return the state before level 0; InputError for more rays than the method can take."""

    @abstractmethod
    def next_schedule(self, state: S) -> Schedule | None:
        """Return the patterns of the next level, at least one; None when the method is done."""

    @abstractmethod
    def refine(self, state: S, images: LevelImages, memory_bytes: int = MEMORY_BYTES) -> S:
        """Return the state after a level's images.

        `memory_bytes` limits the memory of the computation, except the state. The result does not
        depend on it.
        """

    @abstractmethod
    def transport(self, state: S) -> Transport:
        """Return the estimate of the transport; nodes still open have their current estimate.

        Rows of masked pixels may be left empty: where the rig is coaxial,
        `rfpipe.transport.filling` fills them from their columns.
        """

    def remaining_patterns(self, state: S) -> int | None:
        """Forecast the number of patterns of all further levels; None if it isn't known."""
        return None


def check_rays(method: MethodDescription, camera: RayDomain, projector: RayDomain) -> None:
    """Raise InputError if a method needs a coaxial rig and the ray domains differ."""
    if method.needs_coaxial_rig and camera.shape != projector.shape:
        raise InputError(
            f"{method.title.lower()} needs a coaxial rig, whose camera and projector share one "
            f"ray domain, but the camera's is {camera.shape} and the projector's "
            f"{projector.shape}; use a method for any rig, such as dual photography, or "
            "resample the camera onto the projector's grid"
        )


def method_names() -> tuple[str, ...]:
    """Return the names of all methods that are installed."""
    return plugins.names(plugins.METHODS)


def get_method(method: str | MethodDescription | type[MethodDescription]) -> MethodDescription:
    """Return an acquisition method.

    Parameters
    ----------
    method : str or MethodDescription or type of MethodDescription
        A name in `method_names`, a path ``module:Class`` or ``file.py:Class``, or the method
        itself.

    Raises
    ------
    InputError
        If no such method is installed, or the name leads to something else.
    """
    if isinstance(method, MethodDescription):
        return method
    entry = plugins.find(plugins.METHODS, method) if isinstance(method, str) else method
    if not (inspect.isclass(entry) and issubclass(entry, MethodDescription)):
        raise InputError(
            f"method {method!r} is not an acquisition method; expected a class derived from "
            "rfpipe.methods.Method"
        )
    missing = [name for name in ("name", "title", "colour") if not hasattr(entry, name)]
    if missing or inspect.isabstract(entry):
        missing += sorted(getattr(entry, "__abstractmethods__", ()))
        raise InputError(f"method {method!r} lacks {', '.join(missing)}; see rfpipe.methods.Method")
    return entry()


def options_of(method: MethodDescription, **options: Any) -> Options:
    """Validate a method's options, with defaults for the options that aren't given.

    Raises
    ------
    InputError
        For each unknown option, with a similar name, and for each value out of range.
    """
    try:
        return method.Options.model_validate(options)
    except ValidationError as error:
        lines = mistake_lines(error)
        raise InputError("\n".join(f"{method.name}: {line}" for line in lines)) from None
