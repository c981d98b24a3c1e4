"""Faults of a set of pictures whose patterns are known: exchanged pictures, motion, flicker.

With the patterns P (pictures, rays) and the pictures Y (pictures, pixels) of a transport T,
``Y = P T^T`` up to noise and a constant. Two properties follow, which hold for every scene:

1. A combination of pictures whose patterns add up to a constant vanishes: ``B Y = 0``, where B
   projects onto the left null space of ``[P, 1]``. The misfit ``E = trace(B Y Y^T)`` shows which
   exchange of two pictures explains what does not vanish. It needs only the Gram matrix ``Y Y^T``.
2. Neighbouring pixels see neighbouring rays, at most places. Where pictures and their complements
   spell a code, the decoded map is smooth; an exchange that property 1 can't show (a picture and
   its complement, two such pairs) tears it along the edges of the stripes.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from math import prod
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from rfpipe.errors import InputError

Float = NDArray[np.float32]
Double = NDArray[np.float64]
Order = NDArray[np.int64]
Exchange = tuple[tuple[int, int], ...]  # pairs of places whose pictures change places

_NULL = 1e-6  # eigenvalues of P P^T up to this share of the largest are 0
_LIT = 0.2  # share of the brightest pixels' light from which pixels count
_BRIGHTEST = 99  # percentile of light that defines the brightest pixels
_EXPLAINED = 0.25
# Share of the misfit expected of an exchange that undoing it removes. Over 8 simulated and real
# sets it was 0.42 to 1 for exchanged pictures whose stripes the camera resolves, at most 0.08 for
# all others.
_VISIBLE = 0.02  # share of the misfit that an exchange must be able to cause
_TIED = 1.02  # ratio of misfits up to which two exchanges explain the pictures equally well
_CLEARER = 3.0  # ratio of jumps mended to jumps made by which undoing an exchange smooths the map
_TORN = 20.0  # jumps, at least, that undoing it mends
_MOST = 8  # exchanges, at most, that are listed
_UNREADABLE = 0.4  # share of neighbours without a codeword above which a code isn't readable
_UNKNOWN = 0.2  # share of lit pixels without a codeword above which the code is another one
_TESTED = 10_000_000  # pixels times exchanges that are decoded, at most
_TABLE_BITS = 22  # bits up to which codewords are looked up in a table
_MOST_BITS = 62  # bits of an integer
_BLUR = 1.0  # camera pixels: standard deviation of the filter before derivatives
_MOVED, _STEADY = 0.1, 5.0  # camera pixels, and standard errors, above which a shift is motion
_FLICKER = 0.02  # relative standard deviation of pictures' light from which it is listed
_FEWEST = 4  # sums of pictures and complements from which motion and flicker are estimated


@dataclass(frozen=True)
class Fault:
    """A fault of a set of pictures.

    Attributes
    ----------
    kind : {"exchanged", "unknown codes", "motion", "flicker"}
        Exchanged pictures and codes that the patterns don't have make a fit worthless; motion and
        flicker make it worse.
    pictures : tuple of int
        Indices, from 0, of the pictures concerned.
    message : str
        What is wrong, by how much, and what to do.
    """

    kind: Literal["exchanged", "unknown codes", "motion", "flicker"]
    pictures: tuple[int, ...]
    message: str


def faults_of(
    patterns: Float,
    pictures: Float,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    names: Sequence[str],
) -> list[Fault]:
    """Find exchanged pictures, motion between pictures, and flicker of the lamp.

    Parameters
    ----------
    patterns : ndarray of float32, shape (K, N)
        Weights from 0 to 1; no black ones.
    pictures : ndarray of float32, shape (K, M)
        Linear light, black subtracted; finite.
    camera_shape, projector_shape : (int, int)
        Rows and columns of the M pixels and of the N rays.
    names : sequence of K str
        Names of the pictures, for messages.

    Returns
    -------
    list of Fault
        Empty, too, where patterns allow no test: fewer pictures than unknowns and no code.

    Raises
    ------
    InputError
        If shapes don't fit together.
    """
    expected = ((len(names), prod(projector_shape)), (len(names), prod(camera_shape)))
    if (patterns.shape, pictures.shape) != expected:
        raise InputError(
            f"patterns {patterns.shape} and pictures {pictures.shape}: expected {expected[0]} and "
            f"{expected[1]}, {len(names)} pictures of {camera_shape} pixels and {projector_shape} "
            "rays"
        )
    if len(names) < 2:
        return []
    sums = _Sums.of(patterns)
    code = _Code.of(patterns, projector_shape, sums)
    view = _View.of(pictures, camera_shape, code)
    order = np.arange(len(names))
    exchanged, order = _exchanged_by_sums(sums, pictures, view, order, names)
    more, order = _exchanged_by_code(view, order, names)
    unknown = (
        _unknown_codes(view, order, patterns.shape[1])
        if (patterns == np.rint(patterns)).all()
        else []
    )
    return [*exchanged, *more, *unknown, *_unsteady(patterns, pictures[order], camera_shape,
                                          projector_shape, sums, names)]  # fmt: skip


@dataclass(frozen=True)
class _Sums:
    """Combinations of pictures that are known beforehand.

    Attributes
    ----------
    null : ndarray of float64, shape (K, K)
        The projector B onto the left null space of ``[P, 1]``.
    pairs : tuple of (int, int)
        Pictures and their complements, whose patterns add up to white.
    white : tuple of int
        Pictures of white patterns.
    """

    null: Double
    pairs: tuple[tuple[int, int], ...]
    white: tuple[int, ...]

    @classmethod
    def of(cls, patterns: Float) -> _Sums:
        """Find the combinations that patterns (K, N) have."""
        gram = np.asarray(patterns @ patterns.T, np.float64) / patterns.shape[1]
        mean = patterns.mean(axis=1, dtype=np.float64)
        values, vectors = np.linalg.eigh(gram + 1)
        basis = vectors[:, values <= _NULL * values[-1]]
        covariance = gram - np.outer(mean, mean)
        variance = np.diag(covariance)
        is_even = variance < 1e-4
        scatter = variance[:, None] + variance + 2 * covariance  # of the sum of two patterns
        opposite = (scatter < 1e-4) & (np.abs(mean[:, None] + mean - 1) < 1e-2)
        opposite &= ~is_even[:, None] & ~is_even
        pairs: list[tuple[int, int]] = []
        free = set(range(len(mean)))
        for first, second in sorted(np.argwhere(np.triu(opposite)).tolist(), key=_distance):
            if {first, second} <= free:
                pairs.append((first, second))
                free -= {first, second}
        white = np.flatnonzero(is_even & (mean > 0.99)).tolist()
        return cls(basis @ basis.T, tuple(sorted(pairs)), tuple(white))


def _distance(pair: list[int]) -> int:
    """Return the distance of two pictures in their order."""
    return pair[1] - pair[0]


@dataclass(frozen=True)
class _Code:
    """Codewords of the projector's rays: the signs of patterns minus complements.

    Attributes
    ----------
    bits : tuple of (int, int)
        Pictures whose difference has the sign of each bit; the second is -1 where half of the
        white light takes the complement's place.
    words : ndarray of int64, shape (W,)
        Codewords that exist, ascending.
    table : ndarray of int64, shape (2**bits,) or (0,)
        Index of each codeword in `words`, W where it doesn't exist; empty for too many bits.
    places : ndarray of float32, shape (W + 1, 2)
        Mean row and column of each codeword's rays; NaN where these lie apart, and in the last
        row, of codewords that don't exist.
    """

    bits: tuple[tuple[int, int], ...]
    words: Order
    table: Order
    places: Float

    @classmethod
    def of(cls, patterns: Float, shape: tuple[int, int], sums: _Sums) -> _Code:
        """Return the codewords of patterns (K, N); of no bits, where they have no code."""
        paired = {picture for pair in sums.pairs for picture in pair}
        candidates = [*sums.pairs]
        if sums.white:
            unpaired = set(range(len(patterns))) - paired - set(sums.white)
            candidates += [(picture, -1) for picture in sorted(unpaired)]
        bits: list[tuple[int, int]] = []
        word = np.zeros(patterns.shape[1], np.int64)
        for bit in candidates[:_MOST_BITS]:
            contrast = patterns[bit[0]] - (0.5 if bit[1] < 0 else patterns[bit[1]])
            if (np.abs(contrast) > 0.05).mean() > 0.9:
                word |= (contrast > 0).astype(np.int64) << len(bits)
                bits.append(bit)
        words, inverse = np.unique(word, return_inverse=True)
        places = np.full((len(words) + 1, 2), np.nan, np.float32)
        count = np.bincount(inverse)
        for axis, index in enumerate(np.indices(shape).reshape(2, -1)):
            mean = np.bincount(inverse, index) / count
            spread = np.sqrt(np.maximum(np.bincount(inverse, index**2.0) / count - mean**2, 0))
            places[:-1, axis] = np.where(spread < 2, mean, np.nan)
        places[np.isnan(places).any(axis=1)] = np.nan
        table = np.full(1 << len(bits) if len(bits) <= _TABLE_BITS else 0, len(words))
        if table.size:
            table[words] = np.arange(len(words))
        return cls(tuple(bits), words, table, places)

    def places_of(self, word: Order) -> Float:
        """Return the places (..., 2) of codewords (...), NaN where there is none."""
        if self.table.size:
            return self.places[self.table[word]]
        index = np.minimum(np.searchsorted(self.words, word), len(self.words) - 1)
        return self.places[np.where(self.words[index] == word, index, len(self.words))]

    def exchanges(self) -> list[Exchange]:
        """Return the exchanges that sums can't show: of a bit's pictures, and of two bits."""
        flips: list[Exchange] = [(bit,) for bit in self.bits if bit[1] >= 0]
        swaps: list[Exchange] = [
            ((a, c), (b, d)) if b >= 0 else ((a, c),)
            for (a, b), (c, d) in combinations(self.bits, 2)
            if (b < 0) == (d < 0)
        ]
        return flips + swaps


@dataclass(frozen=True)
class _View:
    """Pixels of the camera, thinned to pairs of rows, that see the code.

    Attributes
    ----------
    code : _Code
    pictures : ndarray of float32, shape (K, P, 2, W)
        Light of P pairs of neighbouring rows.
    lit : ndarray of bool, shape (P, 2, W)
    half : ndarray of float32, shape (P, 2, W)
        Half of the white light.
    """

    code: _Code
    pictures: Float
    lit: NDArray[np.bool_]
    half: Float

    @classmethod
    def of(cls, pictures: Float, shape: tuple[int, int], code: _Code) -> _View:
        """Choose pairs of rows so that all exchanges take few seconds."""
        budget = _TESTED / max(1, len(code.exchanges()))
        step = max(2, round(2 * prod(shape) / budget))
        first = np.arange(0, shape[0] - 1, step)
        rows = np.stack([first, first + 1], axis=1)
        images = pictures.reshape(len(pictures), *shape)[:, rows]
        mean = images.mean(axis=0)
        lit = mean > _LIT * np.percentile(mean, _BRIGHTEST) if mean.size else mean > 0
        half = (images.max(axis=0) + images.min(axis=0)) / 2
        return cls(code, images, lit, half)

    def words(self, order: Order) -> Order:
        """Return each pixel's codeword (P, 2, W), were the pictures in an order."""
        word = np.zeros(self.lit.shape, np.int64)
        for index, (first, second) in enumerate(self.code.bits):
            word |= self._bit(order, first, second) << index
        return word

    def exchanged(self, word: Order, order: Order, exchange: Exchange) -> Order:
        """Return the codewords after an exchange, computed from those before."""
        changed = {picture for pair in exchange for picture in pair}
        order = _apply(order, exchange)
        for index, (first, second) in enumerate(self.code.bits):
            if first in changed or second in changed:
                word = word & ~(1 << index) | self._bit(order, first, second) << index
        return word

    def _bit(self, order: Order, first: int, second: int) -> Order:
        complement = self.half if second < 0 else self.pictures[order[second]]
        bit: Order = (self.pictures[order[first]] > complement).astype(np.int64)
        return bit

    def jumps(self, word: Order, limit: float = np.inf) -> Float:
        """Return distances in rays between neighbours' places, at most `limit`.

        NaN where a pixel isn't lit, infinity (or `limit`) where a codeword doesn't exist.
        """
        place = self.code.places_of(word)
        steps = []
        for axis in (1, 2):
            step = np.abs(np.diff(place, axis=axis)).sum(axis=-1)
            step = np.where(np.isnan(step), np.inf, step)
            visible = np.logical_and(*(np.delete(self.lit, edge, axis) for edge in (0, -1)))
            steps.append(np.minimum(step, limit)[visible])
        return np.concatenate(steps)


