"""Physically based scenes of our own, each by name, and what each tests."""

from rfpipe.scenes.mitsuba.world import World
from rfpipe.scenes.mitsuba.worlds.boxes import BOXES

__all__ = ["WORLDS"]

WORLDS: dict[str, World] = {world.name: world for world in BOXES}
