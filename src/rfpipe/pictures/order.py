"""Whether pictures show their patterns, as far as that can be told without the light transport."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

Double = NDArray[np.float64]

TURNS: dict[str, Callable[[NDArray[Any]], NDArray[Any]]] = {
    "": lambda picture: picture,
    "turned by 180 degrees": lambda picture: picture[::-1, ::-1],
    "turned by 90 degrees clockwise": lambda picture: np.rot90(picture, -1),
    "turned by 90 degrees counterclockwise": np.rot90,
    "mirrored left to right": lambda picture: picture[:, ::-1],
    "mirrored top to bottom": lambda picture: picture[::-1],
    "mirrored along the diagonal": lambda picture: np.swapaxes(picture, 0, 1),
    "mirrored along the other diagonal": lambda picture: np.rot90(np.swapaxes(picture, 0, 1), 2),
}
"""What turns a picture (H, W) or (H, W, C), by its name."""

# Correlation of a picture with the pattern that it shows, at least, and what that is above others:
# good pictures have 0.5 to 1 and at least 0.4 more, see benchmarks/offline_faults.py.
_SHOWN, _ABOVE = 0.5, 0.25
# Root mean square of light that can't be, as a share of white light: good pictures have 0.04, those
# of other patterns or in other turns 0.2 and more.
_STRANGE = 0.1
# Share of the light from which on a pattern has a shape: fewer pixels may light a mirror alone.
_LEAST_LIT = 0.02
# Logarithm of how improbable by chance a picture has to be that is refused: one in a million.
_SURE = 14.0
_EVEN = 1e-12
_TINY = float(np.finfo(np.float64).tiny)


@dataclass(frozen=True, eq=False)
class Shown:
    """Pictures and the patterns that they are to show.

    Parameters
    ----------
    patterns : ndarray, shape (K, ...)
        Weights from 0 to 1; on a coaxial rig images (H, W).
    names : sequence of K str
        Of the patterns.
    light, variance : ndarray of float64, shape (K, H, W)
        Of the pictures, without the light of all-off ones.
    white : ndarray of float64, shape (H, W)
        The picture under all light.
    """

    patterns: NDArray[Any]
    names: Sequence[str]
    light: Double
    variance: Double
    white: Double

    def impossible(self) -> dict[int, str]:
        """Say by their numbers which pictures can't be, whatever the rig and the scene.

        Light adds up: under white light each picture is as the one under all light, and no other is
        brighter.
        """
        lit = self.patterns.reshape(len(self.patterns), -1).mean(axis=1)
        is_even, found = (lit == 0) | (lit == 1), dict[int, str]()
        ratio, noise, power = self._ratio(self.light), self._noise, self._shapes(self.light)[1]
        off = np.abs((self._share * ratio).sum(axis=(1, 2)) - lit)
        excess = (self._share * np.square(np.maximum(ratio - 1, 0))).sum(axis=(1, 2))
        uneven = (power - noise > _STRANGE**2) | (off > 3 * _STRANGE)
        for index in np.flatnonzero(is_even & uneven):
            found[int(index)] = "is not evenly lit" if lit[index] else "is not dark"
        for index in np.flatnonzero(~is_even & (excess - noise > _STRANGE**2)):
            found[int(index)] = "has light where white light has none"
        return found

    def repeated(self) -> dict[int, str]:
        """Say by their numbers which pictures of two patterns are the same to the last bit."""
        found, lit = dict[int, str](), self._noise < self._shapes(self.light)[1] / 2
        for one, other in combinations(map(int, np.flatnonzero(lit)), 2):
            differ = (self.patterns[one] != self.patterns[other]).any()
            if differ and (self.light[one] == self.light[other]).all():
                found[other] = f"is the same picture as that of {self.names[one]}"
        return found

    def misplaced(self, turned: Callable[[str, int], Double] | None = None) -> dict[int, str]:
        """Say by their numbers which pictures of a coaxial rig show something else, and what.

        Of pictures that are too dark to tell, or whose patterns are too coarse, there is nothing;
        nor where most show no pattern in any turn: the rig isn't coaxial after all.
        ``turned(turn, k)`` returns the light of picture k by one of `TURNS`; by default, its light
        is turned.
        """
        known, spread = self._unit(np.asarray(self.patterns, float))
        seen, power = self._shapes(self.light)
        lit = (self._share * self.patterns).sum(axis=(1, 2))
        shaped = np.minimum(lit, 1 - lit) > _LEAST_LIT
        if not shaped.any():
            return {}
        # what is seen of a picture, or would be if it were as the others
        usual = np.median(power[shaped] / spread[shaped])
        told = np.flatnonzero(shaped & (self._noise < np.maximum(power, usual * spread) / 2))
        if not told.size:
            return {}

        def match(index: int, turn: str) -> Double:
            image = turned(turn, index) if turned else TURNS[turn](self.light[index])
            if image.shape != self.white.shape:
                return np.zeros(len(known))
            return np.asarray(known @ self._shapes(image[None])[0][0])

        def surely(fit: Any, less: Any, of: Any) -> bool:
            """Whether correlations of pictures with their patterns exceed others by no chance."""
            rest, before = (1 - np.square(np.clip(each, 0, 1 - 1e-9)) for each in (fit, less))
            return bool((self._parts[of] / 2 * np.log(before / rest)).sum() > _SURE)

        own = np.einsum("kp,kp->k", seen, known)
        some = told[np.linspace(0, len(told) - 1, min(len(told), 8)).astype(int)]
        if np.median((seen[some] @ known.T).max(axis=1)) < _SHOWN:
            turns = {turn: np.array([match(i, turn)[i] for i in some]) for turn in TURNS}
            best = max(turns, key=lambda turn: float(np.median(turns[turn])))
            is_turned = np.median(turns[best]) >= _SHOWN and surely(turns[best], own[some], some)
            return dict.fromkeys(map(int, told), f"fits when it is {best}") if is_turned else {}
        found, usual = dict[int, str](), np.median(own[told])
        most = np.mean(own[told] >= _SHOWN) >= 0.75
        for index in map(int, told[own[told] < _SHOWN + _ABOVE]):
            here = match(index, "")
            other = int(here.argmax())
            fits = {f"shows {self.names[other]}": here[other]}
            fits |= {f"fits when it is {turn}": match(index, turn)[index] for turn in TURNS if turn}
            says = max(fits, key=lambda each: fits[each])
            fit = fits[says]
            if fit < max(_SHOWN, own[index] + _ABOVE):
                # a small pattern may have hit what is black
                is_none = most and own[index] < _ABOVE and abs(lit[index] - 0.5) < 0.4
                fit, says = usual if is_none else 0.0, "shows none of these patterns"
            if surely(fit, own[index], index):
                found[index] = says
        return found

    @property
    def _parts(self) -> Double:
        """In how many parts of its own size each pattern falls, as its edges tell; (K,)."""
        values = np.asarray(self.patterns, float)
        down, across = (np.abs(np.diff(values, axis=axis)).sum(axis=(1, 2)) for axis in (1, 2))
        spread = 4 * values.var(axis=(1, 2)) * values[0].size
        parts = np.square(down + across) * values[0].size / np.maximum(np.square(spread), _TINY)
        return np.asarray(np.minimum(parts, 1 / np.square(self._share).sum()))

    @property
    def _share(self) -> Double:
        """Weights of pixels, of sum 1: the dark ones have little, bright ones about the same."""
        bright = np.maximum(self.white, 0)
        weight = bright / np.maximum(bright + bright.mean(), _TINY)
        return np.asarray(weight / max(weight.sum(), _TINY))

    def _ratio(self, images: Double) -> Double:
        over = np.where(self.white > 0, self.white, np.inf)
        return np.clip(images / over, -1, 2)

    @property
    def _noise(self) -> Double:
        over = np.where(self.white > 0, self.white, np.inf)
        return np.asarray((self._share * self.variance / np.square(over)).sum(axis=(1, 2)))

    def _shapes(self, images: Double) -> tuple[Double, Double]:
        return self._unit(self._ratio(images))

    def _unit(self, images: Double) -> tuple[Double, Double]:
        """Return images (n, H, W) without their means, of norm 1, and their squared norms."""
        share = self._share
        flat = images - (share * images).sum(axis=(1, 2), keepdims=True)
        flat = (flat * np.sqrt(share)).reshape(len(images), -1)
        power = np.square(flat).sum(axis=1)
        norm = np.where(power > _EVEN, np.sqrt(power), np.inf)  # what is even has no shape
        return flat / norm[:, None], power
