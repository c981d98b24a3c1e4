"""The kind of scene ``mitsuba``: physically based light transport for a simulated rig."""

from __future__ import annotations

import warnings
from functools import cached_property
from importlib import metadata
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from rfpipe.array_types import Double
from rfpipe.config.base import Extent
from rfpipe.config.scenes import Choice, SceneSettings
from rfpipe.errors import InputError
from rfpipe.mitsuba.materials import (
    ShapeMaterial,
    check_traceable,
    choose_bounces,
    choose_caustics,
    omissions_of,
    shape_materials,
)
from rfpipe.mitsuba.recording import Piece, Recording, dense, is_recorded, product, record
from rfpipe.mitsuba.variant import missing_llvm
from rfpipe.mitsuba.views import Side, View
from rfpipe.mitsuba.world import TracingOptions, World, load_scene, world_of_file
from rfpipe.mitsuba.worlds import WORLDS
from rfpipe.provenance import fingerprint
from rfpipe.scenes.base import Scene, apply_in_batches

_SET, _DECLARED = "set", "declared with the scene"


class MitsubaOptions(SceneSettings):
    """A physically based scene, and the parameters of tracing its light."""

    scene: str = Field(
        min_length=1,
        description=f"The scene: {', '.join(WORLDS)}; or an .xml file of Mitsuba 3, whose "
        "emitters except projectors are ignored.",
    )
    projector_shape: tuple[Extent, Extent] | None = Field(
        None,
        description="Height and width of each projector's picture in pixels; null for "
        "the camera's.",
    )
    cameras: tuple[View, ...] | None = Field(
        None,
        min_length=1,
        description="Positions and lenses of the cameras; null for those of the scene.",
    )
    projectors: tuple[View, ...] | None = Field(
        None,
        min_length=1,
        description="Positions and lenses of the projectors; null: those of the scene, or of the "
        "cameras.",
    )
    samples: int = Field(16384, ge=2, le=2**20, description="Paths per pixel.")
    bounces: int | None = Field(
        None,
        ge=1,
        le=64,
        description="Maximum reflections and scatterings of a path; null: chosen by the "
        "scene, for a file 6, or 10 with refraction, or 48 with translucent bodies.",
    )
    caustics: bool | None = Field(
        None,
        description="true: trace light that mirrors and lenses throw on surfaces; null: chosen for "
        "the scene, true if any surface is a smooth mirror or lens.",
    )
    seed: int = Field(0, ge=0, description="Seed of textures or paths of light, 0 or more.")
    cache: str = Field(
        "results/recorded",
        min_length=1,
        description="Folder of recorded matrices, relative to the working folder.",
    )

    @cached_property
    def world(self) -> World:
        """The scene; raises InputError for an unknown name or an invalid file."""
        if self.scene in WORLDS:
            return WORLDS[self.scene]
        path = Path(self.scene)
        if path.suffix != ".xml":
            raise InputError(
                f"scene is {self.scene!r}; expected a file of Mitsuba 3, .xml, or one of "
                f"{', '.join(WORLDS)}"
            )
        return world_of_file(path)

    @property
    def light(self) -> TracingOptions:
        """Parameters of tracing."""
        return TracingOptions(self._bounces.value, self.samples, self._caustics.value, self.seed)

    @cached_property
    def surfaces(self) -> list[ShapeMaterial]:
        """The scene's surfaces; raises InputError if it can't be loaded or traced."""
        surfaces = shape_materials(load_scene(self.world))
        check_traceable(surfaces, self.world.name)
        return surfaces

    @cached_property
    def _bounces(self) -> Choice:
        """The setting `bounces`, or the value chosen for the scene."""
        if self.bounces is not None:
            return Choice("bounces", self.bounces, _SET)
        if self.world.bounces is not None:
            return Choice("bounces", self.world.bounces, _DECLARED)
        return choose_bounces(self.surfaces)

    @cached_property
    def _caustics(self) -> Choice:
        """The setting `caustics`, or the value chosen for the scene."""
        if self.caustics is not None:
            return Choice("caustics", self.caustics, _SET)
        if self.world.caustics is not None:
            return Choice("caustics", self.world.caustics, _DECLARED)
        return choose_caustics(self.surfaces, self._bounces.value)

    @property
    def _projectors(self) -> Choice:
        """The setting `projectors`, or the choice made by a file."""
        if self.projectors is not None or self.scene in WORLDS:
            return Choice("projectors", self.projectors, _SET)
        if self.cameras is not None:
            return Choice("projectors", "coaxial", "cameras is set, and projectors isn't")
        if self.world.projectors is None:
            return Choice("projectors", "coaxial", "the file has no emitter of type projector")
        return Choice("projectors", "the file's", "its first emitter of type projector")

    @property
    def choices(self) -> list[Choice]:
        """Values chosen for settings that are null."""
        choices = self._projectors, self._bounces, self._caustics
        return [choice for choice in choices if choice.reason != _SET]

    @property
    def omissions(self) -> list[str]:
        """Sentences on light of the scene that isn't recorded correctly."""
        light = self.light
        return omissions_of(self.surfaces, light.bounces, caustics=light.caustics)

    @property
    def obstacles(self) -> list[str]:
        """Sentences on missing software for recording; none if it is recorded already."""
        if MitsubaScene(self).is_recorded:
            return []
        obstacle = missing_llvm(f"scene {self.world.name}")
        return [] if obstacle is None else [obstacle]

    @property
    def is_coaxial(self) -> bool:
        """True if camera and projector share their rays."""
        return self.projectors is None and (
            self.cameras is not None or self.world.projectors is None
        )

    @property
    def camera_side(self) -> Side:
        """The cameras."""
        views = self.cameras or self.world.cameras
        return Side.of(views, self.shape)

    @property
    def projector_side(self) -> Side:
        """The projectors."""
        if self.is_coaxial:
            return self.camera_side
        views = self.projectors or self.world.projectors or ()
        return Side.of(views, self.projector_shape or self.shape)

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
        """Rows and columns of views: one row of all cameras."""
        return 1, len(self.camera_side.pinholes)

    @model_validator(mode="after")
    def _can_be_made(self) -> Self:
        if self.is_coaxial and self.projector_shape not in {None, self.shape}:
            raise ValueError(
                f"projector_shape is {self.projector_shape}; a coaxial rig has one shape for "
                "cameras and projectors: remove projector_shape, or set projectors"
            )
        return self


