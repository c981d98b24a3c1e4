"""Compilation of transports to programs of linear operations."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

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
from rfpipe.transport.wavelet import Cells, WaveletTransport
from rfpipe.viewer.program import (
    CAMERA,
    PROJECTOR,
    Operation,
    OperationKind,
    Program,
    digest_of_array,
)
from rfpipe.viewer.smooth import pyramid

__all__ = ["lower"]

# Maximum number of values per channel in an operation that is distributed among workers.
_SHARE = 2**17


def lower(transport: Transport, levels: Sequence[int] | None = None) -> Program:
    """Compile a transport to a program, truncated to some levels or at its last level.

    Parameters
    ----------
    transport : Transport
        Of any class in rfpipe.
    levels : sequence of int, optional
        In ascending order.

    Raises
    ------
    InputError
        If a level doesn't exist, or the transport's class isn't supported.
    """
    program = _ProgramBuilder(transport)
    for level in [transport.last_level] if levels is None else levels:
        program.levels.append(level)
        counts: Counter[str] = Counter()
        for component, name in _components(transport.truncate(level)):
            counts[name] += 1
            _lower_component(PartBuilder(program, level, name, counts[name]), component)
    return program.build()


class _ProgramBuilder:
    """Operations, buffers and chains of a program; those shared by levels are stored once."""

    def __init__(self, transport: Transport) -> None:
        self._shapes = transport.camera_shape, transport.projector_shape
        self._channels = transport.channels
        self._sizes = [math.prod(transport.projector_shape), math.prod(transport.camera_shape)]
        self._buffers: dict[tuple[Any, ...], int] = {}
        self._chains: dict[tuple[Any, ...], int] = {}
        self._operations: dict[tuple[Any, ...], Operation] = {}
        self.levels: list[int] = []

    def chain(self, key: tuple[Any, ...]) -> int:
        """Return the number of a chain."""
        return self._chains.setdefault(key, len(self._chains))

    def buffer(self, key: tuple[Any, ...], size: int) -> int:
        """Return the number of a buffer."""
        if key not in self._buffers:
            self._buffers[key] = len(self._sizes)
            self._sizes.append(size)
        return self._buffers[key]

    def add(self, operation: Operation, level: int) -> None:
        """Add an operation at a level; equal operations of several levels become one."""
        levels = self._operations.setdefault(operation.identity, operation).levels
        if level not in levels:
            levels.append(level)

    def build(self) -> Program:
        """Return the program, with operations in the order of chains and steps."""
        operations = sorted(self._operations.values(), key=lambda op: (op.chain, op.step))
        return Program(*self._shapes, self._channels, self.levels, self._sizes, operations)


@dataclass(frozen=True)
class PartBuilder:
    """Builder of one part of a program at one level; `number` counts parts of the same name."""

    program: _ProgramBuilder
    level: int
    name: str
    number: int

    def chain(self, name: str, *, is_common: bool = False) -> Chain:
        """Start a chain of operations that feed each other.

        A common chain is shared by parts in which all its operations except shared ones agree.
        """
        part, number = ("", 0) if is_common else (self.name, self.number)
        return Chain(self, (part, number, name))


class Chain:
    """Builder of a chain of operations; its buffers have their own names."""

    def __init__(self, part: PartBuilder, key: tuple[str, int, str]) -> None:
        self._part, self._key = part, key
        self._number = part.program.chain(key)
        self._step, self._previous_shared = 0, False

    def buffer(self, name: str, size: int) -> int:
        """Return the number of the chain's buffer of this name and size."""
        return self._part.program.buffer((*self._key, name, size), size)

    def add(
        self,
        kind: OperationKind,
        source: int,
        target: int,
        arrays: Mapping[str, Any],
        **options: Any,
    ) -> None:
        """Append an operation; consecutive shared operations form one step."""
        is_shared = options.get("shared", False)
        self._step += not (is_shared and self._previous_shared)
        self._previous_shared = is_shared
        contiguous = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
        operation = Operation(
            kind,
            source,
            target,
            contiguous,
            {name: digest_of_array(array) for name, array in contiguous.items()},
            [],
            chain=self._number,
            step=self._step,
            part=self._part.name if is_shared else self._key[0],
            **options,
        )
        self._part.program.add(operation, self._part.level)

    def csr(self, source: int, target: int, matrix: Any, **options: Any) -> None:
        """Append a sparse matrix of SciPy; `values` (C, entries) replace its data."""
        values = options.pop("values", matrix.data[None])
        arrays = {
            "counts": np.diff(matrix.indptr).astype(np.int32),
            "columns": matrix.indices.astype(np.int32),
            "values": values.astype(np.float32),
        }
        self.add("csr", source, target, arrays, **options)


