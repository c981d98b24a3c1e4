"""The dot test for operators."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.provenance import generator
from rfpipe.testing.checks import require

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

    from rfpipe.transport import Transport


def dot_test(
    operator: Transport | LinearOperator | NDArray[Any], tolerance: float = 1e-5, seed: int = 0
) -> float:
    """Check that an operator and its transpose belong together: ``(T p) . c = p . (T^T c)``.

    Parameters
    ----------
    operator : transport, LinearOperator or matrix
        A transport is tested channel by channel.
    tolerance : float
        Largest relative difference allowed; float32 arithmetic reaches about 1e-6.
    seed : int
        Seed of the random ``p`` and ``c``, uniform in [0, 1): with non-negative transport no
        terms cancel.

    Returns
    -------
    float
        The largest relative difference found.

    Raises
    ------
    AssertionError
        When the difference is above `tolerance`, or not a number.
    """
    from scipy.sparse.linalg import aslinearoperator

    given: Any = operator
    if hasattr(given, "channel"):
        channels = map(given.channel, range(given.channels))
        return max(dot_test(channel, tolerance, seed) for channel in channels)
    linear = aslinearoperator(given)
    random = generator(seed)
    pattern, image = (random.random(extent) for extent in reversed(linear.shape))
    seen = np.asarray(linear.matvec(pattern), np.float64)
    dual = np.asarray(linear.rmatvec(image), np.float64)
    forward, backward = float(image @ seen), float(dual @ pattern)
    # where terms cancel, the sum of their magnitudes is the scale of the rounding
    scale = max(float(image @ np.abs(seen)), float(np.abs(dual) @ pattern))
    difference = abs(forward - backward) / scale if scale else 0.0
    require(
        difference <= tolerance,
        f"(T p) . c = {forward:.9g} but p . (T^T c) = {backward:.9g}: relative difference "
        f"{difference:.3g}, allowed {tolerance:.3g}",
    )
    return difference
