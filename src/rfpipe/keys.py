"""The keys of brackets that aren't a level's patterns: what noise and journals know them by."""

from __future__ import annotations

__all__ = [
    "BLACK_LEVEL_KEY",
    "DRIFT_KEY",
    "FLOODLIT_KEY",
    "LOOK_KEY",
    "SEQUENCE_KEY",
    "SYMMETRY_KEY",
    "VERIFICATION_KEY",
    "WARM_UP_KEY",
]

BLACK_LEVEL_KEY = 1_000_000
"""First part of the keys of all-off brackets, where patterns have their level: (this, i)."""

FLOODLIT_KEY = 1_000_001
"""The same of the all-on brackets that an acquisition begins with."""

DRIFT_KEY = 1_000_002
"""The same of the all-on brackets that are repeated during a level: (this, level, i)."""

WARM_UP_KEY = 1_000_003
"""The same of those that are shown while the lamp warms up, and not kept."""

SYMMETRY_KEY = 1_000_004
"""The same of the random patterns that tell whether a rig is coaxial: (this, i)."""

VERIFICATION_KEY = 1_000_005
"""The same of pictures that no method saw, taken to verify a transport: (this, i)."""

LOOK_KEY = 1_000_006
"""The same of the random pattern that tells, repeated, whether the rig moved: (this, level, i)."""

SEQUENCE_KEY = 1_000_007
"""The same of what a sequence shows beside its patterns: (this, ...)."""