def _components(transport: Transport) -> Iterator[tuple[Transport, str]]:
    """Yield the terms of a sum, flattened, with the names of their parts."""
    if isinstance(transport, FootprintTransport):
        yield transport, "direct"
    elif not isinstance(transport, SumTransport):
        yield transport, "all"
    else:
        for part in transport.parts:
            for component, name in _components(part):
                yield component, _part_name(component) if name == "all" else name


def _part_name(part: Transport) -> str:
    """Name a term of a sum by the light that it models."""
    if isinstance(part, LowRankTransport):
        return "direct" if part.rank == 0 else "rows filled"
    if isinstance(part, MultiscaleTransport):
        return "near" if part.basis.is_near(*part.pack()[0]["pairs"]).all() else "far"
    return "residual"


def _lower_component(part: PartBuilder, component: Transport) -> None:
    for kind, lower_kind in _LOWERED.items():
        if isinstance(component, kind):
            lower_kind(part, component)
            return
    raise InputError(
        f"the viewer doesn't support a {type(component).__name__}; expected one of "
        f"{', '.join(kind.__name__ for kind in _LOWERED)}, or a sum of them"
    )


def _lower_hierarchical(part: PartBuilder, transport: HierarchicalTransport) -> None:
    """Permute rays into tree order, where a block is contiguous, apply leaves, permute back."""
    chain = part.chain(transport.kind)
    tree, rays = transport.tree, transport.tree.domain.size
    light, received = chain.buffer("light", rays), chain.buffer("received", rays)
    order = {"index": tree.order.astype(np.int32)}
    chain.add("gather", PROJECTOR, light, order)
    for leaves in transport.stored_leaf_sets:
        lengths = np.diff(leaf_offsets(tree, leaves))
        index = np.arange(len(leaves))
        for run in runs(lengths, _SHARE):
            batch = leaves.subset(tree, (index >= run.start) & (index < run.stop))
            _add_leaves(chain, tree, batch, light, received)
    chain.add("gather", received, CAMERA, order, transposed=True)


def _add_leaves(chain: Chain, tree: BlockTree, leaves: LeafSet, light: int, received: int) -> None:
    if leaves.level == tree.n_levels - 1:
        arrays = {"first": leaves.block_a, "second": leaves.block_b, "values": leaves.values}
        chain.add("pairs", light, received, arrays, shared=True)
        return
    # unrounded factors are quantized to 16 bits, with a relative error of 1e-5
    number_format = "uint16" if leaves.scales is None else leaves.values.dtype.name
    packed = pack_leaves(tree, leaves, number_format)  # type: ignore[arg-type]
    sizes = np.diff(tree.starts[leaves.level]).astype(np.int32)
    chain.add("leaves", light, received, {"sizes": sizes, **packed}, shared=True)


def _lower_multilevel(part: PartBuilder, transport: MultilevelTransport) -> None:
    """At each level, average the light over nodes, and apply the pixels' responses to nodes."""
    from scipy.sparse import csr_array

    tree, pixels = transport.tree, math.prod(transport.camera_shape)
    for pairs, spread in transport.spread_responses():
        chain = part.chain(f"level {pairs.level}")
        shares = spread.shares[0]
        nodes = chain.buffer("nodes", shares.shape[0])
        # all channels of the shares have the same sparsity pattern
        columns = tree.order[shares.indices]
        matrix = csr_array((shares.data, columns, shares.indptr), shape=shares.shape)
        values = np.stack([plane.data for plane in spread.shares])
        chain.csr(PROJECTOR, nodes, matrix, values=values)
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
            chain.csr(
                nodes, CAMERA, responses, values=pairs.values[:, entries], source_at=run.start,
                transposed=True, shared=True,
            )  # fmt: skip


