"""Light of pictures that are taken elsewhere: gain, lamp, room and motion, by a sheet's markers.

A sheet begins with a marker and its complement, and ends with the complement; its first one has
black and white pictures, too. They are looks at the rig, see `rfpipe.rigs.looks`, of which time is
counted in pictures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.diagnosis import light_fault, motion, room_change
from rfpipe.rigs.faults import OFFLINE, SIGNIFICANCE, Fault, ends_fault, room_fault
from rfpipe.rigs.looks import (
    BLACK,
    COMPLEMENT,
    PATTERN,
    WHITE,
    Look,
    References,
    Series,
    fit_of,
    ratios_of,
    saturated_from,
    series_of,
)
from rfpipe.rigs.noise import CountNoise
from rfpipe.rigs.offline import Shown
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY

Double = NDArray[np.float64]

_PICTURES = {BLACK_LEVEL_KEY: BLACK, FLOODLIT_KEY: WHITE}


def light_faults(
    shown: Sequence[Shown], frames: Sequence[NDArray[np.float32]], sensor: CameraModel
) -> list[Fault]:
    """Return the faults of the light in a sheet's pictures, in the order of mending.

    Parameters
    ----------
    shown : sequence of Shown
        Marker, complement, others, complement.
    frames : sequence of ndarray of float32, shape (E, n)
        Bracket of each.
    sensor : CameraModel
    """
    looks = [
        Look(picture, int(index == len(shown) - 1), float(index), _linear(frames[index], sensor))
        for index, picture in enumerate(map(_picture_of, shown))
        if picture is not None
    ]
    references = _references(looks, sensor)
    if not references.has_light:
        return []
    room = room_change(looks, references, OFFLINE.room) or _room_at_end(looks[-1], references)
    faults = [room, motion(looks[2:], references, OFFLINE.moved)]
    if faults[1] is None:
        lit = [
            _linear(bracket, sensor)
            for bracket, each in zip(frames, shown, strict=True)
            if _picture_of(each) != BLACK
        ]
        ratio, ratio_error = ratios_of(lit, references)
        series = _series(looks, references)._replace(ratio=ratio, ratio_error=ratio_error)
        fault = light_fault(series, references.exposures, OFFLINE.light, references.unit)
        # the change between two pictures has either cause
        is_unknown = len(series.gain) == 2 and fault is not None and fault.kind != "flicker"
        faults.append(ends_fault(_last_change(series)) if is_unknown else fault)
    return [fault for fault in faults if fault is not None]


def _room_at_end(last: Look, references: References) -> Fault | None:
    """Return the fault of room light that is not in the last picture as in the first ones."""
    fit = fit_of(last, references)
    relative = fit.room / np.array(references.exposures) / references.white_rate
    error = fit.room_error / np.array(references.exposures) / references.white_rate
    if not np.isfinite(error).any():
        return None
    best = int(np.nanargmin(error))
    change = float(abs(relative[best]))
    if change < max(OFFLINE.room, SIGNIFICANCE * error[best]):
        return None
    return room_fault(change, f"in {last.seconds:.2g} {references.unit}")


def _last_change(series: Series) -> float:
    """Return the relative change of the last gain, in the best-known exposure."""
    best = int(np.nanargmin(series.error[-1]))
    return float(series.gain[-1, best] - 1)


def _picture_of(shown: Shown) -> int | None:
    """Return the picture of a look; None for the other patterns of a sheet."""
    if shown.key is None:
        return PATTERN if shown.file.startswith("0000") else COMPLEMENT
    return _PICTURES.get(shown.key[0])


def _linear(frames: NDArray[np.float32], sensor: CameraModel) -> NDArray[np.float32]:
    """Return counts in proportion to light."""
    if sensor.response_gamma == 1:
        return frames
    span = sensor.white_level - sensor.black_level_counts
    light = np.maximum(frames - sensor.black_level_counts, 0) / span
    linear = sensor.black_level_counts + span * light**sensor.response_gamma
    return np.asarray(linear, np.float32)


def _references(looks: Sequence[Look], sensor: CameraModel) -> References:
    """Return the references of marker and complement, and the noise by the camera's numbers."""
    black = [look.frames for look in looks if look.picture == BLACK]
    nominal = np.full_like(looks[0].frames, sensor.black_level_counts)
    frames = np.stack(
        [np.mean(black or [nominal], axis=0), looks[0].frames, looks[1].frames]
    ).astype(np.float64)
    light = np.maximum(frames[1:] - frames[0], 0).sum(axis=0)
    variance = CountNoise.of(sensor).variance(light)
    square = np.square(light).mean(axis=1)
    noise = np.full(len(square), np.inf)
    np.divide(variance.mean(axis=1), square, out=noise, where=square > 0)
    noise = np.sqrt(noise)
    return References(
        frames, np.where(noise < 0.5, noise, np.inf), tuple(sensor.exposures),
        saturated_from(sensor), 0.0, "pictures",
    )  # fmt: skip


def _series(looks: Sequence[Look], references: References) -> Series:
    """Return the gains of the marker, its complement, white pictures, and the complement again.

    White pictures are the sum of marker and complement, so that their solutions x_P and x_Q give
    the gains of these two. Without white pictures there are two gains, of the complement.
    """
    last = fit_of(looks[-1], references)
    white = [look for look in looks if look.picture == WHITE]
    if not white:
        gain = np.stack([np.ones_like(last.gain), last.gain])
        error = np.stack([last.gain_error, last.gain_error])
        return series_of([looks[1], looks[-1]], references, gain, error)
    fits = [fit_of(look, references) for look in white]
    base = np.mean([fit.solution for fit in fits], axis=0)[:, :2]
    gains = [
        1 / base[:, 0],
        1 / base[:, 1],
        *((fit.solution[:, :2] / base).mean(axis=1) for fit in fits),
        last.gain / base[:, 1],
    ]
    errors = [fit.gain_error for fit in (fits[0], fits[0], *fits, last)]
    taken = [looks[0], looks[1], *white, looks[-1]]
    return series_of(taken, references, np.array(gains), np.array(errors))