def _apply(order: Order, exchange: Exchange) -> Order:
    """Return an order of pictures in which pairs of them have changed places."""
    changed = order.copy()
    for pair in exchange:
        changed[list(pair)] = changed[list(pair[::-1])]
    return changed


def _exchanged_by_sums(
    sums: _Sums, pictures: Float, view: _View, order: Order, names: Sequence[str]
) -> tuple[list[Fault], Order]:
    """Find exchanged pictures by combinations that should vanish, and the order without them."""
    faults: list[Fault] = []
    if not sums.null.any():
        return faults, order
    gram = _gram(pictures)
    for _ in range(_MOST):
        candidates = _explaining(sums.null, gram[np.ix_(order, order)])
        if not candidates:
            break
        before = float((sums.null * gram[np.ix_(order, order)]).sum())
        best, tied = _smoothest(view, order, [((i, j),) for i, j, _ in candidates])
        after = min(candidates, key=lambda candidate: candidate[2])[2]
        reason = (
            "combinations of pictures that should vanish are "
            f"{np.sqrt(before / max(after, 1e-12)):.1f} times larger than after their exchange"
        )
        faults.append(_exchange_fault([best, *tied], order, names, reason))
        order = _apply(order, best)
    return faults, order


def _gram(pictures: Float) -> Double:
    """Return the covariances of pictures over their mean, of lit pixels; float64, (K, K).

    Combinations that vanish have no covariance either. Without each picture's mean, stripes that
    the camera does not resolve, and that differ in brightness alone, have no influence.
    """
    mean = pictures.mean(axis=0)
    brightest = np.percentile(mean, _BRIGHTEST)
    lit = mean > _LIT * brightest
    relative = pictures[:, lit] / mean[lit]
    relative -= relative.mean(axis=1, keepdims=True)
    gram: Double = np.asarray(relative @ relative.T, np.float64) / max(1, lit.sum())
    return gram


