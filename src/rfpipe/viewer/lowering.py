"""From a transport of any kind to a program."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from rfpipe.blocks import BlockTree
from rfpipe.errors import InputError
from rfpipe.store.files import digest_of
from rfpipe.transport.base import Transport
from rfpipe.transport.dense import DenseTransport
from rfpipe.transport.footprints import FootprintTransport
from rfpipe.transport.hierarchical.leaves import (
    LeafSet,
    leaf_offsets,
    pack_leaves,
    runs,
)
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.low_rank import LowRankTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.transport.multiscale import MultiscaleTransport
from rfpipe.transport.sum import SumTransport
from rfpipe.transport.wavelet import WaveletTransport
from rfpipe.viewer.program import (
    CAMERA,
    PROJECTOR,
    Kind,
    Operation,
    Program,
    digest_of_array,
)
from rfpipe.viewer.smooth import pyramid

__all__ = ["lower"]

# Values a channel of an operation that workers may share out among them.
_SHARE = 2**17


def lower(transport: Transport, levels: Sequence[int] | None = None) -> Program:
    """Return the program of a transport, as known after some levels or at its last.

    Parameters
    ----------
    transport : Transport
        Of any kind of rfpipe's.
    levels : sequence of int, optional
        In rising order.

    Raises
    ------
    InputError
        If there is no such level, or the transport is of no kind that is known here.
    """
    builder = Builder(transport)
    for level in [transport.last_level] if levels is None else levels:
        builder.begin_level(level)
        counts: Counter[str] = Counter()
        for part, name in _parts(transport.truncate(level)):
            counts[name] += 1
            builder.begin_part(name, counts[name])
            _lower_part(builder, part)
    return builder.program()


class Builder:
    """A program while it is made, level by level; what two levels share is in it once."""

    def __init__(self, transport: Transport) -> None:
        shapes = transport.camera_shape, transport.projector_shape
        self._program = Program(*shapes, transport.channels)
        self._program.buffers = [math.prod(shapes[1]), math.prod(shapes[0])]
        self._buffers: dict[tuple[Any, ...], int] = {}
        self._chains: dict[tuple[Any, ...], int] = {}
        self._known: dict[tuple[Any, ...], Operation] = {}

    def begin_level(self, level: int) -> None:
        """Go on with what is seen at another level."""
        self._level = level
        self._program.levels.append(level)

    def begin_part(self, name: str, number: int) -> None:
        """Go on with another part, the `number`th of its name."""
        self._part, self._number = name, number

    def begin_chain(self, name: str, *, is_common: bool = False) -> None:
        """Go on with operations that feed each other; their buffers have names of their own.

        A chain may be common to parts that agree in all of it but what they name as theirs.
        """
        self._key = ("", 0, name) if is_common else (self._part, self._number, name)
        self._chain = self._chains.setdefault(self._key, len(self._chains))
        self._step, self._was_shared = 0, False

    def buffer(self, name: str, size: int) -> int:
        """Return the chain's buffer of that name and size."""
        key = (*self._key, name, size)
        if key not in self._buffers:
            self._buffers[key] = len(self._program.buffers)
            self._program.buffers.append(size)
        return self._buffers[key]

    def add(
        self, kind: Kind, source: int, target: int, arrays: Mapping[str, Any], **more: Any
    ) -> None:
        """Add an operation to the chain."""
        is_shared = more.get("shared", False)
        self._step += not (is_shared and self._was_shared)
        self._was_shared = is_shared
        kept = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        digests = {name: digest_of_array(array) for name, array in kept.items()}
        about = {"chain": self._chain, "part": self._part if is_shared else self._key[0], **more}
        identity = (kind, source, target, *digests.items(), *sorted(about.items()))
        if identity not in self._known:
            made = Operation(kind, source, target, kept, digests, [], step=self._step, **about)
            self._known[identity] = made
            self._program.operations.append(made)
        levels = self._known[identity].levels
        if self._level not in levels:
            levels.append(self._level)

    def csr(self, source: int, target: int, matrix: Any, **more: Any) -> None:
        """Add a sparse matrix of scipy's; values of several channels ``(C, entries)`` if given."""
        values = more.pop("values", matrix.data[None])
        arrays = {
            "counts": np.diff(matrix.indptr).astype(np.int32),
            "columns": matrix.indices.astype(np.int32),
            "values": values.astype(np.float32),
        }
        self.add("csr", source, target, arrays, **more)

    def program(self) -> Program:
        """Return what was made, in order."""
        self._program.operations.sort(key=lambda each: (each.chain, each.step))
        return self._program


def _parts(transport: Transport) -> Iterator[tuple[Transport, str]]:
    """Yield what a transport is the sum of, each with its name; sums of sums flat."""
    if not isinstance(transport, SumTransport):
        if isinstance(transport, FootprintTransport):
            yield transport, "direct"
        else:
            yield transport, "all"
        return
    for part in transport.parts:
        for inner, name in _parts(part):
            yield inner, _name_of(inner) if name == "all" else name


