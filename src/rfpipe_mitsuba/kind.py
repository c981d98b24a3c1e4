"""Physically based scenes by Mitsuba 3."""

from __future__ import annotations

from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from rfpipe.config.base import Extent, Settings
from rfpipe.config.scenes import SceneSettings
from rfpipe.errors import InputError
from rfpipe.scenes.base import Scene, SceneKind
from rfpipe_mitsuba.views import View, Views
from rfpipe_mitsuba.world import World, world_of_file
from rfpipe_mitsuba.worlds import WORLDS

__all__ = ["Mitsuba", "MitsubaOptions", "ViewSettings"]

_FILES = (".xml", ".json")


class ViewSettings(Settings):
    """A pinhole's place."""

    origin: tuple[float, float, float] = Field(description="Where it stands, in scene units.")
    target: tuple[float, float, float] = Field(description="At what it looks, in scene units.")
    up: tuple[float, float, float] = Field(
        (0.0, 1.0, 0.0), description="What is up in its picture, a direction."
    )
    degrees: float = Field(
        40.0, gt=0, lt=180, description="Field of view across its width, in degrees, 0 to 180."
    )

    def view(self) -> View:
        """Return the pinhole."""
        return View(self.origin, self.target, self.up, self.degrees)


class MitsubaOptions(SceneSettings):
    """A physically based scene, and the light that is followed in it."""

    scene: str = Field(
        min_length=1,
        description=f"Which scene: one of {', '.join(WORLDS)}; or a file of Mitsuba 3, .xml, or "
        ".json of a scene's dict. Its sensors and lights but for projectors are left out.",
    )
    projector_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of each projector's picture in pixels, 1 to 4096; null for "
        "the camera's.",
    )
    cameras: list[ViewSettings] | None = Field(
        None, min_length=1, description="Where the cameras stand; null for the scene's own."
    )
    projectors: list[ViewSettings] | None = Field(
        None,
        min_length=1,
        description="Where the projectors stand; null for the scene's own, and where the cameras "
        "stand if it has none.",
    )
    light: Literal["recorded", "rendered"] = Field(
        "recorded",
        description="recorded: the transport matrix is traced once and kept. rendered: Mitsuba "
        "renders each pattern, slowly, and without caustics.",
    )
    samples: int = Field(
        16384, ge=2, le=2**20, description="Paths of light a pixel, 2 to 1,048,576."
    )
    bounces: int | None = Field(
        None,
        ge=1,
        le=64,
        description="Surfaces, or scatterings, that a path of light meets at most: 1 is direct "
        "light alone; null for what the scene needs.",
    )
    caustics: bool | None = Field(
        None,
        description="Whether to follow light that the projector sends by mirrors or lenses: true "
        "or false; null for what the scene needs.",
    )
    seed: int = Field(0, ge=0, description="Seed of the paths, 0 or more.")
    cache: str = Field(
        "results/recorded",
        min_length=1,
        description="Folder that recorded matrices are kept in, relative to the working folder.",
    )

    @cached_property
    def world(self) -> World:
        """The scene.

        Raises
        ------
        InputError
            When there is none of this name, or the file is no scene.
        """
        if self.scene in WORLDS:
            return WORLDS[self.scene]
        path = Path(self.scene)
        if path.suffix not in _FILES:
            raise InputError(
                f"scene is {self.scene!r}; expected a file of Mitsuba 3, "
                f"{' or '.join(_FILES)}, or one of {', '.join(WORLDS)}"
            )
        return world_of_file(path)

    def own_options(self) -> dict[str, Any]:
        """Return the options of the kind, with the light that is followed in numbers."""
        followed = {
            "bounces": self.bounces or self.world.bounces,
            "caustics": self.follows_caustics,
        }
        return {**super().own_options(), **followed}

    @property
    def follows_caustics(self) -> bool:
        """Whether light is followed from the projectors, too; never where patterns are rendered."""
        wanted = self.world.caustics if self.caustics is None else self.caustics
        return wanted and self.light == "recorded"

    @property
    def is_coaxial(self) -> bool:
        """Whether camera and projector share their rays."""
        return self.projectors is None and (
            self.cameras is not None or self.world.projectors is None
        )

    @property
    def camera_side(self) -> Views:
        """The cameras."""
        named = self.cameras and tuple(each.view() for each in self.cameras)
        return Views(named or self.world.cameras, self.shape)

    @property
    def projector_side(self) -> Views:
        """The projectors."""
        if self.is_coaxial:
            return self.camera_side
        named = self.projectors and tuple(each.view() for each in self.projectors)
        return Views(
            named or self.world.projectors or self.camera_side.views,
            self.projector_shape or self.shape,
        )

    @property
    def ray_shape(self) -> tuple[int, ...]:
        """Shape of the projector's ray domain: (H, W), or (V, H, W) of several projectors."""
        return self.projector_side.domain

    @property
    def camera_ray_shape(self) -> tuple[int, ...]:
        """Shape of the camera's ray domain: (H, W), or (V, H, W) of several cameras."""
        return self.camera_side.domain

    @property
    def view_grid(self) -> tuple[int, int]:
        """One row of as many views as there are cameras."""
        return 1, len(self.camera_side.views)

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        if self.is_coaxial and self.projector_shape not in {None, self.shape}:
            raise ValueError(
                f"projector_shape is {self.projector_shape}; a rig whose projectors stand where "
                "its cameras stand has one shape: leave it out, or name projectors"
            )
        return self


class Mitsuba(SceneKind):
    """A scene of Mitsuba 3: any materials, any light."""

    Options: ClassVar[type[SceneSettings]] = MitsubaOptions

    @classmethod
    def make(cls, options: Any, *, many_patterns: bool = False) -> Scene:  # noqa: ARG003
        """Build the scene; nothing is traced before the first pattern."""
        from rfpipe_mitsuba.scene import MitsubaScene

        return MitsubaScene(
            options.world,
            options.camera_side,
            options.projector_side,
            channels=options.channels,
            coaxial=options.is_coaxial,
            samples=options.samples,
            bounces=options.bounces,
            caustics=options.follows_caustics,
            seed=options.seed,
            rendered=options.light == "rendered",
            cache=Path(options.cache),
        )