def _misfits(null: Double, gram: Double) -> Double:
    """Return ``trace(B Y Y^T)`` after the exchange of pictures i and j, for all (i, j)."""
    product = null @ gram
    mixed, b, g = np.diag(product), np.diag(null), np.diag(gram)
    change = 2 * (product + product.T - mixed[:, None] - mixed)
    change -= 2 * (b[:, None] - null) * (gram - g[:, None]) + 2 * (null - b) * (g - gram)
    change += (b[:, None] - b) * (g - g[:, None])
    return np.asarray(change + np.sum(null * gram), dtype=np.float64)


def _explaining(null: Double, gram: Double) -> list[tuple[int, int, float]]:
    """Return the exchanges (i, j, misfit) that explain the misfit equally well, best first."""
    total, misfits = float((null * gram).sum()), _misfits(null, gram)
    first, second = np.triu_indices(len(null), 1)
    best = np.argsort(misfits[first, second])[:100]
    model = np.eye(len(null)) - null
    candidates: list[tuple[int, int, float]] = []
    for i, j in zip(first[best].tolist(), second[best].tolist(), strict=True):
        misfit = float(misfits[i, j])
        if misfit >= total or (candidates and misfit > _TIED * candidates[0][2]):
            break
        order = _apply(np.arange(len(null)), ((i, j),))
        ideal = model @ gram[np.ix_(order, order)] @ model
        expected = float((null * ideal[np.ix_(order, order)]).sum())
        if expected > _VISIBLE * total and total - misfit > _EXPLAINED * expected:
            candidates.append((i, j, misfit))
    return candidates


