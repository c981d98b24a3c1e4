"""The dot test of operators, and assertions that the contract tests share."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import AbstractContextManager, closing, nullcontext
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import CaptureError
from rfpipe.provenance import generator

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

    from rfpipe.transport import Transport


def require(holds: bool | np.bool_, message: str) -> None:
    """Raise AssertionError unless a condition holds, also under ``python -O``."""
    if not holds:
        raise AssertionError(message)


def require_close(actual: NDArray[Any], expected: NDArray[Any], error: float, what: str) -> None:
    """Raise AssertionError where the relative error (Frobenius) is above `error`."""
    expected = np.asarray(expected, np.float64)
    off, scale = float(np.linalg.norm(actual - expected)), float(np.linalg.norm(expected))
    require(off <= error * scale, f"{what} is {off:.3g} off of {scale:.3g}, more than {error:g}")


def require_raises(kind: type[Exception], call: Callable[..., Any], *arguments: Any) -> str:
    """Return the message of the expected exception; raise AssertionError if a call succeeds."""
    try:
        call(*arguments)
    except kind as error:
        return str(error)
    raise AssertionError(f"{call} took {arguments} without raising {kind.__name__}")


def require_equal_descriptions(make: Callable[[], Any], use: Callable[[Any], object]) -> None:
    """Raise AssertionError unless two equal objects have equal descriptions, before and after use.

    Descriptions must be plain data that JSON can store.
    """
    described = []
    for _ in range(2):
        with opened(make()) as subject:
            described.append(json.dumps(subject.describe(), sort_keys=True))
            use(subject)
            described.append(json.dumps(subject.describe(), sort_keys=True))
    message = f"describe() differs after use, or between equal objects: {described}"
    require(len(set(described)) == 1, message)


def require_closing(make: Callable[[], Any], use: Callable[[Any], object]) -> None:
    """Check descriptions, and that the use of a closed object raises CaptureError."""
    require_equal_descriptions(make, use)
    with opened(make()) as subject:
        subject.close()
        require_raises(CaptureError, use, subject)


def opened(made: Any) -> AbstractContextManager[Any]:
    """Return a context manager that closes an object, if it has a `close` method."""
    return closing(made) if hasattr(made, "close") else nullcontext(made)


def dot_test(
    operator: Transport | LinearOperator | NDArray[Any], tolerance: float = 1e-5, seed: int = 0
) -> float:
    """Check that an operator agrees with its transpose: ``(T p) . c = p . (T^T c)``.

    Parameters
    ----------
    operator : transport, LinearOperator or matrix
        A transport is tested channel by channel.
    tolerance : float
        Largest relative difference allowed; float32 arithmetic reaches about 1e-6.
    seed : int
        Seed of the random ``p`` and ``c``, uniform in [0, 1). With non-negative transport no
        terms cancel.

    Returns
    -------
    float
        The largest relative difference.

    Raises
    ------
    AssertionError
        When the difference is above `tolerance`, or not a number.
    """
    from scipy.sparse.linalg import aslinearoperator

    operand: Any = operator
    if hasattr(operand, "channel"):
        channels = map(operand.channel, range(operand.channels))
        return max(dot_test(channel, tolerance, seed) for channel in channels)
    linear = aslinearoperator(operand)
    random = generator(seed)
    pattern, image = (random.random(extent) for extent in reversed(linear.shape))
    product = np.asarray(linear.matvec(pattern), np.float64)
    dual = np.asarray(linear.rmatvec(image), np.float64)
    forward, backward = float(image @ product), float(dual @ pattern)
    # where terms cancel, the sum of their magnitudes is the scale of the rounding
    scale = max(float(image @ np.abs(product)), float(np.abs(dual) @ pattern))
    difference = abs(forward - backward) / scale if scale else 0.0
    require(
        difference <= tolerance,
        f"(T p) . c = {forward:.9g} but p . (T^T c) = {backward:.9g}: relative difference "
        f"{difference:.3g}, allowed {tolerance:.3g}",
    )
    return difference