def _name_of(part: Transport) -> str:
    """Name a part of a sum by what it tells of light."""
    if isinstance(part, LowRankTransport):
        return "direct" if part.rank == 0 else "rows filled"
    if isinstance(part, MultiscaleTransport):
        return "near" if part.basis.is_near(*part.pack()[0]["pairs"]).all() else "far"
    return "residual"


def _lower_part(builder: Builder, part: Transport) -> None:
    for known, lowered in _LOWERED.items():
        if isinstance(part, known):
            builder.begin_chain(part.kind)
            lowered(builder, part)
            return
    raise InputError(
        f"a {type(part).__name__} can't be shown by the viewer; expected one of "
        f"{', '.join(known.__name__ for known in _LOWERED)}, or a sum of them"
    )


def _lower_hierarchical(builder: Builder, transport: HierarchicalTransport) -> None:
    """Rays into tree order, in which a block is one run; leaves; and back."""
    tree, rays = transport.tree, transport.tree.domain.size
    light, received = builder.buffer("light", rays), builder.buffer("received", rays)
    order = {"index": tree.order.astype(np.int32)}
    builder.add("gather", PROJECTOR, light, order)
    for leaves in transport.stored_leaf_sets:
        lengths = np.diff(leaf_offsets(tree, leaves))
        chosen = np.arange(len(leaves))
        for run in runs(lengths, _SHARE):
            few = leaves.subset(tree, (chosen >= run.start) & (chosen < run.stop))
            _add_leaves(builder, tree, few, light, received)
    builder.add("gather", received, CAMERA, order, transposed=True)


def _add_leaves(
    builder: Builder, tree: BlockTree, leaves: LeafSet, light: int, received: int
) -> None:
    if leaves.level == tree.n_levels - 1:
        arrays = {"first": leaves.block_a, "second": leaves.block_b, "values": leaves.values}
        builder.add("pairs", light, received, arrays, shared=True)
        return
    # factors that a store hasn't rounded take 16 bits here: 1e-5 of their values
    number_format = "uint16" if leaves.scales is None else leaves.values.dtype.name
    packed = pack_leaves(tree, leaves, number_format)  # type: ignore[arg-type]
    sizes = np.diff(tree.starts[leaves.level]).astype(np.int32)
    builder.add("leaves", light, received, {"sizes": sizes, **packed}, shared=True)


def _lower_multilevel(builder: Builder, transport: MultilevelTransport) -> None:
    """Each level: means of the light over nodes, and what pixels see of each."""
    from scipy.sparse import csr_array

    tree, pixels = transport.tree, math.prod(transport.camera_shape)
    for pairs, spread in transport.spread_pairs():
        builder.begin_chain(f"level {pairs.level}")
        shares = spread.shares[0]
        nodes = builder.buffer("nodes", shares.shape[0])
        # shares have one structure in all channels, of which none stores its zeros apart
        columns = tree.order[shares.indices]
        matrix = csr_array((shares.data, columns, shares.indptr), shape=shares.shape)
        values = np.stack([plane.data for plane in spread.shares])
        builder.csr(PROJECTOR, nodes, matrix, values=values)
        order = np.argsort(spread.node, kind="stable")
        counts = np.bincount(spread.node, minlength=shares.shape[0])
        ends = np.append(0, np.cumsum(counts))
        for run in runs(counts + 1, _SHARE):
            entries = order[ends[run.start] : ends[run.stop]]
            responses = csr_array(
                (pairs.values[0, entries], pairs.pixel[entries],
                 ends[run.start : run.stop + 1] - ends[run.start]),
                shape=(run.stop - run.start, pixels),
            )  # fmt: skip
            builder.csr(
                nodes, CAMERA, responses, values=pairs.values[:, entries], source_at=run.start,
                transposed=True, shared=True,
            )  # fmt: skip