def _smoothest(
    view: _View, order: Order, exchanges: Sequence[Exchange]
) -> tuple[Exchange, list[Exchange]]:
    """Return the exchange after which the decoded map is smoothest, and those as good."""
    if len(exchanges) == 1 or not view.code.bits:
        return exchanges[0], list(exchanges[1:])
    word = view.words(order)
    changed = [view.exchanged(word, order, exchange) for exchange in exchanges]
    smoothest = min(changed, key=lambda word: float(view.jumps(word, 8.0).sum()))
    limit = _largest(view.jumps(smoothest))
    jumps = [view.jumps(word, limit) for word in changed]
    best = min(range(len(jumps)), key=lambda index: float(jumps[index].sum()))
    tied = [
        exchange
        for exchange, jump in zip(exchanges, jumps, strict=True)
        if exchange != exchanges[best] and not _is_smoother(jumps[best], jump, limit)
    ]
    return exchanges[best], tied


def _largest(jumps: Float) -> float:
    """Return the jump from which a map is torn: four times the usual one."""
    usual = jumps[np.isfinite(jumps) & (jumps > 0)]
    return max(4.0, 4 * float(np.median(usual))) if usual.size else 4.0


def _is_smoother(after: Float, before: Float, limit: float) -> bool:
    """Decide whether jumps after an exchange are clearly less than before."""
    change = (before - after) / limit
    mended = float(change[change > 0].sum())
    return mended >= _TORN and mended > _CLEARER * float(-change[change < 0].sum())


