"""The number formats of stored transports: factors rounded to square roots of 8 or 16 bits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import BlockTree
from rfpipe.transport.arrays import rounded
from rfpipe.transport.hierarchical.leaves import LeafSet, factor_offsets, leaf_offsets
from rfpipe.units import NumberFormat

CODED_PARTS = ("block_a", "block_b", "codes", "scales")
"""The arrays of a rounded `LeafSet`, by which stores name them."""


def pack_leaves(
    tree: BlockTree, leaves: LeafSet, number_format: NumberFormat
) -> dict[str, NDArray[Any]]:
    """Return the arrays that a store keeps of a set of leaves.

    A factor is kept as ``(code / L)^2`` of its maximum, with L = 255 or 65,535. Each leaf and
    channel has a scale: the geometric mean of its two maxima, over ``L^2``. The step is even in the
    square root: as with shot noise, dim values are rounded less than bright ones, so that a glint
    doesn't drown its surroundings. A maximum is kept to float32, and what is 0 stays 0.

    Scalars stay as they are, for direct light is among them; so do factors that are not finite
    somewhere, and sets of which the scales would take more than the rounding saves. Terms that
    subtract from each other need more bits than light does: sets with signs or negative factors
    are rounded as `rounded` does. `signed_apart` keeps others out of such sets.

    Parameters
    ----------
    tree : BlockTree
    leaves : LeafSet
    number_format : {"float32", "uint16", "uint8"}

    Returns
    -------
    dict
        By `LEAF_PARTS`, and ``signs`` if there are any; or by `CODED_PARTS`: ``codes``, unsigned
        (channels, n_values), from the second channel on as differences to the first; ``scales``,
        float32 (channels, n).
    """
    blocks = {"block_a": leaves.block_a, "block_b": leaves.block_b}
    if leaves.scales is not None:
        if leaves.values.dtype == number_format:
            return {**blocks, "codes": _differences(leaves.values), "scales": leaves.scales}
        leaves = decoded(tree, leaves)
    exact = {**blocks, "values": leaves.values}
    if leaves.signs is not None:
        exact["signs"] = leaves.signs
    if number_format == "float32" or leaves.level == tree.n_levels - 1:
        return exact
    if not np.isfinite(leaves.values).all():
        return exact
    if leaves.signs is not None or (leaves.values < 0).any():
        return {**exact, "values": rounded(leaves.values, number_format)}
    dtype = np.dtype(number_format)
    if leaves.values.size * (4 - dtype.itemsize) <= 4 * len(leaves.values) * len(leaves):
        return exact
    starts, largest = tree.starts[leaves.level], np.iinfo(dtype).max
    *sides, size = factor_offsets(starts, leaves.block_a, leaves.block_b)
    begin = np.unique(np.concatenate(sides))
    maxima = np.maximum.reduceat(leaves.values, begin, axis=1).astype(np.float64)
    places = [np.searchsorted(begin, side) for side in sides]
    mean = np.sqrt(maxima[:, places[0]]) * np.sqrt(maxima[:, places[1]])
    for place in places:  # codes of a leaf that is zero are 0
        maxima[:, place] = np.where(mean > 0, maxima[:, place], np.inf)
    relative = leaves.values / np.repeat(maxima, np.diff(np.append(begin, size)), axis=1)
    codes = (np.sqrt(relative) * largest + 0.5).astype(dtype)
    scales = (mean / float(largest) ** 2).astype(np.float32)
    return {**blocks, "codes": _differences(codes), "scales": scales}


def unpack_leaves(level: int, arrays: Mapping[str, NDArray[Any]]) -> LeafSet:
    """Return the leaves of which a store has kept these arrays, rounded ones as codes."""
    blocks = arrays["block_a"], arrays["block_b"]
    if "values" in arrays:
        return LeafSet(level, *blocks, arrays["values"], signs=arrays.get("signs"))
    return LeafSet(level, *blocks, _from_differences(arrays["codes"]), arrays["scales"])


def decoded(tree: BlockTree, leaves: LeafSet) -> LeafSet:
    """Return rounded leaves with float32 factors, others as they are."""
    if leaves.scales is None:
        return leaves
    values = np.square(leaves.values, dtype=np.float32)
    values *= np.repeat(leaves.scales, np.diff(leaf_offsets(tree, leaves)), axis=1)
    return replace(leaves, values=values, scales=None)


def signed_apart(tree: BlockTree, leaves: LeafSet, number_format: NumberFormat) -> list[LeafSet]:
    """Return leaves in sets that `pack_leaves` rounds alike.

    Pairs that have a sign or negative factors in any of their terms come second, if a format
    rounds them otherwise.
    """
    coded = leaves.scales is not None or leaves.level == tree.n_levels - 1
    if number_format == "float32" or coded or not len(leaves):
        return [leaves]
    least = np.minimum.reduceat(leaves.values, leaf_offsets(tree, leaves)[:-1], axis=1)
    signed: NDArray[np.bool_] = np.any(least < 0, axis=0)
    if leaves.signs is not None:
        signed |= np.any(leaves.signs < 0, axis=0)
    pair = leaves.block_a * np.int64(tree.n_blocks(leaves.level)) + leaves.block_b
    signed = np.isin(pair, pair[signed])
    light, others = (leaves.subset(tree, chosen) for chosen in (~signed, signed))
    return [part for part in (replace(light, signs=None), others) if len(part)]


def _differences(codes: NDArray[Any]) -> NDArray[Any]:
    """Turn all channels but the first into differences to it, small ones into small numbers."""
    signed = (codes[1:] - codes[:1]).view(codes.dtype.name.removeprefix("u"))
    folded = (signed << 1) ^ (signed >> (8 * codes.itemsize - 1))
    return np.concatenate([codes[:1], folded.view(codes.dtype)])


def _from_differences(stored: NDArray[Any]) -> NDArray[Any]:
    """Undo `_differences`."""
    folded = stored[1:]
    one = folded.dtype.type(1)
    differences = (folded >> one) ^ (~(folded & one) + one)
    return np.concatenate([stored[:1], differences + stored[:1]])
