"""Physically based scenes by Mitsuba 3: the kind of scene ``mitsuba``, an extra of rfpipe."""
