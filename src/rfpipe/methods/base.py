"""What every acquisition method is; free of any file or device."""

from __future__ import annotations

import inspect
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationError

from rfpipe import plugins
from rfpipe.blocks import RayDomain
from rfpipe.config.base import Fraction, MethodSettings
from rfpipe.config.mistakes import mistake_lines
from rfpipe.errors import InputError
from rfpipe.patterns import Schedule
from rfpipe.transport.base import Transport

Float = NDArray[np.float32]

TOLERANCES = (1e-2, 3e-3, 1e-3, 3e-4)
"""Tolerances for plots of speed against error, as fractions of the floodlit image's maximum."""

MEMORY_BYTES = 2**32
"""Memory that refining a level may take where nothing else is said: 4 GiB."""


State = TypeVar("State")
"""A method's states; their ``rows`` are the table of levels so far, see `Transport.level_rows`."""


class Options(MethodSettings):
    """The options that every method has; a method's own come on top of them.

    Each has a description with its unit and range: the settings' file and its schema are made from
    them.
    """

    noise_significance: float = Field(
        3.0,
        ge=0,
        le=100,
        description="Standard deviations of its noise above which light counts as measured, 0 "
        "to 100.",
    )


class PatternOptions(Options):
    """The options of methods that may be told how many patterns to show."""

    patterns: int = Field(
        0,
        ge=0,
        le=1_000_000,
        description="Patterns to show at most, 0 to 1000000; 0 leaves it to the method.",
    )


class ErrorOptions(PatternOptions):
    """The options of methods that stop at an error that they estimate."""

    target_error: Fraction = Field(
        0.01,
        description="Mean error of relit pictures at which to stop, a fraction of their norm "
        "between 0 and 1.",
    )
    target_indirect: Fraction | None = Field(
        None,
        description="Mean error of their indirect light, on pixels without direct light, at which "
        "to stop, a fraction of that light between 0 and 1; null: any.",
    )


class LevelImages(Protocol):
    """The radiance images of one level, read a few patterns at a time."""

    @property
    def schedule(self) -> Schedule:
        """The patterns they were taken under."""

    def read(self, first: int, last: int) -> tuple[Float, Float]:
        """Return radiance and variance, each float32 ``(last - first, *camera_shape, C)``.

        A pixel that can't be trusted has a radiance of 0 and an infinite variance: it is no
        evidence of anything. The same pixels are unknown in all images of an acquisition.
        """


@dataclass(frozen=True)
class Pack:
    """What one level's refinement adds to a state, as named arrays and plain data."""

    arrays: Mapping[str, NDArray[Any]]
    attributes: Mapping[str, Any]

    def __or__(self, more: Pack) -> Pack:
        """Return what both hold."""
        return Pack({**self.arrays, **more.arrays}, {**self.attributes, **more.attributes})