class MitsubaScene(Scene):
    """A physically based scene, traced by Mitsuba 3."""

    Options: ClassVar[type[SceneSettings]] = MitsubaOptions

    def __init__(self, options: MitsubaOptions) -> None:
        self.options, self.world, self.light = options, options.world, options.light
        self.camera, self.projector = options.camera_side, options.projector_side
        self.coaxial = options.is_coaxial
        super().__init__(self.camera.domain, self.projector.domain, options.channels)

    def describe(self) -> dict[str, Any]:
        """Plain data of everything that determines the transport, for fingerprints."""
        return {
            "scene": "mitsuba",
            "world": self.world.describe(),
            "camera": self.camera.describe(),
            "projector": self.projector.describe(),
            "light": self.light.describe(),
            "coaxial": self.coaxial,
            "channels": self.channels,
            "mitsuba": metadata.version("mitsuba"),
        }

    @cached_property
    def recording(self) -> Recording:
        """The recorded matrix; recorded at the first access."""
        sides = self.camera, self.projector
        return record(self._load, *sides, self.light, self._folder, coaxial=self.coaxial)

    @property
    def is_recorded(self) -> bool:
        """True if the matrix is recorded already."""
        return is_recorded(self._folder)

    @property
    def _folder(self) -> Path:
        """Folder of the recorded matrix."""
        described = {**self.describe(), "channels": 3}
        return Path(self.options.cache) / f"{self.world.name}-{fingerprint(described)[:12]}"

    @property
    def recorded(self) -> dict[str, Any]:
        """Noise and software versions of the recording, see `Scene.recorded`."""
        return {"grain": self.recording.noise["half_lit"], "versions": self.recording.versions}

    def _load(self) -> Any:
        """Load the scene for tracing, with warnings about light that isn't recorded."""
        obstacle = missing_llvm(f"scene {self.world.name}")
        if obstacle is not None:
            raise InputError(obstacle)
        for sentence in self.options.omissions:
            warnings.warn(f"scene {self.world.name}: {sentence}", stacklevel=2)
        return load_scene(self.world)

    def apply(self, patterns: ArrayLike) -> NDArray[np.float32]:
        """Radiance float32 (B, M, C) under patterns (B, N) or (B, *projector_shape).

        Raises InputError where no light reaches the camera, or LLVM is missing.
        """
        return apply_in_batches(
            self._radiance,
            patterns,
            self.projector_shape,
            self.channels,
            self.camera.rays,
            padded=False,
        )

    def _radiance(self, weights: Double) -> Double:
        """Multiply the recorded matrix by patterns (N, B): radiance (M, B, C)."""
        return product(self._pieces, self.recording.coaxial, weights, self.camera.rays)

    @cached_property
    def _pieces(self) -> list[Piece]:
        """The recorded matrix in memory."""
        return self.recording.read((self.camera.rays, self.projector.rays), self.channels)

    def dense(self, channel: int = 0) -> Double:
        """The full matrix (M, N) of one channel."""
        shape = self.camera.rays, self.projector.rays
        return dense(self._pieces, self.recording.coaxial, channel, shape)