def _exchanged_by_code(
    view: _View, order: Order, names: Sequence[str]
) -> tuple[list[Fault], Order]:
    """Find exchanged pictures by the decoded map's smoothness, and the order without them."""
    faults: list[Fault] = []
    exchanges = view.code.exchanges()
    for _ in range(_MOST if exchanges else 0):
        word = view.words(order)
        jumps = view.jumps(word)
        if np.isinf(jumps).mean() > _UNREADABLE:
            break
        limit = _largest(jumps)
        jumps = np.minimum(jumps, limit)
        gains: dict[Exchange, float] = {}
        for exchange in exchanges:
            after = view.jumps(view.exchanged(word, order, exchange), limit)
            if _is_smoother(after, jumps, limit):
                gains[exchange] = float(jumps.sum() - after.sum())
        if not gains:
            break
        best = max(gains, key=lambda exchange: gains[exchange])
        reason = (
            "jumps between the projector places that neighbouring pixels decode shrink by "
            f"{100 * gains[best] / float(jumps.sum()):.0f} % when they are exchanged"
        )
        faults.append(_exchange_fault([best], order, names, reason))
        order = _apply(order, best)
    return faults, order


def _unknown_codes(view: _View, order: Order, rays: int) -> list[Fault]:
    """Find codewords in the pictures that no projector ray has, of many pixels."""
    bits = len(view.code.bits)
    # a code of both axes has at most two bits more than it needs for all rays together
    if not _FEWEST <= bits <= np.log2(max(rays, 1)) + 2:
        return []
    place = view.code.places_of(view.words(order))[view.lit]
    share = float(np.isnan(place).any(axis=-1).mean()) if len(place) else 0.0
    if share < _UNKNOWN:
        return []
    message = (
        f"{share:.0%} of the lit pixels show codes that no ray of the projector has: are the "
        "code's size and order those that were shown?"
    )
    return [Fault("unknown codes", tuple(range(len(order))), message)]


def _exchange_fault(
    exchanges: Sequence[Exchange], order: Order, names: Sequence[str], reason: str
) -> Fault:
    """Return the fault of an exchange, or of several that explain the pictures equally well."""
    said = [
        " and ".join(f"{names[order[i]]} with {names[order[j]]}" for i, j in exchange)
        for exchange in exchanges[:3]
    ]
    pictures = {int(order[at]) for exchange in exchanges for pair in exchange for at in pair}
    which = said[0] if len(said) == 1 else f"{said[0]} (or {', or '.join(said[1:])})"
    return Fault(
        "exchanged",
        tuple(sorted(pictures)),
        f"pictures are exchanged: {which}; {reason}. Give each picture the name of the other",
    )


