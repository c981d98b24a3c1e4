"""What the suites share."""

from __future__ import annotations

import numpy as np

__all__ = ["require"]


def require(holds: bool | np.bool_, message: str) -> None:
    """Raise AssertionError unless something holds, also where Python drops assert statements."""
    if not holds:
        raise AssertionError(message)
