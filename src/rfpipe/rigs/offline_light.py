"""Checks of the light in offline pictures: gain, lamp, room and motion.

A sheet begins with a marker and its complement, and ends with the complement; the first sheet also
has black and white pictures. These are check pictures, see `rfpipe.rigs.check_pictures`; their time
is counted in pictures.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rfpipe.photometry.camera import CameraModel
from rfpipe.rigs.check_pictures import (
    BLACK,
    COMPLEMENT,
    PATTERN,
    WHITE,
    CheckPicture,
    LightSeries,
    References,
    fit_picture,
    light_series,
    ratios_of_brackets,
    saturated_from,
)
from rfpipe.rigs.diagnosis import light_fault, motion, room_change
from rfpipe.rigs.faults import OFFLINE, SIGNIFICANCE, Fault, ends_fault, room_fault
from rfpipe.rigs.noise import CountNoise
from rfpipe.rigs.offline import SheetPicture
from rfpipe.units import BLACK_LEVEL_KEY, FLOODLIT_KEY

_KINDS = {BLACK_LEVEL_KEY: BLACK, FLOODLIT_KEY: WHITE}


def light_faults(
    shown: Sequence[SheetPicture], frames: Sequence[NDArray[np.float32]], sensor: CameraModel
) -> list[Fault]:
    """Find faults of the light in a sheet's pictures, the one to mend first first.

    Parameters
    ----------
    shown : sequence of SheetPicture
        Marker, complement, patterns, complement.
    frames : sequence of ndarray of float32, shape (E, n)
        Bracket of each picture.
    sensor : CameraModel
    """
    pictures = [
        CheckPicture(
            kind, int(index == len(shown) - 1), float(index), _linear(frames[index], sensor)
        )
        for index, kind in enumerate(map(_kind_of, shown))
        if kind is not None
    ]
    references = _references(pictures, sensor)
    if not references.has_light:
        return []
    room = room_change(pictures, references, OFFLINE.room) or _room_at_end(pictures[-1], references)
    faults = [room, motion(pictures[2:], references, OFFLINE.moved)]
    if faults[1] is None:
        lit = [
            _linear(bracket, sensor)
            for bracket, picture in zip(frames, shown, strict=True)
            if _kind_of(picture) != BLACK
        ]
        ratio, ratio_error = ratios_of_brackets(lit, references)
        series = _series(pictures, references)._replace(ratio=ratio, ratio_error=ratio_error)
        fault = light_fault(series, references.exposures, OFFLINE.light, references.unit)
        # two pictures don't distinguish a drift of the lamp from a change of gain
        is_unknown = len(series.gain) == 2 and fault is not None and fault.kind != "flicker"
        faults.append(ends_fault(_last_change(series)) if is_unknown else fault)
    return [fault for fault in faults if fault is not None]


def _room_at_end(last: CheckPicture, references: References) -> Fault | None:
    """Find a change of the room's light between the first pictures and the last one."""
    fit = fit_picture(last, references)
    relative = fit.room / np.array(references.exposures) / references.white_rate
    error = fit.room_error / np.array(references.exposures) / references.white_rate
    if not np.isfinite(error).any():
        return None
    best = int(np.nanargmin(error))
    change = float(abs(relative[best]))
    if change < max(OFFLINE.room, SIGNIFICANCE * error[best]):
        return None
    return room_fault(change, f"in {last.seconds:.2g} {references.unit}")


def _last_change(series: LightSeries) -> float:
    """Relative change of the last gain, in the exposure with the smallest error."""
    best = int(np.nanargmin(series.error[-1]))
    return float(series.gain[-1, best] - 1)


def _kind_of(shown: SheetPicture) -> int | None:
    """Kind of check picture; None for the patterns of the acquisition."""
    if shown.key is None:
        return PATTERN if shown.file.startswith("0000") else COMPLEMENT
    return _KINDS.get(shown.key[0])


def _linear(frames: NDArray[np.float32], sensor: CameraModel) -> NDArray[np.float32]:
    """Undo the camera's response, so that counts above black are proportional to light."""
    if sensor.response_gamma == 1:
        return frames
    span = sensor.white_level - sensor.black_level_counts
    light = np.maximum(frames - sensor.black_level_counts, 0) / span
    linear = sensor.black_level_counts + span * light**sensor.response_gamma
    return np.asarray(linear, np.float32)


def _references(pictures: Sequence[CheckPicture], sensor: CameraModel) -> References:
    """Take references from marker and complement, and their noise from the camera's settings."""
    black = [picture.frames for picture in pictures if picture.kind == BLACK]
    nominal = np.full_like(pictures[0].frames, sensor.black_level_counts)
    frames = np.stack(
        [np.mean(black or [nominal], axis=0), pictures[0].frames, pictures[1].frames]
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


def _series(pictures: Sequence[CheckPicture], references: References) -> LightSeries:
    """Compute the gains of the marker, its complement, the white pictures, and the last complement.

    White pictures are the sum of marker and complement, so that their solutions x_P and x_Q give
    the gains of these two. Without white pictures, only the two pictures of the complement have
    gains.
    """
    last = fit_picture(pictures[-1], references)
    white = [picture for picture in pictures if picture.kind == WHITE]
    if not white:
        gain = np.stack([np.ones_like(last.gain), last.gain])
        error = np.stack([last.gain_error, last.gain_error])
        return light_series([pictures[1], pictures[-1]], references, gain, error)
    fits = [fit_picture(picture, references) for picture in white]
    base = np.mean([fit.solution for fit in fits], axis=0)[:, :2]
    gains = [
        1 / base[:, 0],
        1 / base[:, 1],
        *((fit.solution[:, :2] / base).mean(axis=1) for fit in fits),
        last.gain / base[:, 1],
    ]
    errors = [fit.gain_error for fit in (fits[0], fits[0], *fits, last)]
    lit = [pictures[0], pictures[1], *white, pictures[-1]]
    return light_series(lit, references, np.array(gains), np.array(errors))
