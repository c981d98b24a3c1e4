"""Classification of linear and non-linear cameras by the calibration, before various scenes.

Usage: ``python -m benchmarks.bench_linearity [--seeds 20]`` (two minutes). Cameras of known
exponents look at scenes of one, two, three and many albedos, without any texture: all pixels of a
tone have the same light, wherever that lies between the edges of the bins that are compared.
Columns: the number of seeds with the verdict linear, bent, or neither, and the worst exponent. Also
cameras whose photosites have offsets, and whose noise is the same in all pictures. Writes
results/bench/linearity.csv.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import write
from rfpipe.calibration.context import StepContext
from rfpipe.calibration.dark import measure_dark
from rfpipe.calibration.responses import measure_linearity
from rfpipe.calibration.verdicts import Findings
from rfpipe.config import CalibrationConfig
from rfpipe.photometry import CameraModel

SIDE = 64
EXPONENTS = (1.0, 0.8, 1.1, 1.25)
CAMERAS = {
    "default": CameraModel(),
    "8 bits": CameraModel(bits=8, black_level_counts=8),
    "dim, 1 and 4 ms": CameraModel(exposures=(0.001, 0.004)),
    "10 bits, hardly any noise": CameraModel(
        bits=10, read_noise_electrons=0, full_well_electrons=1e9, electrons_per_radiance=2.3e10
    ),
}
OWN: dict[str, dict[str, Any]] = {
    "offsets of 2 counts": {"offsets": 2.0},
    "the same noise": {"is_repeating": True},
}
SCENES = {
    "0.5": (0.5,),
    "0.2, 0.7": (0.2, 0.7),
    "0.2, 0.5": (0.2, 0.5),
    "0.2, 0.8": (0.2, 0.8),
    "0.13, 0.61": (0.13, 0.61),
    "0.34, 0.47": (0.34, 0.47),
    "0.2, 0.5, 0.8": (0.2, 0.5, 0.8),
    "32": tuple(np.linspace(0.1, 0.9, 32)),
}


class Wall:
    """A projector and a camera before stripes of albedos."""

    shape, channels = (SIDE, SIDE), 1

    def __init__(
        self,
        albedos: tuple[float, ...],
        sensor: CameraModel,
        seed: int,
        offsets: float = 0,
        is_repeating: bool = False,
    ) -> None:
        tones = np.array(albedos)[np.arange(SIDE) * len(albedos) // SIDE]
        self.sensor, self.seed, self.frames, self.light = sensor, seed, 0, 0.0
        self.albedo = np.broadcast_to(tones, self.shape)[..., None]
        self.offsets = np.random.default_rng(seed).normal(0, offsets, self.albedo.shape).round()
        self.is_repeating = is_repeating

    def show(self, picture: NDArray[Any]) -> None:
        """Show a flat picture."""
        self.light = float(picture[0, 0])

    def expose(self) -> NDArray[np.uint16]:
        """Take a bracket."""
        self.frames += not self.is_repeating
        frames = self.sensor.expose(self.light * self.albedo, self.seed, (self.frames,))
        return (frames + self.offsets).clip(0, self.sensor.white_level).astype(np.uint16)

    def describe(self) -> dict[str, Any]:
        """Empty: these measurements aren't stored."""
        return {}

    def close(self) -> None:
        """Nothing is open."""


def linearity(wall: Wall) -> Findings:
    """Do the steps dark and linearity."""
    context = StepContext(wall, wall, CalibrationConfig(), None, {}, lambda _: nullcontext())
    return measure_linearity(replace(context, findings={"dark": measure_dark(context)}))


def rows(seeds: int) -> Iterator[dict[str, Any]]:
    """Yield a row a camera, exponent and scene."""
    for name in (*CAMERAS, *OWN):
        camera, fault = CAMERAS.get(name, CameraModel()), OWN.get(name, {})
        for exponent in EXPONENTS:
            bent = replace(camera, response_gamma=exponent)
            for scene, albedos in SCENES.items():
                results = [linearity(Wall(albedos, bent, seed, **fault)) for seed in range(seeds)]
                good = [result for result in results if result.verdict.standing == "good"]
                gammas = np.array([result["response_gamma"] for result in good])
                yield {
                    "camera": name,
                    "exponent": exponent,
                    "albedos": scene,
                    "linear": int((gammas == 1).sum()),
                    "bent": int((gammas != 1).sum()),
                    "not good": sum(result.verdict.standing == "poor" for result in results),
                    "can't tell": sum(result.verdict.standing == "unknown" for result in results),
                    "worst exponent's error": np.abs(gammas / exponent - 1).max(initial=0.0),
                }


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=20)
    table = write("linearity", rows(parser.parse_args().seeds)).groupby(["camera", "exponent"])
    counts = table[["linear", "bent", "not good", "can't tell"]].sum()
    print(counts.join(table["worst exponent's error"].max()).to_string())