def _lower_dense(part: PartBuilder, transport: DenseTransport) -> None:
    chain = part.chain(transport.kind)
    rows, columns = transport.matrix.shape[1:]
    step = max(1, 2 * _SHARE // columns)
    for first in range(0, rows, step):
        arrays = {"values": transport.matrix[:, first : first + step]}
        chain.add("dense", PROJECTOR, CAMERA, arrays, target_at=first, shared=True)


def _lower_low_rank(part: PartBuilder, transport: LowRankTransport) -> None:
    """Apply the diagonal, and ``L diag(s) R^T``."""
    arrays = transport.pack()[0]
    if "diagonal" in arrays:
        diagonal = {"values": arrays["diagonal"]}
        part.chain(transport.kind).add("scale", PROJECTOR, CAMERA, diagonal)
    right = arrays.get("right", arrays["left"])
    if count := transport.rank:
        chain = part.chain("terms")
        shares, strengths = chain.buffer("shares", count), chain.buffer("terms", count)
        chain.add("dense", PROJECTOR, shares, {"values": right})
        chain.add("scale", shares, strengths, {"values": arrays["strengths"]})
        chain.add("dense", strengths, CAMERA, {"values": arrays["left"]}, transposed=True)


def _lower_multiscale(part: PartBuilder, transport: MultiscaleTransport) -> None:
    """Apply ``F B S B^T F``, where B is computed by a pyramid over its scales."""
    arrays, basis, cells = transport.pack()[0], transport.basis, transport.cells
    rays = math.prod(transport.camera_shape)
    # near and far range use the same functions, so that each worker needs one pyramid
    digest = digest_of(arrays["functions"], arrays["factor"])
    chain = part.chain(f"functions {digest}", is_common=True)
    light, received = chain.buffer("light", rays), chain.buffer("received", rays)
    source, target = (chain.buffer(name, len(basis)) for name in ("source", "target"))
    steps, placements = pyramid(basis)
    chain.add("scale", PROJECTOR, light, {"values": arrays["factor"]})
    cell_light, cell_sum = light, received
    if cells.side > 1:
        cell_light = chain.buffer("lit cells", cells.count)
        cell_sum = chain.buffer("sums of cells", cells.count)
        chain.csr(light, cell_light, _spread_over_cells(cells), transposed=True)
    grids = [cell_light]
    for octave, step in enumerate(steps):
        grids.append(chain.buffer(f"grid {octave}", step.shape[1]))
        chain.csr(grids[-2], grids[-1], step, transposed=True)
    for octave, start, index in placements:
        chain.add("gather", grids[octave], source, {"index": index}, target_at=start)
    first, second = arrays["pairs"]
    order = np.lexsort((second, first))
    for start in range(0, len(order), _SHARE):
        run = order[start : start + _SHARE]
        pairs = {"first": first[run], "second": second[run], "values": arrays["cores"][:, run]}
        chain.add("pairs", source, target, pairs, shared=True)
    sums = [
        cell_sum,
        *(chain.buffer(f"sum {octave}", step.shape[1]) for octave, step in enumerate(steps)),
    ]
    for octave, start, index in placements:
        chain.add(
            "gather", target, sums[octave], {"index": index}, source_at=start, transposed=True
        )
    for octave in range(len(steps), 0, -1):
        chain.csr(sums[octave], sums[octave - 1], steps[octave - 1])
    if cells.side > 1:
        chain.csr(cell_sum, received, _spread_over_cells(cells))
    chain.add("scale", received, CAMERA, {"values": arrays["factor"]})


def _spread_over_cells(cells: Cells) -> Any:
    """Return the sparse matrix (rays, cells) that gives each ray the value of its cell."""
    from scipy.sparse import csr_array

    rays = len(cells.of_ray)
    ones = np.ones(rays, np.float32)
    return csr_array((ones, cells.of_ray, np.arange(rays + 1)), shape=(rays, cells.count))


def _lower_wavelet(part: PartBuilder, transport: WaveletTransport) -> None:
    """Apply ``F W^T C W F`` on cells."""
    from scipy.sparse import csr_array

    chain = part.chain(transport.kind)
    arrays, cells = transport.pack()[0], transport.cells
    rays = math.prod(transport.camera_shape)
    spread = _spread_over_cells(cells)
    wavelets = csr_array(cells.haar.forward(np.eye(cells.count, dtype=np.float32)))
    light, received = chain.buffer("light", rays), chain.buffer("received", rays)
    lit, sums = (chain.buffer(name, cells.count) for name in ("lit cells", "sums of cells"))
    source, target = (chain.buffer(name, cells.haar.size) for name in ("source", "target"))
    chain.add("scale", PROJECTOR, light, {"values": arrays["factor"]})
    chain.csr(light, lit, spread, transposed=True)
    chain.csr(lit, source, wavelets)
    first, second = arrays["pairs"]
    pairs = {"first": first, "second": second, "values": arrays["cores"]}
    chain.add("pairs", source, target, pairs)
    chain.csr(target, sums, wavelets, transposed=True)
    chain.csr(sums, received, spread)
    chain.add("scale", received, CAMERA, {"values": arrays["factor"]})


def _lower_footprints(part: PartBuilder, transport: FootprintTransport) -> None:
    """Apply ``D``, and ``diag(f) L S R^T diag(g)`` as the part "indirect"."""
    arrays = transport.pack()[0]
    pixels, rays = math.prod(transport.camera_shape), math.prod(transport.projector_shape)
    footprints, values = _sparse(arrays, "footprints", rays)
    part.chain(transport.kind).csr(PROJECTOR, CAMERA, footprints, values=values)
    if not arrays["cores"].any():
        return
    chain = replace(part, name="indirect", number=1).chain(transport.kind)
    columns = (arrays[f"{name}_columns"] for name in ("cores", "right"))
    functions = 1 + max(int(indices.max(initial=-1)) for indices in columns)
    left_functions = len(arrays["cores_starts"]) - 1
    light, source = chain.buffer("light", rays), chain.buffer("source", functions)
    target, smooth = chain.buffer("target", left_functions), chain.buffer("smooth", pixels)
    chain.add("scale", PROJECTOR, light, {"values": arrays["projector_factor"]})
    right, values = _sparse(arrays, "right", functions)
    chain.csr(light, source, right, values=values, transposed=True)
    cores, values = _sparse(arrays, "cores", functions)
    chain.csr(source, target, cores, values=values)
    left, values = _sparse(arrays, "left", left_functions)
    chain.csr(target, smooth, left, values=values)
    chain.add("scale", smooth, CAMERA, {"values": arrays["camera_factor"]})


def _sparse(arrays: Mapping[str, Any], name: str, columns: int) -> tuple[Any, NDArray[Any]]:
    """Return a stored sparse matrix of the first channel, and its values (C, entries)."""
    from scipy.sparse import csr_array

    values = np.atleast_2d(arrays[name])
    content = values[0], arrays[f"{name}_columns"], arrays[f"{name}_starts"]
    return csr_array(content, shape=(len(content[2]) - 1, columns)), values


_LOWERED: dict[type[Transport], Callable[[PartBuilder, Any], None]] = {
    HierarchicalTransport: _lower_hierarchical,
    MultilevelTransport: _lower_multilevel,
    DenseTransport: _lower_dense,
    LowRankTransport: _lower_low_rank,
    MultiscaleTransport: _lower_multiscale,
    WaveletTransport: _lower_wavelet,
    FootprintTransport: _lower_footprints,
}
