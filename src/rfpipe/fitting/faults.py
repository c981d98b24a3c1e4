"""Faults of a set of pictures whose patterns are known: above all, exchanged pictures.

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

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from math import prod

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Double, Float, Index
from rfpipe.errors import InputError
from rfpipe.fitting.known_sums import BRIGHTEST, LIT, KnownSums, PictureFault
from rfpipe.fitting.steadiness import unsteady

Exchange = tuple[tuple[int, int], ...]  # pairs of places whose pictures change places

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
_FEWEST = 4  # bits of a code, at least, whose unknown codewords are counted


def faults_of(
    patterns: Float,
    pictures: Float,
    camera_shape: tuple[int, int],
    projector_shape: tuple[int, int],
    names: Sequence[str],
) -> list[PictureFault]:
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
    sums = KnownSums.of(patterns)
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
    return [*exchanged, *more, *unknown, *unsteady(patterns, pictures[order], camera_shape,
                                          projector_shape, sums, names)]  # fmt: skip


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
    words: Index
    table: Index
    places: Float

    @classmethod
    def of(cls, patterns: Float, shape: tuple[int, int], sums: KnownSums) -> _Code:
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

    def places_of(self, word: Index) -> Float:
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
        lit = mean > LIT * np.percentile(mean, BRIGHTEST) if mean.size else mean > 0
        half = (images.max(axis=0) + images.min(axis=0)) / 2
        return cls(code, images, lit, half)

    def words(self, order: Index) -> Index:
        """Return each pixel's codeword (P, 2, W), were the pictures in an order."""
        word = np.zeros(self.lit.shape, np.int64)
        for index, (first, second) in enumerate(self.code.bits):
            word |= self._bit(order, first, second) << index
        return word

    def exchanged(self, word: Index, order: Index, exchange: Exchange) -> Index:
        """Return the codewords after an exchange, computed from those before."""
        changed = {picture for pair in exchange for picture in pair}
        order = _apply(order, exchange)
        for index, (first, second) in enumerate(self.code.bits):
            if first in changed or second in changed:
                word = word & ~(1 << index) | self._bit(order, first, second) << index
        return word

    def _bit(self, order: Index, first: int, second: int) -> Index:
        complement = self.half if second < 0 else self.pictures[order[second]]
        bit: Index = (self.pictures[order[first]] > complement).astype(np.int64)
        return bit

    def jumps(self, word: Index, limit: float = np.inf) -> Float:
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


def _apply(order: Index, exchange: Exchange) -> Index:
    """Return an order of pictures in which pairs of them have changed places."""
    changed = order.copy()
    for pair in exchange:
        changed[list(pair)] = changed[list(pair[::-1])]
    return changed


def _exchanged_by_sums(
    sums: KnownSums, pictures: Float, view: _View, order: Index, names: Sequence[str]
) -> tuple[list[PictureFault], Index]:
    """Find exchanged pictures by combinations that should vanish, and the order without them."""
    faults: list[PictureFault] = []
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
    brightest = np.percentile(mean, BRIGHTEST)
    lit = mean > LIT * brightest
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
    view: _View, order: Index, exchanges: Sequence[Exchange]
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
    view: _View, order: Index, names: Sequence[str]
) -> tuple[list[PictureFault], Index]:
    """Find exchanged pictures by the decoded map's smoothness, and the order without them."""
    faults: list[PictureFault] = []
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


def _unknown_codes(view: _View, order: Index, rays: int) -> list[PictureFault]:
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
    return [PictureFault("unknown codes", tuple(range(len(order))), message)]


def _exchange_fault(
    exchanges: Sequence[Exchange], order: Index, names: Sequence[str], reason: str
) -> PictureFault:
    """Return the fault of an exchange, or of several that explain the pictures equally well."""
    said = [
        " and ".join(f"{names[order[i]]} with {names[order[j]]}" for i, j in exchange)
        for exchange in exchanges[:3]
    ]
    pictures = {int(order[at]) for exchange in exchanges for pair in exchange for at in pair}
    which = said[0] if len(said) == 1 else f"{said[0]} (or {', or '.join(said[1:])})"
    return PictureFault(
        "exchanged",
        tuple(sorted(pictures)),
        f"pictures are exchanged: {which}; {reason}. Give each picture the name of the other",
    )
