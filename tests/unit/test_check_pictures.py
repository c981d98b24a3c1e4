"""Diagnosis of a rig's faults from check pictures, on synthetic frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from rfpipe.photometry import CameraModel
from rfpipe.rigs.check_pictures import (
    BLACK,
    COMPLEMENT,
    PATTERN,
    CheckPicture,
    References,
    fit_picture,
    thinned,
)
from rfpipe.rigs.diagnosis import diagnose
from rfpipe.rigs.faults import CALIBRATION, Fault, is_whole_period, whole_periods

CAMERA = CameraModel(exposures=(1 / 64, 1 / 8, 1 / 4))
SHAPE = (40, 40)
SERIES = (BLACK, BLACK, PATTERN, PATTERN, COMPLEMENT, COMPLEMENT) * 2
WITNESS = (PATTERN, BLACK, COMPLEMENT, PATTERN)

Gain = Callable[[int, np.random.Generator, np.ndarray], np.ndarray | float]
"""``gain(number of the picture, random, exposures)``, (E,)."""


def scene(kind: int, seed: int) -> np.ndarray:
    """Return the radiance of a textured scene under patterns, with indirect light."""
    random = np.random.default_rng(seed)
    albedo = random.uniform(0.2, 1, SHAPE)
    fields = random.integers(0, 2, (8, 8)).repeat(5, axis=0).repeat(5, axis=1)
    lit = [np.zeros(SHAPE), fields, 1 - fields][kind]
    return albedo * (0.5 * lit + 0.02 * lit.mean())


def check_pictures(
    kinds: tuple[int, ...] = SERIES,
    camera: CameraModel = CAMERA,
    *,
    first: int = 0,
    seed: int = 0,
    gain: Gain = lambda *_: 1.0,
    room: Callable[[int], float] = lambda _: 0.0,
    move: Callable[[int], int] = lambda _: 0,
    late: bool = False,
    series: int = 0,
) -> list[CheckPicture]:
    """Return check pictures; faults are functions of the number of the picture."""
    pictures, exposures = [], np.array(camera.exposures)
    random = np.random.default_rng([seed, first])
    for number, kind in enumerate(kinds, first):
        displayed = kinds[max(number - first - 1, 0)] if late else kind
        radiance = np.roll(scene(displayed, seed), move(number), axis=1) + room(number)
        factor = np.broadcast_to(gain(number, random, exposures), exposures.shape)
        frames = np.concatenate(
            [
                replace(camera, exposures=(seconds,)).expose(
                    (of_frame * radiance)[..., None].astype(np.float32), seed, (number, index)
                )
                for index, (seconds, of_frame) in enumerate(zip(exposures, factor, strict=True))
            ]
        )
        pictures.append(CheckPicture(kind, series, float(number), thinned(frames)))
    return pictures


def jitter(number: int, random: np.random.Generator, exposures: np.ndarray) -> float:
    return float(np.exp(0.1 * random.standard_normal()))


def jitter_of_frames(number: int, random: np.random.Generator, exposures: np.ndarray) -> np.ndarray:
    return np.exp(0.1 * random.standard_normal(len(exposures)))


def flicker(number: int, random: np.random.Generator, exposures: np.ndarray) -> np.ndarray:
    phase = random.uniform(0, 2 * np.pi, len(exposures))
    return 1 + 0.4 * np.sinc(100 * exposures) * np.cos(phase)


def drift(number: int, random: np.random.Generator, exposures: np.ndarray) -> float:
    return 1 - 0.003 * number


def diagnose_series(pictures: list[CheckPicture], camera: CameraModel = CAMERA) -> list[Fault]:
    return diagnose(pictures, References.of(pictures, camera), CALIBRATION)


FAULTS: dict[str, tuple[dict, str, str]] = {
    "gain": ({"gain": jitter}, "gain", "automatic gain"),
    "gain of each frame": ({"gain": jitter_of_frames}, "gain", "automatic gain"),
    "flicker": ({"gain": flicker}, "flicker", "exposures of whole periods"),
    "drift": ({"gain": drift}, "drift", "warm up"),
    "room": ({"room": lambda number: 0.002 * number}, "room", "darken the room"),
    "late": ({"late": True}, "late", "queue"),
}


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_named_with_its_remedy(name: str, seed: int) -> None:
    faults, kind, remedy = FAULTS[name]
    first = diagnose_series(check_pictures(seed=seed, **faults))[0]
    assert first.kind == kind
    assert remedy in first.text


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    "camera",
    [
        CAMERA,
        replace(CAMERA, exposures=(1 / 64,)),
        replace(CAMERA, electrons_per_radiance=20_000.0),
        replace(CAMERA, bits=8),
        replace(CAMERA, response_gamma=2.2),
    ],
    ids=["default", "one exposure", "dim", "8 bits", "gamma"],
)
def test_a_steady_rig_has_no_fault(camera: CameraModel, seed: int) -> None:
    assert diagnose_series(check_pictures(camera=camera, seed=seed), camera) == []


@pytest.mark.parametrize(("pixels", "is_moved"), [(0, False), (1, True), (3, True)])
def test_motion_between_two_series(pixels: int, is_moved: bool) -> None:
    references = References.of(check_pictures(), CAMERA)
    later = check_pictures(WITNESS, first=20, series=1, move=lambda _: pixels)
    kinds = [fault.kind for fault in diagnose(later, references, CALIBRATION)]
    assert kinds == ["moved"] * is_moved


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_after_a_clean_series_is_named(name: str, seed: int) -> None:
    faults, kind, _ = FAULTS[name]
    references = References.of(check_pictures(seed=seed), CAMERA)
    before = check_pictures(WITNESS, first=20, series=1, seed=seed)
    after = check_pictures(WITNESS, first=40, series=2, seed=seed, **faults)
    assert diagnose([*before, *after], references, CALIBRATION)[0].kind == kind


def test_pictures_without_light_show_no_fault() -> None:
    references = References.of(check_pictures(), CAMERA)
    capped = check_pictures(WITNESS, first=20, gain=lambda *_: 0.0)
    assert diagnose(capped, references, CALIBRATION) == []
    dark = check_pictures(gain=lambda *_: 0.0)
    assert not References.of(dark, CAMERA).has_light
    assert diagnose_series(dark) == []


def test_one_exposure_names_both_causes_unless_it_has_whole_periods() -> None:
    short = replace(CAMERA, exposures=(1 / 64,))
    fault = diagnose_series(check_pictures(camera=short, gain=flicker), short)[0]
    assert "automatic gain" in fault.text
    assert "whole periods" in fault.text
    averaging = replace(CAMERA, exposures=(0.05,))
    assert (
        diagnose_series(check_pictures(camera=averaging, gain=jitter), averaging)[0].kind == "gain"
    )


def test_room_light_does_not_change_the_gain() -> None:
    pictures = check_pictures(room=lambda number: 0.004 * number)
    references = References.of(pictures, CAMERA)
    gains = np.array(
        [fit_picture(picture, references).gain for picture in pictures if picture.kind != BLACK]
    )
    assert np.abs(gains[:, 0] - 1).max() < 0.02


def test_the_proposed_exposures_end_the_flicker() -> None:
    for hertz in (100, 120):
        exposures = whole_periods(CAMERA.exposures, hertz)
        assert exposures == sorted(set(exposures))
        np.testing.assert_allclose(np.array(exposures) * hertz % 1, 0, atol=1e-9)
    proposed = replace(CAMERA, exposures=tuple(whole_periods(CAMERA.exposures, 100)))
    assert diagnose_series(check_pictures(camera=proposed, gain=flicker), proposed) == []
    assert [is_whole_period(seconds) for seconds in (0.05, 0.1, 0.01, 1 / 64)] == [
        True,
        True,
        False,
        False,
    ]
