"""Physically based scenes of our own, each by name, and what each tests."""

from rfpipe_mitsuba.world import World
from rfpipe_mitsuba.worlds.boxes import BOXES
from rfpipe_mitsuba.worlds.clear import CLEAR
from rfpipe_mitsuba.worlds.shiny import SHINY
from rfpipe_mitsuba.worlds.still_lifes import STILL_LIFES

__all__ = ["WORLDS"]

WORLDS: dict[str, World] = {world.name: world for world in (*BOXES, *SHINY, *CLEAR, *STILL_LIFES)}
