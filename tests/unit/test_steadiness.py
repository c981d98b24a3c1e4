"""Causes of changes between pictures of one pattern: gain, lamp, room light, frame queue."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from rfpipe.photometry import CameraModel
from rfpipe.provenance import generator
from rfpipe.references.placement import placement_of
from rfpipe.references.steadiness import (
    Samples,
    faults_of_reference_brackets,
    is_smooth,
    sample_pixels,
    unsteadiness_of,
)
from rfpipe.rigs import stale
from rfpipe.rigs.faults import CAPTURE
from rfpipe.rigs.stale import StaleWatch

CAMERA = CameraModel()
SHAPE = (24, 30)
TEXTURE = generator(5).random(SHAPE) * 0.8

Light = Callable[[int, int], Any]
"""Gain and room light of an exposure of a bracket, by their numbers."""


def brackets(light: Light, count: int, image: Any, camera: CameraModel = CAMERA) -> Any:
    """Return sampled brackets (count, E, n) of an image under changing light."""
    pictures = []
    for bracket in range(count):
        frames = []
        for number, exposure in enumerate(camera.exposures):
            gain, room = light(bracket, number)
            radiance = (gain * image + room)[..., None].astype(np.float32)
            single = replace(camera, exposures=(exposure,))
            frames.append(single.expose(radiance, 1, (bracket, number))[0])
        pictures.append(sample_pixels(np.stack(frames)))
    return np.stack(pictures)


def references(light: Light, camera: CameraModel = CAMERA) -> tuple[Any, Any]:
    black, white = np.zeros(SHAPE), TEXTURE
    blacks = brackets(light, 8, black, camera)
    return blacks, brackets(lambda n, e: light(n + 8, e), 32, white, camera)


def jitter(size: float) -> Light:
    return lambda bracket, _: (np.exp(size * generator(2, bracket).standard_normal()), 0.0)


def flicker(size: float) -> Light:
    """Return flicker that is weaker for longer exposures."""

    def light(bracket: int, number: int) -> tuple[float, float]:
        phase = generator(3, bracket, number).random() * 2 * np.pi
        return 1 + size / 4**number * np.cos(phase), 0.0

    return light


FAULTS: dict[str, tuple[Light, list[str]]] = {
    "nothing": (lambda *_: (1.0, 0.0), []),
    "a lamp that drifts": (lambda bracket, _: (1 - 0.002 * bracket, 0.0), []),
    "a lamp that jumps": (lambda bracket, _: (1.0 if bracket < 20 else 0.9, 0.0), []),
    "gain, a little": (jitter(0.001), []),
    "gain": (jitter(0.1), ["gain"]),
    "gain, worth a word": (jitter(0.01), ["gain"]),
    "flicker": (flicker(0.2), ["flicker"]),
    "a room that gets brighter": (lambda bracket, _: (1.0, 0.0005 * bracket), ["room"]),
    "a room that is bright": (lambda *_: (1.0, 0.05), []),
    "a room with a shadow": (lambda bracket, _: (1.0, 0.03 * (20 < bracket < 30)), ["room"]),
}


@pytest.mark.parametrize("name", FAULTS)
@pytest.mark.parametrize("dimmer", [1, 16])
def test_reference_brackets_reveal_the_change(name: str, dimmer: int) -> None:
    light, expected = FAULTS[name]
    electrons = CAMERA.electrons_per_radiance / dimmer
    camera = replace(CAMERA, electrons_per_radiance=electrons)
    faults = faults_of_reference_brackets(*references(light, camera), camera)
    assert [fault.kind for fault in faults] == expected, faults
    if name == "gain":
        assert faults[0].size == pytest.approx(0.1, rel=0.4)
        assert faults[0].exceeds(CAPTURE)
    if name == "gain, worth a word":
        assert not faults[0].exceeds(CAPTURE)


@pytest.mark.parametrize("columns", [200, 202, 204])
@pytest.mark.parametrize("rows", [200, 400, 1000])
def test_samples_contain_every_colour_of_a_mosaic(rows: int, columns: int) -> None:
    colours = np.tile([[0, 1], [2, 3]], (rows // 2, columns // 2))
    assert np.unique(sample_pixels(colours[None])).tolist() == [0, 1, 2, 3]


def test_a_queue_of_stale_frames_is_named() -> None:
    blacks, whites = references(lambda *_: (1.0, 0.0))
    late = np.concatenate([blacks[-1:], whites[:-1]])
    rotated = np.roll(whites, 1, axis=1)
    for wrong in (late, rotated):
        (fault,) = faults_of_reference_brackets(blacks, wrong, CAMERA)
        assert fault.kind == "late"
        assert "queue" in fault.text


def test_one_exposure_cannot_distinguish_gain_from_flicker() -> None:
    camera = replace(CAMERA, exposures=(1 / 64,))
    faults = faults_of_reference_brackets(*references(jitter(0.1), camera), camera)
    assert [fault.kind for fault in faults] == ["unsteady"]
    assert "automatic gain" in faults[0].text
    assert "whole periods" in faults[0].text


def test_few_pictures_are_judged_without_smoothing() -> None:
    for count in (2, 4):
        steady = Samples(brackets(lambda *_: (1.0, 0.0), count, TEXTURE), np.full((4, 1), 64.0))
        assert unsteadiness_of(steady, CAMERA) is None
    unsteady = Samples(brackets(jitter(0.1), 4, TEXTURE), np.full((4, 1), 64.0))
    unsteadiness = unsteadiness_of(unsteady, CAMERA)
    assert unsteadiness is not None
    assert unsteadiness.exceeds(CAPTURE)
    single = Samples(brackets(jitter(0.1), 1, TEXTURE), np.full((4, 1), 64.0))
    assert unsteadiness_of(single, CAMERA) is None


def test_black_pictures_without_light_change_nothing() -> None:
    blacks = brackets(lambda *_: (1.0, 0.0), 8, np.zeros(SHAPE))
    assert faults_of_reference_brackets(blacks, blacks, CAMERA) == []


@pytest.mark.parametrize(
    ("gains", "smooth"),
    [
        (1 - 0.01 * np.arange(12), True),
        (np.repeat([1.0, 0.9], 6), True),
        (np.exp(0.1 * generator(1).standard_normal(12)), False),
        (1 - 0.01 * np.arange(12) + 0.1 * generator(1).standard_normal(12), False),
        (np.array([1.0, 0.9, 1.1]), True),  # too few pictures
    ],
)
def test_drift_is_smooth_and_gain_is_not(gains: Any, smooth: bool) -> None:
    assert is_smooth(gains[:, None]) is smooth


def half(image: Any) -> Any:
    columns = np.arange(image.shape[-1])
    return np.where(columns < image.shape[-1] // 2, image, 0)


PLACES: dict[str, tuple[Callable[[Any], Any], str]] = {
    "in place": (lambda pattern: pattern, ""),
    "mirrored": (lambda pattern: pattern[..., ::-1], "mirrored left to right"),
    "upside down": (lambda pattern: pattern[..., ::-1, ::-1], "upside down"),
    "flipped": (lambda pattern: pattern[..., ::-1, :], "mirrored top to bottom"),
    "moved": (lambda pattern: np.roll(pattern, (1, -2), axis=(-2, -1)), "1 ray down 2 rays left"),
    "half a ray": (
        lambda pattern: 0.5 * (pattern + np.roll(pattern, 1, axis=-1)), ""
    ),
    "half": (half, "50% of the rays, at the right edge"),
}  # fmt: skip


@pytest.mark.parametrize("name", PLACES)
@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize("indirect", [0.05, 0.3])
def test_faults_of_placement_are_named(name: str, count: int, indirect: float) -> None:
    projected, expected = PLACES[name]
    signs = generator(7).integers(0, 2, (count, *SHAPE)) * 2.0 - 1
    albedo = generator(8).choice(
        [0.02, 0.2, 0.9], SHAPE
    )  # black surfaces don't count as missing light

    def seen(patterns: Any) -> Any:
        light = projected(np.asarray(patterns))
        return albedo * (light + indirect * light.mean(axis=(-2, -1), keepdims=True))

    floodlit = seen(np.ones((1, *SHAPE)))[0]
    text = placement_of(signs, seen((signs + 1) / 2), floodlit).text
    assert (expected in text) if expected else text == ""


def test_a_cavity_has_no_missing_light() -> None:
    signs = generator(7).integers(0, 2, (6, *SHAPE)) * 2.0 - 1
    pictures = np.broadcast_to((signs + 1).mean(axis=(1, 2), keepdims=True) / 2, signs.shape)
    assert placement_of(signs, pictures, np.ones(SHAPE)).text == ""
    assert placement_of(signs, 0 * pictures, np.zeros(SHAPE)).text == ""


def picture(number: int) -> Any:
    return 0.3 * (generator(number).random(SHAPE) < 0.5).astype(np.float32)


def frames(image: Any, *gains: float, seed: int = 0) -> Any:
    gains = gains or (1.0,) * 4
    pictures = [
        replace(CAMERA, exposures=(exposure,)).expose(
            (gain * image)[..., None].astype(np.float32), seed, (number,)
        )[0]
        for number, (gain, exposure) in enumerate(zip(gains, CAMERA.exposures, strict=True))
    ]
    return np.stack(pictures)


@pytest.mark.parametrize(
    ("second", "repeated", "counted", "message"),
    [
        (frames(picture(2)), None, {}, ""),
        (frames(picture(1), seed=1), frames(picture(2)), {"doubted": 1, "stale": 1}, "queue"),
        (frames(picture(2), 0.4, 1, 1, 1), frames(picture(2), 1, 1, 1, 1),
         {"doubted": 1, "unsteady": 1}, "whole periods"),
    ],
)  # fmt: skip
def test_frames_of_the_previous_picture_are_distinguished_from_flicker(
    second: Any,
    repeated: Any,
    counted: dict[str, int],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(stale, "RETAKE_SECONDS", 0.0)
    watch = StaleWatch(CAMERA)
    watch.capture("first", picture(1), lambda: frames(picture(1)))
    takes = iter([second, repeated])
    watch.capture("second", picture(2), lambda: next(takes))
    assert watch.statistics == {"doubted": 0, "stale": 0, "unsteady": 0, **counted}
    assert message in caplog.text
    assert bool(caplog.text) is bool(message)
