"""Physically based scenes of our own, each by name, and what each tests."""

from rfpipe.scenes.mitsuba.world import World
from rfpipe.scenes.mitsuba.worlds.boxes import BOXES
from rfpipe.scenes.mitsuba.worlds.clear import CLEAR
from rfpipe.scenes.mitsuba.worlds.shiny import SHINY
from rfpipe.scenes.mitsuba.worlds.still_lifes import STILL_LIFES

__all__ = ["WORLDS"]

WORLDS: dict[str, World] = {world.name: world for world in (*BOXES, *SHINY, *CLEAR, *STILL_LIFES)}