@dataclass(frozen=True)
class _Steadiness:
    """Gains and shifts of sums of pictures and complements against white.

    Attributes
    ----------
    pictures : list of tuple of int
        Pictures of each sum, in the order in which they were taken.
    gains : ndarray of float64, shape (S,)
        Mean of the gains of a picture and its complement.
    shifts : ndarray of float64, shape (S, 2)
        Along rows and columns, in camera pixels.
    differences : ndarray of float64, shape (S,)
        Half of the difference of these gains.
    errors : ndarray of float64, shape (S, 4)
        Standard errors of gains, shifts and differences.
    """

    pictures: list[tuple[int, int]]
    gains: Double
    shifts: Double
    differences: Double
    errors: Double


def _unsteady(
    patterns: Float,
    pictures: Float,
    shape: tuple[int, int],
    projector_shape: tuple[int, int],
    sums: _Sums,
    names: Sequence[str],
) -> list[Fault]:
    """Find motion and flicker in pictures that are in their right order."""
    if len(sums.pairs) < _FEWEST or min(shape) < 16:
        return []
    steadiness = _measure_steadiness(pictures, shape, sums)
    stripes = _stripes(patterns, projector_shape, steadiness.pictures)
    return [*_motion(steadiness, names), *_flicker(steadiness, stripes)]


def _measure_steadiness(pictures: Float, shape: tuple[int, int], sums: _Sums) -> _Steadiness:
    """Fit gains and shift to each sum of a picture and its complement."""
    images = pictures.reshape(len(pictures), *shape)
    if sums.white:
        white = images[list(sums.white)].mean(axis=0)
    else:
        white = np.median([images[a] + images[b] for a, b in sums.pairs], axis=0)
    fits = [_gains_and_shift(images[a], images[b], white) for a, b in sums.pairs]
    values, errors = (np.array(part) for part in zip(*fits, strict=True))
    return _Steadiness([*sums.pairs], values[:, 0], values[:, 1:3], values[:, 3], errors)


def _gains_and_shift(picture: Float, complement: Float, white: Float) -> tuple[Double, Double]:
    """Fit the sum of a picture and its complement by white, moved, and by their difference.

    ``y + y' = a w(x - s) + b (y - y')``, where the picture's gain is a + b and the complement's
    a - b: light flickers from one to the other. Gauss-Newton on blurred images: white is moved by
    the current shift s, and the rest of the shift follows from a linear regression on white and
    its derivatives.

    Returns
    -------
    values, errors : ndarray of float64, shape (4,)
        a, s along rows and columns, and b; their standard errors, infinite where the scene has
        too few lit pixels or too little texture.
    """
    from scipy.ndimage import gaussian_filter, shift

    margin = 6
    inside = (slice(margin, -margin),) * 2
    smooth, total, difference = (
        gaussian_filter(image, _BLUR)
        for image in (white, picture + complement, picture - complement)
    )
    lit = smooth[inside] > _LIT * np.percentile(smooth, _BRIGHTEST)
    target = total[inside][lit]
    values, errors = np.array([1.0, 0, 0, 0]), np.full(4, np.inf)
    for _ in range(4):
        source = shift(smooth, values[1:3], order=1, mode="nearest")
        images = (source, *np.gradient(source), difference)
        terms = np.stack([image[inside][lit] for image in images])
        normal = np.asarray(terms @ terms.T, np.float64)
        if lit.sum() < 100 or np.linalg.cond(normal) > 1e8:
            return values, np.full(4, np.inf)
        inverse = np.linalg.inv(normal)
        solution = inverse @ np.asarray(terms @ target, np.float64)
        # blur makes about 4 pi blur^2 neighbouring pixels share their noise
        variance = (target - solution @ terms).var() * 4 * np.pi * _BLUR**2
        gain = solution[0]
        errors = np.sqrt(variance * np.diag(inverse)) / np.array([1, gain, gain, 1])
        step = np.clip(-solution[1:3] / gain, -2, 2)
        moved = np.clip(values[1:3] + step, -margin / 2, margin / 2)
        values = np.array([gain, *moved, solution[3]])
        if np.abs(step).max() < 0.1:
            break
    return values, errors


