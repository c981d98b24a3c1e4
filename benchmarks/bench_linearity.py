"""Which cameras calibration calls linear, before scenes of few tones and of many.

Usage: ``python -m benchmarks.bench_linearity [SEED ...]``, 0 to 19 by default (minutes). Cameras
of exponents 1, 0.8, 1.1 and 1.25, of which each has photon noise, few bits, no noise at all with
counts that are rounded or cut, offsets of photosites, or the same noise in each picture. A seed
gives noise and brightness. The table counts the verdicts that are linear, can't tell, and not
linear, and has the largest relative error of the exponents that are to be undone. Writes
results/bench/linearity.csv.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import replace
from itertools import count, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import write
from rfpipe.calibration.bench import Bench
from rfpipe.calibration.black import measure_dark
from rfpipe.calibration.responses import measure_linearity
from rfpipe.config import CalibrationConfig
from rfpipe.photometry import CameraModel

SIDE = 64
SCENES: dict[str, tuple[float, ...]] = {
    ".6": (0.6,),
    ".2 .7": (0.2, 0.7),
    ".2 .5": (0.2, 0.5),
    ".2 .8": (0.2, 0.8),
    ".15 .6": (0.15, 0.6),
    ".3 .9": (0.3, 0.9),
    ".1 .4 .9": (0.1, 0.4, 0.9),
    "many": tuple(np.linspace(0.05, 1, SIDE)),
}
WORDS = ("linear", "can't tell", "not linear")
EXPONENTS = (1.0, 0.8, 1.1, 1.25)

Array = NDArray[Any]
Convert = Callable[[Array], Array]


class Projector:
    """A projector of gamma 2.2, which lights a scene."""

    shape = SIDE, SIDE

    def show(self, picture: Array) -> None:
        """Show a picture."""
        self.light = np.asarray(picture, float) ** 2.2


class Camera:
    """A camera with the noise of its model, or without any, before a scene of vertical stripes."""

    shape, channels = (SIDE, SIDE), 1

    def __init__(
        self,
        sensor: CameraModel,
        projector: Projector,
        tones: tuple[float, ...],
        seed: int,
        counted: Convert | None = None,
        offsets: float = 0.0,
        is_repeating: bool = False,
    ) -> None:
        random = np.random.default_rng(seed)
        self.sensor, self._seed, self._counted = sensor, seed, counted
        self._projector, self._pictures = projector, count()
        stripes = np.arange(SIDE) * len(tones) // SIDE
        self._albedo = random.uniform(0.5, 1.2) * np.array(tones)[stripes]
        self._offsets = np.rint(random.normal(0, offsets, (SIDE, SIDE, 1)))
        self._is_repeating = is_repeating

    def expose(self) -> Array:
        """Take a bracket."""
        model, light = self.sensor, (self._albedo * self._projector.light)[..., None]
        if self._counted is None:
            key = 0 if self._is_repeating else next(self._pictures)
            counts = model.expose(light.astype(np.float32), self._seed, (key,)) + self._offsets
        else:
            collected = model.electrons_per_radiance / model.full_well_electrons * light
            levels = [collected * seconds for seconds in model.exposures]
            span = model.white_level - model.black_level_counts
            shares = np.minimum(levels, 2) ** (1 / model.response_gamma)
            counts = self._counted(model.black_level_counts + span * shares)
        return np.clip(counts, 0, model.white_level).astype(np.uint16)


COARSE = {"bits": 8, "black_level_counts": 8}
CAMERAS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "photon noise": ({}, {}),
    "8 bits": (COARSE, {}),
    "rounded, no noise": ({}, {"counted": np.rint}),
    "cut, no noise": ({}, {"counted": np.floor}),
    "cut to 8 bits, no noise": (COARSE, {"counted": np.floor}),
    "offsets of 2 counts": ({}, {"offsets": 2.0}),
    "the same noise": ({}, {"is_repeating": True}),
}


def verdict(camera: str, tones: tuple[float, ...], exponent: float, seed: int) -> tuple[str, float]:
    """Return what calibration says of a camera, and the exponent that it finds."""
    numbers, more = CAMERAS[camera]
    projector, sensor = Projector(), replace(CameraModel(), response_gamma=exponent, **numbers)
    taken = Camera(sensor, projector, tones, seed, **more)
    found: dict[str, Any] = {}
    settings = CalibrationConfig()
    bench: Any = Bench(projector, taken, settings, None, found, lambda _: nullcontext())  # type: ignore[arg-type]
    found["dark"] = measure_dark(bench)
    told = measure_linearity(bench)
    gamma = told["response_gamma"]
    standing = told.verdict.standing
    if standing == "good" and gamma == 1:
        return "linear", gamma
    return ("can't tell" if standing == "unknown" else "not linear"), gamma


def rows() -> Iterator[dict[str, Any]]:
    """Yield a row a camera and scene."""
    seeds = [int(seed) for seed in sys.argv[1:]] or range(20)
    for camera, (scene, tones) in product(CAMERAS, SCENES.items()):
        row: dict[str, Any] = {"camera": camera, "albedos": scene}
        for exponent in EXPONENTS:
            told = [verdict(camera, tones, exponent, seed) for seed in seeds]
            said = [words for words, _ in told]
            row[f"exponent {exponent}"] = " ".join(str(said.count(word)) for word in WORDS)
            if exponent != 1:
                row[f"{exponent} off"] = max(abs(gamma / exponent - 1) for _, gamma in told)
        yield row


if __name__ == "__main__":
    write("linearity", rows())