def _lower_dense(builder: Builder, transport: DenseTransport) -> None:
    rows, columns = transport.matrix.shape[1:]
    step = max(1, 2 * _SHARE // columns)
    for first in range(0, rows, step):
        arrays = {"values": transport.matrix[:, first : first + step]}
        builder.add("dense", PROJECTOR, CAMERA, arrays, target_at=first, shared=True)


def _lower_low_rank(builder: Builder, transport: LowRankTransport) -> None:
    """The diagonal, and the terms."""
    arrays = transport.pack()[0]
    if "diagonal" in arrays:
        builder.add("scale", PROJECTOR, CAMERA, {"values": arrays["diagonal"]})
    right = arrays.get("right", arrays["left"])
    if count := transport.rank:
        builder.begin_chain("terms")
        shares, strengths = builder.buffer("shares", count), builder.buffer("terms", count)
        builder.add("dense", PROJECTOR, shares, {"values": right})
        builder.add("scale", shares, strengths, {"values": arrays["strengths"]})
        builder.add("dense", strengths, CAMERA, {"values": arrays["left"]}, transposed=True)


def _lower_multiscale(builder: Builder, transport: MultiscaleTransport) -> None:
    """``F B S B^T F``, with B by the pyramid of its scales."""
    arrays, basis = transport.pack()[0], transport.basis
    rays = math.prod(transport.camera_shape)
    # near and far range go by the same functions, of which each worker needs one pyramid
    same = digest_of(arrays["functions"], arrays["factor"])
    builder.begin_chain(f"functions {same}", is_common=True)
    light, received = builder.buffer("light", rays), builder.buffer("received", rays)
    given, taken = builder.buffer("given", len(basis)), builder.buffer("taken", len(basis))
    steps, places = pyramid(basis)
    builder.add("scale", PROJECTOR, light, {"values": arrays["factor"]})
    grids = [light]
    for octave, step in enumerate(steps):
        grids.append(builder.buffer(f"grid {octave}", step.shape[1]))
        builder.csr(grids[-2], grids[-1], step, transposed=True)
    for octave, start, index in places:
        builder.add("gather", grids[octave], given, {"index": index}, target_at=start)
    first, second = arrays["pairs"]
    order = np.lexsort((second, first))
    for start in range(0, len(order), _SHARE):
        run = order[start : start + _SHARE]
        coupled = {"first": first[run], "second": second[run], "values": arrays["cores"][:, run]}
        builder.add("pairs", given, taken, coupled, shared=True)
    back = [
        received,
        *(builder.buffer(f"back {octave}", step.shape[1]) for octave, step in enumerate(steps)),
    ]
    for octave, start, index in places:
        builder.add(
            "gather", taken, back[octave], {"index": index}, source_at=start, transposed=True
        )
    for octave in range(len(steps), 0, -1):
        builder.csr(back[octave], back[octave - 1], steps[octave - 1])
    builder.add("scale", received, CAMERA, {"values": arrays["factor"]})


def _lower_wavelet(builder: Builder, transport: WaveletTransport) -> None:
    """``F W^T C W F`` on cells."""
    from scipy.sparse import csr_array

    arrays, cells = transport.pack()[0], transport.cells
    rays = math.prod(transport.camera_shape)
    ones = np.ones(rays, np.float32)
    spread = csr_array((ones, cells.of_ray, np.arange(rays + 1)), shape=(rays, cells.count))
    wavelets = csr_array(cells.haar.forward(np.eye(cells.count, dtype=np.float32)))
    light, received = builder.buffer("light", rays), builder.buffer("received", rays)
    of_cells, by_cells = (builder.buffer(name, cells.count) for name in ("of cells", "by cells"))
    given, taken = (builder.buffer(name, cells.haar.size) for name in ("given", "taken"))
    builder.add("scale", PROJECTOR, light, {"values": arrays["factor"]})
    builder.csr(light, of_cells, spread, transposed=True)
    builder.csr(of_cells, given, wavelets)
    first, second = arrays["pairs"]
    coupled = {"first": first, "second": second, "values": arrays["cores"]}
    builder.add("pairs", given, taken, coupled)
    builder.csr(taken, by_cells, wavelets, transposed=True)
    builder.csr(by_cells, received, spread)
    builder.add("scale", received, CAMERA, {"values": arrays["factor"]})


def _lower_footprints(builder: Builder, transport: FootprintTransport) -> None:
    """``D``, and ``diag(f) L S R^T diag(g)`` as a part of its own."""
    from scipy.sparse import csr_array

    arrays = transport.pack()[0]

    def add(name: str, source: int, target: int, columns: int, **more: Any) -> None:
        values = np.atleast_2d(arrays[name])
        parts = values[0], arrays[f"{name}_columns"], arrays[f"{name}_starts"]
        matrix = csr_array(parts, shape=(len(parts[2]) - 1, columns))
        builder.csr(source, target, matrix, values=values, **more)

    pixels, rays = (math.prod(it) for it in (transport.camera_shape, transport.projector_shape))
    add("footprints", PROJECTOR, CAMERA, rays)
    if not arrays["cores"].any():
        return
    builder.begin_part("indirect", 1)
    builder.begin_chain(transport.kind)
    columns = (arrays[f"{name}_columns"] for name in ("cores", "right"))
    functions = 1 + max(int(it.max(initial=-1)) for it in columns)
    light, sent = builder.buffer("light", rays), builder.buffer("sent", functions)
    sums = builder.buffer("got", len(arrays["cores_starts"]) - 1)
    smooth = builder.buffer("smooth", pixels)
    builder.add("scale", PROJECTOR, light, {"values": arrays["projector_factor"]})
    add("right", light, sent, functions, transposed=True)
    add("cores", sent, sums, functions)
    add("left", sums, smooth, len(arrays["cores_starts"]) - 1)
    builder.add("scale", smooth, CAMERA, {"values": arrays["camera_factor"]})


_LOWERED: dict[type[Transport], Callable[[Builder, Any], None]] = {
    HierarchicalTransport: _lower_hierarchical,
    MultilevelTransport: _lower_multilevel,
    DenseTransport: _lower_dense,
    LowRankTransport: _lower_low_rank,
    MultiscaleTransport: _lower_multiscale,
    WaveletTransport: _lower_wavelet,
    FootprintTransport: _lower_footprints,
}