def _stripes(patterns: Float, shape: tuple[int, int], groups: Iterable[tuple[int, int]]) -> Double:
    """Return the mean contrast of neighbouring rays of each group's patterns."""
    contrast = []
    for first, *_ in groups:
        image = patterns[first].reshape(shape)
        steps = (np.abs(np.diff(image, axis=axis)) for axis in (0, 1))
        contrast.append(sum(float(step.mean()) if step.size else 0.0 for step in steps))
    return np.array(contrast)


def _motion(steadiness: _Steadiness, names: Sequence[str]) -> list[Fault]:
    """Find the picture from which the camera's view is shifted against the previous pictures."""
    shifts, count = steadiness.shifts, len(steadiness.shifts)
    usable = np.isfinite(steadiness.errors[:, :3]).all()
    splits = range(2, count - 1) if usable else range(0)
    best, leap, error = 0, np.zeros(2), np.inf
    for split in splits:
        groups = shifts[:split], shifts[split:]
        within = sum(((group - group.mean(axis=0)) ** 2).sum() for group in groups)
        noise = max(within / (2 * count - 4), float((steadiness.errors[:, 1:3] ** 2).mean()))
        deviation = np.sqrt(noise * (1 / split + 1 / (count - split)))
        change = groups[1].mean(axis=0) - groups[0].mean(axis=0)
        if np.hypot(*change) / deviation > np.hypot(*leap) / error:
            best, leap, error = split, change, deviation
    distance = float(np.hypot(*leap))
    if distance < _MOVED or distance < _STEADY * error:
        return []
    earlier, later = (
        sorted(picture for group in part for picture in group)
        for part in (steadiness.pictures[:best], steadiness.pictures[best:])
    )
    message = (
        f"pictures {names[later[0]]} to {names[later[-1]]} are shifted by {distance:.1f} pixels "
        f"({leap[0]:+.1f} rows, {leap[1]:+.1f} columns) against {names[earlier[0]]} to "
        f"{names[earlier[-1]]}: camera, projector or scene moved. Fix them and take the pictures "
        "again, or bin the camera's pixels so that the shift is small"
    )
    return [Fault("motion", tuple(later), message)]


def _flicker(steadiness: _Steadiness, stripes: Double) -> list[Fault]:
    """Find flicker: gains that scatter, apart from what the fineness of stripes takes."""
    # fine stripes are darker than white, where a projector's pixels affect their neighbours
    terms = np.stack([np.ones_like(stripes), stripes, stripes**2], axis=1)
    gains, errors = steadiness.gains, steadiness.errors
    if not np.isfinite(errors[:, 0]).all():
        return []
    residual = gains - terms @ np.linalg.lstsq(terms, gains, rcond=None)[0]
    # uncertain where the camera sees one side of the stripes, or stripes finer than its blur
    certain = errors[:, 3] < 2 * np.median(errors[:, 3])
    scatter = np.concatenate([residual, steadiness.differences[certain]])
    noise = np.concatenate([errors[:, 0], errors[certain, 3]])
    variance = float((scatter**2).sum()) / max(1, scatter.size - terms.shape[1])
    variance -= float((noise**2).mean())
    # half of the sum and half of the difference of two pictures have half of their variance
    flicker = np.sqrt(2 * max(variance, 0.0)) / max(float(np.median(gains)), 1e-6)
    if flicker < _FLICKER:
        return []
    pictures = tuple(sorted(picture for group in steadiness.pictures for picture in group))
    message = (
        f"lamp flicker of {100 * flicker:.0f} %: the light of the pictures has this standard "
        "deviation against white. Expose for a whole number of the lamp's periods, let the "
        "projector warm up, and switch off the camera's automatic exposure"
    )
    return [Fault("flicker", pictures, message)]
