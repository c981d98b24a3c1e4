"""Physically based scenes, traced by Mitsuba 3: the kind of scene ``mitsuba``."""
