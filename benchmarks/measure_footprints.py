"""Memory and processor time of a fit by footprints for many rays of one view.

Usage: ``python -m benchmarks.measure_footprints [--camera HEIGHTxWIDTH] [--projector
HEIGHTxWIDTH] [--channels C] [--pictures P]``. The camera sees a textured plane that the projector
lights from aside: each camera pixel has the direct light of one place of the projector's image, and
light in proportion to the mean of the pattern over a quarter of the image. Pictures are computed
without a matrix, with noise, and the model is fitted to those of the first round. Prints processor
seconds of the fit, the peak memory, and the error of direct light.
"""

from __future__ import annotations

import argparse
import resource
import time

import numpy as np
from numpy.typing import NDArray

from benchmarks.harness import image_size
from rfpipe.blocks import RayDomain
from rfpipe.methods.footprints.method import fit_pictures
from rfpipe.methods.footprints.patterns import view_patterns
from rfpipe.methods.footprints.pictures import PackedPictures
from rfpipe.methods.images import Pictures
from rfpipe.methods.states import joined
from rfpipe.provenance import generator
from rfpipe.relighting import octave_noise
from rfpipe.transport.footprints import FootprintTransport

_NOISE = 0.002  # standard deviation over the square root of the radiance
_TINTS = np.array([1.0, 0.8, 0.6], np.float32)


class Plane:
    """A plane seen by a camera, lit by a projector from aside.

    Parameters
    ----------
    camera, projector : tuple of int
        Height and width of the images.
    channels : int
    """

    def __init__(self, camera: tuple[int, int], projector: tuple[int, int], channels: int) -> None:
        row, column = np.indices(camera, np.float32) + np.float32(0.5)
        row, column = row / camera[0], column / camera[1]
        self.row = (projector[0] * (0.03 + 0.9 * row + 0.04 * column)).astype(np.int64)
        self.column = (projector[1] * (0.05 + 0.88 * column + 0.06 * row * column)).astype(np.int64)
        texture = 0.2 + 0.6 * (octave_noise(camera, generator(1), 1.0) > 0)
        self.albedo = texture.astype(np.float32) * _TINTS[:channels, None, None]

    def image(self, pattern: NDArray[np.bool_]) -> NDArray[np.float32]:
        """Compute the image (C, M) of a pattern (H, W)."""
        height, width = pattern.shape
        light = pattern[self.row, self.column].astype(np.float32)
        halves = pattern[: height // 2, : width // 2], pattern[height // 2 :, width // 2 :]
        share = np.linspace(0, 1, light.shape[1], dtype=np.float32)
        light += 0.1 * ((1 - share) * halves[0].mean() + share * halves[1].mean())
        return (self.albedo * light).reshape(len(self.albedo), -1)


def packed(plane: Plane, patterns: NDArray[np.bool_], seed: int) -> PackedPictures:
    """Compute noisy pictures of patterns (P, H, W), one at a time."""
    parts = []
    for index, pattern in enumerate(patterns):
        image, random = plane.image(pattern)[None], generator(seed, index)
        variance = (_NOISE**2 * (image + 0.01)).astype(np.float32)
        image = image + np.sqrt(variance) * random.standard_normal(image.shape, np.float32)
        parts.append(PackedPictures.of(Pictures(pattern.reshape(1, -1), image, variance), 0.5))
    return joined(parts, axis=0)


def main() -> None:
    """Fit the model to pictures of a plane."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--camera", type=image_size, default=(375, 500))
    parser.add_argument("--projector", type=image_size, default=(200, 320))
    parser.add_argument("--channels", type=int, default=3, choices=(1, 3))
    parser.add_argument("--pictures", type=int, default=25)
    arguments = parser.parse_args()
    plane = Plane(arguments.camera, arguments.projector, arguments.channels)
    patterns = view_patterns(arguments.projector, 1, arguments.pictures)
    patterns[0] = True
    pictures = packed(plane, patterns, 1)
    camera, projector = RayDomain(arguments.camera), RayDomain(arguments.projector)
    before, start = _peak_gib(), time.process_time()
    arrays, _ = fit_pictures(camera, projector, [pictures], 0.5, None)
    seconds = time.process_time() - start
    transport = FootprintTransport(camera.shape, projector.shape, arguments.channels, [], arrays)
    test = view_patterns(arguments.projector, 9, 2)[1]
    truth = plane.image(test).T
    relit = transport.relight(test.astype(np.float32)).reshape(truth.shape)
    error = float(np.linalg.norm(relit - truth) / np.linalg.norm(truth))
    print(
        f"{camera.size} camera rays, {projector.size} projector rays, "
        f"{arguments.channels} channels, {arguments.pictures} pictures: {seconds:.0f} s, "
        f"{_peak_gib():.2f} GiB ({before:.2f} GiB before the fit), error {100 * error:.2f} %"
    )


def _peak_gib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


if __name__ == "__main__":
    main()
