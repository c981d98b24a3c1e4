"""Stage: relight a transport, and compare with the truth where it is known."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.array_types import Float
from rfpipe.blocks import BlockTree, RayDomain
from rfpipe.errors import IntegrityError
from rfpipe.provenance import fingerprint
from rfpipe.references.reference_images import read_floodlit
from rfpipe.relighting import KINDS, picture_squared_norms, relighting_pictures
from rfpipe.storage.files import FolderStorage
from rfpipe.storage.results import write_result
from rfpipe.store import open_arrays, read_manifest
from rfpipe.transport import Transport, open_transport
from rfpipe.transport.hierarchical.transport import HierarchicalTransport
from rfpipe.transport.multilevel import MultilevelTransport
from rfpipe.units import RADIANCE_UNIT

if TYPE_CHECKING:
    from rfpipe.config import SceneSettings
    from rfpipe.scenes import Scene

NO_LEAF = -1
"""Level of an entry of T that is in no leaf, because it was measured as empty."""


_SINGLE_BATCH, _SINGLE_PIXELS = 32, 2**24
"""Number of single-pixel patterns relit together, and the largest number of their pixels."""

_PICTURES, _MAX_PIXELS = 96, 2e7
"""Number of pictures of the mean error; fewer, if these have more than that many pixels."""

_PICTURE_BATCH = 8
"""Number of these pictures relit together."""

_SEED = 2006
"""Seed of their patterns."""


def images_of(scene: Scene, patterns: Float) -> Float:
    """Return exact images ``(P, *camera_shape, C)`` under patterns ``(P, *projector_shape)``."""
    return scene.apply(patterns).reshape(len(patterns), *scene.camera_shape, scene.channels)


def right_half(shape: tuple[int, ...]) -> Float:
    """Return the pattern of [Fig. 5.9], whose right half is lit; a middle column is dark."""
    pattern = np.zeros(shape, np.float32)
    pattern[..., (shape[-1] + 1) // 2 :] = 1
    return pattern


def one_view_at_a_time(shape: tuple[int, ...]) -> Float:
    """Return the patterns ``(V, *shape)`` of which each lights one of V views."""
    domain = RayDomain(shape)
    patterns = np.zeros((domain.views, *domain.stack_shape), np.float32)
    patterns[range(domain.views), range(domain.views)] = 1
    return patterns.reshape(domain.views, *shape)


def relit_arrays(transport: Transport, scene: Scene) -> dict[str, NDArray[Any]]:
    """Return relit pictures of a transport and the true ones of its scene, for report and figures.

    Returns
    -------
    dict of ndarray
        float32, except ``line_levels``.

        ``patterns`` (P, *projector_shape), ``relit`` and ``truth`` (P, *camera_shape, C): the
        reference patterns. ``floodlit_relit``, ``floodlit_truth``, ``albedo`` (*camera_shape, C).
        ``levels_relit`` (L, *camera_shape, C): the first pattern relit by the transport truncated
        at each of its `Transport.known_levels`.

        For an image domain: ``half_relit``, ``half_truth`` (H, W, C), see `right_half`.
        ``line_relit``, ``line_truth`` (W, W', C): entries of T between the middle rows of camera
        (first axis) and projector (second axis). ``line_levels`` (W, W'), see `leaf_levels`, if the
        transport has leaves.

        For a light field: ``views_relit``, ``views_truth`` (V, V, H, W, C): image in each view
        (second axis) under the light of each view (first axis).
    """
    from rfpipe.scenes import relighting_patterns

    shapes = transport.camera_shape, transport.projector_shape
    truth_of = partial(images_of, scene)
    patterns = np.stack(list(relighting_patterns(shapes[1]).values()))
    arrays = {
        **_relit(transport, patterns),
        "truth": truth_of(patterns),
        "floodlit_truth": truth_of(np.ones((1, *shapes[1]), np.float32))[0],
        "albedo": scene.albedo,
    }
    if RayDomain(shapes[1]).is_stack:
        lights = one_view_at_a_time(shapes[1])
        stack = (len(lights), *RayDomain(shapes[0]).stack_shape, transport.channels)
        views = transport.relight_batch(lights).reshape(stack), truth_of(lights).reshape(stack)
        return arrays | dict(zip(("views_relit", "views_truth"), views, strict=True))
    half = right_half(shapes[1])
    rows = _middle_row(shapes[0]), _middle_row(shapes[1])
    levels = leaf_levels(transport, *rows)
    return {
        **arrays,
        "half_relit": transport.relight(half),
        "half_truth": truth_of(half[None])[0],
        "line_relit": _entries(transport.relight_batch, shapes[1], *rows),
        "line_truth": _entries(truth_of, shapes[1], *rows),
        **({} if levels is None else {"line_levels": levels}),
    }


def relit_of_captured(transport: Transport, floodlit: Float) -> dict[str, NDArray[Any]]:
    """Return relit pictures of a transport whose scene has no known truth.

    These are ``patterns``, ``relit``, ``levels_relit`` and ``floodlit_relit`` as in `relit_arrays`,
    and ``floodlit_captured``, the measured floodlit image (*camera_shape, C).
    """
    from rfpipe.scenes import relighting_patterns

    patterns = np.stack(list(relighting_patterns(transport.projector_shape).values()))
    return {**_relit(transport, patterns), "floodlit_captured": floodlit}


def _relit(transport: Transport, patterns: Float) -> dict[str, NDArray[Any]]:
    """Relight with the reference patterns, and with the first one at each known level."""
    floodlight = np.ones((1, *transport.projector_shape), np.float32)
    relit = transport.relight_batch(np.concatenate([patterns, floodlight]))
    cut = [transport.truncate(level).relight(patterns[0]) for level in transport.known_levels]
    return {
        "patterns": patterns,
        "relit": relit[:-1],
        "floodlit_relit": relit[-1],
        "levels_relit": np.stack(cut),
    }


def mean_errors(
    transport: Transport, scene: Scene, floodlit: Float, *, is_coaxial: bool
) -> dict[str, Any]:
    """Return the errors of a transport over the pictures of `rfpipe.relighting`, as plain data.

    Parameters
    ----------
    floodlit : ndarray of float32, shape (*camera_shape, C)
        True floodlit image.
    is_coaxial : bool
        Whether pixels that a pattern leaves dark have no direct light.

    Returns
    -------
    dict
        ``mean_error``, ``worst_error``; ``errors``: means over each of `KINDS`; ``plain_errors``:
        the same, relative to each picture's norm, however dark it is; ``level_errors``: mean error
        at each of `Transport.known_levels`. For coaxial rigs, ``mean_indirect`` and
        ``indirect_errors`` of each kind: errors of indirect light.
    """
    count = min(max(int(_MAX_PIXELS / floodlit[..., 0].size), len(KINDS)), _PICTURES)
    patterns = relighting_pictures(transport.projector_shape, count, _SEED)
    batches = [
        patterns[first : first + _PICTURE_BATCH]
        for first in range(0, len(patterns), _PICTURE_BATCH)
    ]
    cuts = [*map(transport.truncate, transport.known_levels[:-1]), transport]
    images = chain.from_iterable(
        np.stack([cut.relight_batch(batch) for cut in cuts], axis=1) for batch in batches
    )
    truth = chain.from_iterable(images_of(scene, batch) for batch in batches)
    dark = patterns == 0 if is_coaxial else None
    total, indirect = picture_squared_norms(images, truth, patterns, floodlit, dark)
    levels = total.errors
    facts = {
        "mean_error": float(levels[-1].mean()),
        "worst_error": float(levels[-1].max()),
        "errors": _by_kind(levels[-1]),
        "plain_errors": _by_kind(total.plain_errors[-1]),
        "level_errors": levels.mean(axis=1).tolist(),
    }
    if indirect is not None:
        facts["mean_indirect"] = float(indirect.errors[-1].mean())
        facts["indirect_errors"] = _by_kind(indirect.errors[-1])
    return facts


def _by_kind(errors: NDArray[np.float64]) -> dict[str, float]:
    return {kind: float(errors[first :: len(KINDS)].mean()) for first, kind in enumerate(KINDS)}


def _middle_row(shape: tuple[int, ...]) -> int:
    return RayDomain(shape).image_shape[0] // 2


def _entries(
    light: Callable[[Float], Float], shape: tuple[int, ...], camera_row: int, projector_row: int
) -> Float:
    """Return the entries (W, W', C) of T between a row of the camera and one of the projector.

    `light` maps patterns (P, *shape) to images (P, H, W, C).
    """
    columns = []
    batch = max(1, min(_SINGLE_BATCH, _SINGLE_PIXELS // int(np.prod(shape))))
    for first in range(0, shape[-1], batch):
        count = min(batch, shape[-1] - first)
        patterns = np.zeros((count, *shape), np.float32)
        patterns[range(count), projector_row, range(first, first + count)] = 1
        columns.append(light(patterns)[:, camera_row])
    return np.concatenate(columns).swapaxes(0, 1)


def leaf_levels(
    transport: Transport, camera_row: int, projector_row: int
) -> NDArray[np.int16] | None:
    """Return the level of the leaf of each entry of T between two image rows.

    Returns
    -------
    ndarray of int16, shape (W, W'), or None
        Rays of the camera's row along the first axis, of the projector's along the second;
        `NO_LEAF` for empty entries. None for a transport without leaves.
    """
    shape = transport.camera_shape[-1], transport.projector_shape[-1]
    levels = np.full(shape, NO_LEAF, np.int16)
    if isinstance(transport, HierarchicalTransport):
        sets: Any = transport.leaf_sets
    elif isinstance(transport, MultilevelTransport):
        sets = transport.level_responses
    else:
        return None
    for leaves in sets:
        number, column_block = _blocks_of_row(transport.tree, leaves.level, projector_row)
        if isinstance(transport, HierarchicalTransport):
            a, b = number[leaves.block_a], number[leaves.block_b]
            row, column, row_block = np.append(a, b), np.append(b, a), column_block
        else:
            row, column = leaves.pixel - camera_row * shape[0], number[leaves.block]
            row_block = np.arange(shape[0])
        inside = (row >= 0) & (row < shape[0]) & (column >= 0)
        is_leaf = np.zeros(shape, np.bool_)
        is_leaf[row[inside], column[inside]] = True
        levels[is_leaf[np.ix_(row_block, column_block)]] = leaves.level
    return levels


def _blocks_of_row(
    tree: BlockTree, level: int, row: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the position of each block along an image row, and the position for each ray.

    Blocks outside the row have the position -1.
    """
    present, ray_block = np.unique(tree.labels(level)[row], return_inverse=True)
    number = np.full(tree.n_blocks(level), -1, np.int64)
    number[present] = np.arange(len(present))
    return number, ray_block


def check_transport(store: Path) -> None:
    """Raise IntegrityError if a transport's digest differs from the one in its manifest."""
    manifest = store.with_suffix(".json")
    if not manifest.is_file() or store.name != "transport.zarr":
        return
    stated, digest = read_manifest(manifest).get("digest"), open_arrays(store).digest
    if stated not in (None, digest):
        raise IntegrityError(
            f"{store}: the digest is {digest}, but its manifest says {stated}",
            remedy=f"To assemble it again from its levels, remove {manifest} and run again",
        )


def run(folder: Path, scene: SceneSettings, code: str) -> None:
    """Relight the transport in a folder of results; write ``relight.zarr`` and ``relight.json``."""
    from rfpipe.scenes import relighting_patterns, scene_from_config

    acquired = read_manifest(folder / "transport.json")
    check_transport(folder / "transport.zarr")
    transport = open_transport(folder / "transport.zarr")
    errors: dict[str, Any] = {}
    recorded: dict[str, Any] = {}
    light: dict[str, Any] = {}
    if scene.has_truth:
        simulated = scene_from_config(scene)
        arrays = relit_arrays(transport, simulated)
        truth = arrays["floodlit_truth"]
        errors = mean_errors(transport, simulated, truth, is_coaxial=scene.is_coaxial)
        recorded = simulated.recorded
        light = {
            "choices": [choice._asdict() for choice in scene.choices],
            "omissions": scene.omissions,
        }
    else:
        floodlit, _ = read_floodlit(FolderStorage(folder))
        arrays = relit_of_captured(transport, floodlit)
    inputs_fingerprint = fingerprint(
        {"transport": acquired["digest"], "scene": scene, "code": code}
    )
    facts = {
        "stage": "relight",
        "transport": acquired["digest"],
        **{name: acquired[name] for name in ("scene", "method", "patterns", "options")},
        "names": list(relighting_patterns(transport.projector_shape)),
        "coaxial": scene.is_coaxial,
        "row": _middle_row(transport.camera_shape),
        "bytes": transport.nbytes,
        "levels": transport.level_rows,
        "units": RADIANCE_UNIT,
        "recorded": recorded,
        "light": light,
        **errors,
    }
    write_result(folder / "relight.json", inputs_fingerprint, arrays, facts)
