"""Comparison of an acquisition's errors with its targets."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

_QUANTITIES = (
    ("error", "target_error", "estimated_error"),
    ("error of indirect light", "target_indirect", "estimated_indirect"),
)


class Miss(NamedTuple):
    """Error above its target.

    Attributes
    ----------
    quantity : {"error", "error of indirect light"}
    error, target, accepted : float
        Relative, see `rfpipe.relighting.picture_errors`; errors up to `accepted` meet the target.
    estimate : float or None
        Error as the method estimated it.
    is_estimate : bool
        Whether `error` is that estimate, because none was measured.
    """

    quantity: str
    error: float
    target: float
    accepted: float
    estimate: float | None
    is_estimate: bool


def misses(
    options: Mapping[str, Any],
    measured: tuple[float | None, float | None],
    estimated: Mapping[str, Any],
    margin: float = 1.0,
) -> Iterator[Miss]:
    """Yield the mean errors, in total and of indirect light, that are above their targets.

    Parameters
    ----------
    options : mapping
        Options of the method, of which ``target_error`` and ``target_indirect`` are compared.
    measured : (float or None, float or None)
        Measured mean errors, in total and of indirect light; None to compare the estimate.
    estimated : mapping
        ``estimated_error`` and ``estimated_indirect`` of the last level that has them.
    margin : float
        Factor on the target up to which a measured error meets it.
    """
    for (quantity, target_name, name), measurement in zip(_QUANTITIES, measured, strict=True):
        target, estimate = options.get(target_name), estimated.get(name)
        error = estimate if measurement is None else measurement
        if error is None or target is None:
            continue
        accepted = target * (1.0 if measurement is None else margin)
        if error > accepted:
            yield Miss(quantity, error, target, accepted, estimate, measurement is None)
