"""What settings know of any scene; a kind's own options lie beside the kind."""

from __future__ import annotations

from math import prod
from typing import Any, ClassVar, Literal, NamedTuple, Self

from pydantic import Field

from rfpipe import plugins
from rfpipe.config.base import (
    Described,
    Extent,
    MethodSections,
    SectionName,
    Text,
    ViewCount,
    setting,
)


class Choice(NamedTuple):
    """Value that a scene chooses for a setting which is null.

    Attributes
    ----------
    setting : str
    value : object
        In plain data.
    reason : str
        Why, as a clause.
    """

    setting: str
    value: Any
    reason: str


class SceneSettings(Described):
    """The settings of a scene of any kind, a simulated or a real one.

    Attributes
    ----------
    is_captured : bool
        Whether it is a real scene, before a real rig, without ground truth.
    files : tuple of str
        Options that name a file or folder which must be there before a run begins.
    """

    group: ClassVar[str] = plugins.SCENES
    key: ClassVar[str] = "kind"
    is_captured: ClassVar[bool] = False
    files: ClassVar[tuple[str, ...]] = ()

    kind: Text = Field(
        description="Kind of scene, one that 'rfpipe settings scenes' lists, or a class of your "
        "own as module:Class or file.py:Class.",
    )
    shape: tuple[Extent, Extent] = setting(
        (62, 70), "Rays of the rig, or of each view: height and width, 1 to 4096 each."
    )
    channels: Literal[1, 3] = setting(3, "Colour channels: 1 (grey) or 3 (RGB).")
    methods: MethodSections | None = setting(
        None, "Methods of this scene, with options that differ from the run's; null: the run's."
    )
    rig: SectionName | None = setting(
        None, "The one of the settings' rigs that it stands before; null: the run's."
    )
    settings: dict[str, Any] = setting(
        {}, "Settings of the run, other for this scene; they win over its rig's."
    )
    about: dict[str, Any] = setting({}, "Facts for the catalogue, such as {number: 1992.14.3}.")

    @classmethod
    def of(cls, kind: str, **options: Any) -> Self:
        """Return the settings of a scene of some kind.

        Raises
        ------
        ValidationError
            When there is no such kind, it lacks an option, or one is out of range.
        """
        return cls.model_validate({"kind": kind, **options})

    def itself(self) -> dict[str, Any]:
        """Return as plain data what is true of it, however and before whatever it is acquired."""
        other = {"methods", "rig", "settings", "about"}
        return self.model_dump(mode="json", exclude=other)

    @property
    def simulation_bytes(self) -> int:
        """Bytes that a simulated scene takes, as far as that is known before it is made."""
        return 0

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the projector's ray domain: (H, W), or (V, H, W) for an array of views."""
        return self.shape

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain, the same as `ray_shape` for a coaxial rig."""
        return self.ray_shape

    @property
    def view_grid(self) -> tuple[int, int]:
        """Rows and columns of the array of views, (1, 1) of a single pair."""
        return 1, 1

    @property
    def is_light_field(self) -> bool:
        """Whether either side of the rig is an array of views, be it of a single one."""
        return max(len(self.ray_shape), len(self.camera_ray_shape)) > 2

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays."""
        return self.camera_ray_shape == self.ray_shape

    @property
    def has_truth(self) -> bool:
        """Whether its light under any pattern is known, to compare with."""
        return not self.is_captured

    @property
    def choices(self) -> list[Choice]:
        """Values of the settings that are null and depend on the scene."""
        return []

    @property
    def omissions(self) -> list[str]:
        """Sentences on the light that the simulation leaves out, though the scene has it."""
        return []

    @property
    def obstacles(self) -> list[str]:
        """Sentences on what the simulation needs and this machine lacks, with the remedy."""
        return []


class Views(SceneSettings):
    """A scene before a planar array of coaxial projectors and cameras, or before a single pair."""

    views: tuple[ViewCount, ViewCount] | None = setting(
        None, "Rows and columns of an array of coaxial pairs [5.2]; null: a single pair."
    )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the ray domain: (H, W), or (V, H, W)."""
        return self.shape if self.views is None else (prod(self.views), *self.shape)

    @property
    def view_grid(self) -> tuple[int, int]:
        """Rows and columns of the array of views."""
        return self.views or (1, 1)


class AnyRig(Views):
    """A scene before any rig, one whose camera stands aside of the projector, too."""

    camera_shape: tuple[Extent, Extent] | None = setting(
        None, "Height and width of the camera's rays, 1 to 4096 each; null: a coaxial rig."
    )

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain."""
        return self.ray_shape if self.camera_shape is None else self.camera_shape

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays."""
        return self.camera_shape is None
