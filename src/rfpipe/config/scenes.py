"""Settings that all scenes have; the options of a kind of scene are defined beside it."""

from __future__ import annotations

from math import prod
from typing import Any, ClassVar, Literal, NamedTuple, Self

from pydantic import Field

from rfpipe import plugins
from rfpipe.config.base import (
    Extent,
    MethodSections,
    PluginSettings,
    SectionName,
    Text,
    ViewCount,
)


class Choice(NamedTuple):
    """Value that a scene chooses for a setting which is null.

    Attributes
    ----------
    setting : str
        Name of the setting.
    value : object
        The value as plain data.
    reason : str
        Reason for the choice, as a clause.
    """

    setting: str
    value: Any
    reason: str


class SceneSettings(PluginSettings):
    """The settings of a scene of any kind, a simulated or a real one.

    Attributes
    ----------
    is_captured : bool
        True for a real scene in front of a real rig, without ground truth.
    files : tuple of str
        Options that name a file or folder which has to exist before a run begins.
    """

    group: ClassVar[str] = plugins.SCENES
    key: ClassVar[str] = "kind"
    is_captured: ClassVar[bool] = False
    files: ClassVar[tuple[str, ...]] = ()

    kind: Text = Field(
        description="Kind of scene: one that 'rfpipe settings scenes' lists, or a class of your "
        "own as module:Class or file.py:Class.",
    )
    shape: tuple[Extent, Extent] = Field(
        (62, 70), description="Height and width of the ray domain, or of each view, in rays."
    )
    channels: Literal[1, 3] = Field(3, description="Colour channels: 1 (grey) or 3 (RGB).")
    methods: MethodSections | None = Field(
        None,
        description="Methods of this scene, with the options that differ from the run's; null: "
        "those of the run.",
    )
    rig: SectionName | None = Field(
        None,
        description="Entry of the section rigs whose settings apply to this scene; null: none.",
    )
    settings: dict[str, Any] = Field(
        {},
        description="Settings of the run that differ for this scene; they override those of its "
        "rig.",
    )
    about: dict[str, Any] = Field(
        {}, description="Facts for the catalogue, such as {number: 1992.14.3}."
    )

    @classmethod
    def of(cls, kind: str, **options: Any) -> Self:
        """Return the settings of a scene of a kind.

        Raises
        ------
        ValidationError
            When there is no such kind, or an option is missing or out of range.
        """
        return cls.model_validate({"kind": kind, **options})

    def scene_options(self) -> dict[str, Any]:
        """Return the options that describe the scene itself, not its acquisition, as plain data."""
        return self.model_dump(mode="json", exclude={"methods", "rig", "settings", "about"})

    @property
    def simulation_bytes(self) -> int:
        """Memory of a simulated scene in bytes, as far as known before it is built."""
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
        """Rows and columns of the array of views; (1, 1) for a single pair."""
        return 1, 1

    @property
    def is_light_field(self) -> bool:
        """True if either side of the rig is an array of views, even of one view."""
        return max(len(self.ray_shape), len(self.camera_ray_shape)) > 2

    @property
    def is_coaxial(self) -> bool:
        """True if camera and projector share their rays."""
        return self.camera_ray_shape == self.ray_shape

    @property
    def has_truth(self) -> bool:
        """True if the exact picture under any pattern is known."""
        return not self.is_captured

    @property
    def choices(self) -> list[Choice]:
        """Values chosen for settings that are null and depend on the scene."""
        return []

    @property
    def omissions(self) -> list[str]:
        """Sentences about light in the scene that the simulation omits."""
        return []

    @property
    def obstacles(self) -> list[str]:
        """Sentences about missing requirements of the simulation, each with the remedy."""
        return []


class Views(SceneSettings):
    """A scene in front of a planar array of coaxial projector-camera pairs, or of one pair."""

    views: tuple[ViewCount, ViewCount] | None = Field(
        None,
        description="Rows and columns of an array of coaxial pairs [5.2]; null: a single pair.",
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
    """A scene in front of any rig, coaxial or with the camera beside the projector."""

    camera_shape: tuple[Extent, Extent] | None = Field(
        None, description="Height and width of the camera's ray domain; null: a coaxial rig."
    )

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain."""
        return self.ray_shape if self.camera_shape is None else self.camera_shape

    @property
    def is_coaxial(self) -> bool:
        """True if camera and projector share their rays."""
        return self.camera_shape is None
