"""The options of scenes of diffuse surfaces."""

from __future__ import annotations

from typing import Any, ClassVar, Literal, Self

from pydantic import Field, model_validator

from rfpipe.config.scenes import SceneSettings

__all__ = ["Diffuse", "SurfaceName"]

SurfaceName = Literal["white", "texture"]


class Diffuse(SceneSettings):
    """Diffuse surfaces, white or textured, and the light between them.

    Attributes
    ----------
    surface_names : tuple of str
        What the surfaces are called, in the order of `surfaces`.
    """

    surface_names: ClassVar[tuple[str, ...]]

    surfaces: tuple[SurfaceName, ...]
    bounces: Literal[1, 2, 3] = Field(
        3, description="Light simulated: 1 is direct light alone, 2 and 3 add inter-reflection."
    )
    seed: int = Field(0, ge=0, description="Seed of textures or paths of light, 0 or more.")

    @model_validator(mode="after")
    def _has_all_surfaces(self) -> Self:
        if len(self.surfaces) != len(self.surface_names):
            raise ValueError(
                f"kind {self.kind} should have {len(self.surface_names)} surfaces "
                f"({', '.join(self.surface_names)}), not {len(self.surfaces)} "
                f"({', '.join(self.surfaces)})"
            )
        return self

    def arguments(self) -> dict[str, Any]:
        """Return what every scene of diffuse surfaces is made with, by name."""
        names = "surfaces", "shape", "channels", "bounces", "seed"
        return {name: getattr(self, name) for name in names}