class Method(ABC, Generic[State]):
    """An acquisition method: a state machine from floodlit image to transport.

    A level is: `schedule`, the capture of its patterns by somebody else, `refine`. The levels of
    a run are known beforehand (`n_levels`); a level with nothing left to ask has an empty
    schedule and is refined with no images.

    A method describes itself: what settings, reports, forecasts and benchmarks know of it stands
    in its own class, and they find it by its name among the entry points of the group
    ``rfpipe.methods``, or by its path, ``module:Class``. `rfpipe.testing.MethodContract` has the
    tests that every method should pass.

    Attributes
    ----------
    name : str
        What settings and the results' folders call it: lower-case letters, digits and _.
    title : str
        What reports call it, such as "Dual photography".
    colour : str
        Of its marks in plots, as matplotlib takes it.
    marker, line : str
        Of its marks in plots, as matplotlib takes them.
    needs_coaxial_rig : bool
        Whether it rests on ``T = T^T``.
    estimates_error : bool
        Whether its rows of levels have an ``estimated_error``.
    bytes_per_ray : int or None
        Memory of an acquisition for each camera ray, in bytes, as measured at 10^3 to 10^5 rays;
        None where all pictures are held.
    Options : type of Options
        Its options: a pydantic model.
    trades : str or None
        The option by which users trade patterns for accuracy.
    trials : tuple of float
        Its values, from the coarsest, for plots of speed against error.
    """

    name: str
    title: str
    colour: str
    marker: str = "o"
    line: str = "-"
    needs_coaxial_rig: bool = False
    estimates_error: bool = False
    bytes_per_ray: int | None = None
    Options: type[Options] = Options
    trades: str | None = None
    trials: tuple[float, ...] = ()

    def check(self, camera: RayDomain, projector: RayDomain) -> None:
        """Raise InputError if the method does not fit a rig of these rays."""
        if self.needs_coaxial_rig and camera.shape != projector.shape:
            raise InputError(
                f"{self.title.lower()} needs a coaxial rig, whose camera and projector share one "
                f"ray domain, but the camera's is {camera.shape} and the projector's "
                f"{projector.shape}; use a method for any rig, such as dual photography, or "
                "resample the camera onto the projector's grid"
            )

    def asks_symmetry(self, camera: RayDomain, projector: RayDomain) -> bool:
        """Tell whether a rig of these rays is measured for symmetry before the first level."""
        return self.needs_coaxial_rig

    def on_rig(self, coaxial: bool) -> Method[Any]:
        """Return the method that goes on after that measurement, which found T symmetric or not."""
        return self

    @abstractmethod
    def n_levels(self, camera: RayDomain, projector: RayDomain) -> int:
        """Return the number of levels of a rig that the method fits."""

    def expected_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Guess the patterns of a whole acquisition, for forecasts; one a ray if not said."""
        return projector.size

    def most_patterns(self, camera: RayDomain, projector: RayDomain, options: Any) -> int:
        """Return how many patterns an acquisition shows at most, or as expected if not said."""
        return self.expected_patterns(camera, projector, options)

    def memory_bytes(
        self, camera: RayDomain, projector: RayDomain, channels: int, options: Any
    ) -> int:
        """Guess the peak memory of an acquisition; the libraries take 200 MB of it."""
        pictures = 40 * channels * self.expected_patterns(camera, projector, options)
        each = pictures if self.bytes_per_ray is None else self.bytes_per_ray
        return 200_000_000 + camera.size * each

    @abstractmethod
    def start(self, camera: RayDomain, projector: RayDomain, channels: int, options: Any) -> State:
        """Return the state before the first level; InputError for more rays than it can take."""

    @abstractmethod
    def schedule(self, state: State) -> Schedule:
        """Return the patterns of the next level."""

    def asks(self, state: State) -> bool:
        """Tell whether the next level has patterns to show."""
        return self.schedule(state).count > 0

    @abstractmethod
    def refine(self, state: State, images: LevelImages, memory_bytes: int = MEMORY_BYTES) -> State:
        """Return the state after a level's images.

        `memory_bytes` is about what the work may take beside the state itself; the result does not
        depend on it.
        """

    @abstractmethod
    def transport(self, state: State) -> Transport:
        """Return what is known of the transport so far; nodes still open at their estimate.

        Rows of pixels that the images don't know may be left empty: where the rig is coaxial,
        `rfpipe.transport.filling` takes them from their columns.
        """

    def known(self, state: State) -> Transport:
        """Return what predicts the light of rays that the next level leaves dark.

        It is `transport`, unless what a method would return differs from what it goes on with.
        """
        return self.transport(state)

    @abstractmethod
    def pack(self, state: State) -> Pack:
        """Return what the last refinement added, and what the next one needs."""

    @abstractmethod
    def restore(self, start: State, packs: Sequence[Pack]) -> State:
        """Return the state after the last of the given levels' packs."""


def method_names() -> tuple[str, ...]:
    """Return the names of all methods that are installed."""
    return plugins.names(plugins.METHODS)


def get_method(method: str | Method[Any] | type[Method[Any]]) -> Method[Any]:
    """Return an acquisition method.

    Parameters
    ----------
    method : str or Method or type of Method
        A name in `method_names`, a path ``module:Class`` or ``file.py:Class``, or the method
        itself.

    Raises
    ------
    InputError
        If there is no such method, or what is there is none.
    """
    if isinstance(method, Method):
        return method
    entry = plugins.find(plugins.METHODS, method) if isinstance(method, str) else method
    if not (inspect.isclass(entry) and issubclass(entry, Method)):
        raise InputError(
            f"method {method!r} is no acquisition method; expected a class derived from "
            "rfpipe.methods.Method"
        )
    missing = [name for name in ("name", "title", "colour") if not hasattr(entry, name)]
    if missing or inspect.isabstract(entry):
        missing += sorted(entry.__abstractmethods__)
        raise InputError(f"method {method!r} lacks {', '.join(missing)}; see rfpipe.methods.Method")
    return entry()


def options_of(method: Method[Any], **options: Any) -> Options:
    """Return a method's options, defaults for those that aren't given.

    Raises
    ------
    InputError
        For each that the method doesn't have, and each out of range: says what was meant.
    """
    try:
        return method.Options.model_validate(options)
    except ValidationError as error:
        lines = mistake_lines(error)
        raise InputError("\n".join(f"{method.name}: {line}" for line in lines)) from None
