"""Differences between settings, for messages about stores of other settings."""

from __future__ import annotations

import json
import re
from typing import Any

_MAX_DIFFERENCES = 12
_MAX_VALUE_LENGTH = 100
_PROSE = ".verdict"  # end of the name of a setting whose value is a sentence
_DIGEST = re.compile("[0-9a-f]{12,}")


def differing(old: dict[str, Any], new: dict[str, Any]) -> str:
    """List the settings that differ, such as ``patterns 64 -> 72, rig.seed 1 -> 2``.

    The shortest come first. Settings whose values are digests or sentences come last, without
    their values.
    """
    import pandas as pd

    plain = (json.loads(json.dumps(settings, sort_keys=True)) for settings in (old, new))
    before, after = (
        {str(name): str(values[0]) for name, values in pd.json_normalize([settings]).items()}
        for settings in plain
    )
    values = {
        name: (before.get(name, "unset"), after.get(name, "unset"))
        for name in sorted({*before, *after})
        if before.get(name) != after.get(name)
    }
    readable = {
        name
        for name, pair in values.items()
        if not name.endswith(_PROSE) and all(map(_is_readable, pair))
    }
    changed = sorted((f"{name} {' -> '.join(values[name])}" for name in readable), key=len)
    changed += [f"{name} changed" for name in values if name not in readable]
    more = len(changed) - _MAX_DIFFERENCES
    if more > 0:
        changed[_MAX_DIFFERENCES:] = [f"and {more} more"]
    return ", ".join(changed)


def _is_readable(value: str) -> bool:
    """Test whether a value is short and not a digest."""
    return len(value) <= _MAX_VALUE_LENGTH and not _DIGEST.fullmatch(value)
