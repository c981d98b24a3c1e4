"""Simulated pictures of a Gray code: a bent wall with a step, blur and indirect light."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter, map_coordinates, shift

from rfpipe.fitting.codes import code_patterns

Image = NDArray[Any]


@dataclass(frozen=True)
class Shot:
    """Patterns (K, N), pictures (K, M) minus black level, and true positions (2, M)."""

    patterns: np.ndarray
    pictures: np.ndarray
    camera_shape: tuple[int, int]
    projector_shape: tuple[int, int]
    names: list[str]
    places: np.ndarray

    def arguments(self) -> tuple:
        return (self.patterns, self.pictures, self.camera_shape, self.projector_shape, self.names)


@dataclass(frozen=True)
class Light:
    """Light and faults of simulated pictures.

    Attributes
    ----------
    indirect : float
        Fraction of light that is indirect and uniform.
    noise : float
        Standard deviation over the brightest pixel.
    blur : float
        Standard deviation of the projector's blur, in projector pixels.
    darkening : float
        Fraction of light that the finest stripes lose, as with a nonlinear projector.
    moved : (int, float, float)
        First picture after the camera moved, and the shift in rows and columns.
    flicker : float
        Standard deviation of the lamp's light, relative.
    """

    indirect: float = 0.15
    noise: float = 0.01
    blur: float = 0.5
    darkening: float = 0.0
    moved: tuple[int, float, float] = (0, 0.0, 0.0)
    flicker: float = 0.0

    def picture(
        self, index: int, pattern: Image, place: Image, white: Image, random: np.random.Generator
    ) -> Image:
        """Return picture `index`, of a pattern, for positions and floodlit light per pixel."""
        blurred = gaussian_filter(pattern, self.blur)
        edges = np.abs(np.diff(pattern, axis=0)).mean() + np.abs(np.diff(pattern, axis=1)).mean()
        direct = map_coordinates(blurred, place, order=1, mode="constant")
        light = white * ((1 - self.indirect) * direct + self.indirect * pattern.mean())
        light *= 1 - 2 * self.darkening * edges
        if index >= self.moved[0]:
            light = shift(light, self.moved[1:], order=1, mode="nearest")
        light = light * (1 + self.flicker * random.standard_normal())
        light = light + self.noise * random.standard_normal(light.shape)
        return np.clip(np.round(255 * (light + 0.05)), 0, 255) / 255 - 0.05


def shot(
    projector: tuple[int, int],
    camera: tuple[int, int],
    seed: int,
    *,
    name: str = "gray:{1}x{0},white=last",
    count: int | None = None,
    **light: Any,
) -> Shot:
    """Simulate pictures in 8 bits; `light` has the attributes of `Light`."""
    random = np.random.default_rng(seed)
    spec = name.format(*projector)
    if count is None:
        axes = sum((extent - 1).bit_length() for extent in projector)
        count = axes * (1 if "plain" in name else 2) + ("white=last" in name)
    stack = np.stack([read() for read in code_patterns(spec, count).readers])
    row, column = np.indices(camera) / np.reshape(camera, (2, 1, 1)) - 0.5
    bend = 0.04 * np.sin(5 * row + random.uniform(0, 6)) + 0.03 * np.cos(4 * column)
    before = np.hypot(row - random.uniform(-0.2, 0.2), column - random.uniform(-0.2, 0.2)) < 0.22
    turn = random.uniform(-0.15, 0.15) + random.choice([0, np.pi / 2, np.pi])
    size = random.uniform(0.8, 1.2)
    across = size * (np.cos(turn) * column - np.sin(turn) * row) + bend + 0.06 * before
    down = size * (np.sin(turn) * column + np.cos(turn) * row) + bend * 0.5
    place = np.stack([(down + 0.5) * projector[0] - 0.5, (across + 0.5) * projector[1] - 0.5])
    white = random.uniform(0.3, 1) * gaussian_filter(random.uniform(0.2, 1, camera), 4)
    white /= white.max() / 0.9
    pictures = np.empty((count, *camera), np.float32)
    for index, pattern in enumerate(stack):
        pictures[index] = Light(**light).picture(index, pattern, place, white, random)
    names = [f"{index + 1:02d}.png" for index in range(count)]
    return Shot(
        stack.reshape(count, -1), pictures.reshape(count, -1), camera, projector, names,
        place.reshape(2, -1) + 0.5,
    )  # fmt: skip
