"""Checks of headers together: relative exposures, and transfer curves."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError
from rfpipe.pictures.records import Header

__all__ = ["encoding_note", "relative_exposures"]

SAME_EXPOSURE = 1.01
"""Largest ratio of exposures that count as equal."""


def relative_exposures(headers: Sequence[Header], names: Sequence[str]) -> NDArray[np.float64]:
    """Compute the exposure of each picture, by which its linear values are divided.

    Parameters
    ----------
    headers : sequence of K Header
    names : sequence of K str
        Names of the pictures, for messages.

    Returns
    -------
    ndarray of float64, shape (K,)
        Exposure time in seconds, times sensitivity over squared f-number, both relative to the
        first picture's. All 1 where exposures differ by less than 1 %, or no file states any.

    Raises
    ------
    InputError
        When some files state a time, a sensitivity or an aperture and others don't, or when
        sensitivity or aperture differ and no file states a time.
    """
    seconds = _column(headers, names, "exposure_s", "exposure time")
    iso = _column(headers, names, "iso", "sensitivity (ISO)")
    f_number = _column(headers, names, "f_number", "aperture (f-number)")
    exposures = seconds * (iso / iso[:1]) / (f_number / f_number[:1]) ** 2
    if exposures.size == 0 or exposures.max() <= SAME_EXPOSURE * exposures.min():
        return np.ones(len(headers))
    if headers[0].exposure_s is None:
        differing = int(np.argmax(np.abs(np.log(exposures / exposures[0]))))
        raise InputError(
            f"{names[differing]}: has another sensitivity or aperture than {names[0]}, and no "
            "file states its exposure time",
            remedy="Give files with their metadata, or take all pictures alike",
        )
    return exposures


def _column(
    headers: Sequence[Header], names: Sequence[str], attribute: str, title: str
) -> NDArray[np.float64]:
    """Return one quantity of all headers, ones where none has it; InputError where some lack it."""
    values = [getattr(header, attribute) for header in headers]
    missing = [name for name, value in zip(names, values, strict=True) if value is None]
    if len(missing) == len(values):
        return np.ones(len(values))
    if missing:
        example = next(
            f"{name} has {value:g}" for name, value in zip(names, values, strict=True) if value
        )
        more = f", as {len(missing) - 1} more" if len(missing) > 1 else ""
        raise InputError(
            f"{missing[0]}: states no {title}{more}, but {example}",
            remedy="Give files that all have their metadata, or none",
        )
    return np.array(values, np.float64)


def encoding_note(
    headers: Sequence[Header], names: Sequence[str], transfer: str | None
) -> str | None:
    """Describe pictures whose files state a transfer curve, when none was chosen.

    Parameters
    ----------
    headers, names
        As `relative_exposures`.
    transfer : str or None
        The curve that the user chose; None when he didn't.

    Returns
    -------
    str or None
        One line; None where the user chose, or all files are linear or state nothing.
    """
    if transfer is not None:
        return None
    curved = [
        (name, header.encoding)
        for name, header in zip(names, headers, strict=True)
        if header.encoding in ("srgb", "other")
    ]
    if not curved:
        return None
    name, encoding = curved[0]
    more = f" and {len(curved) - 1} more" if len(curved) > 1 else ""
    curve = "sRGB" if encoding == "srgb" else "a profile that is not linear"
    advice = "--transfer srgb undoes sRGB's curve" if encoding == "srgb" else "save linear TIFF"
    return (
        f"{name}{more}: {curve}, but taken as linear light, since no --transfer is given; {advice}"
    )
