"""Writing the page of a transport as a single HTML file."""

from __future__ import annotations

import json
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.output import OUTPUTS, suffix_of, write_atomically
from rfpipe.transport.base import Transport
from rfpipe.transport.filling import looks_coaxial
from rfpipe.viewer.lowering import lower
from rfpipe.viewer.program import Packed, Program, pack_array, pack_program

MAX_BYTES = 30 * 10**6
"""Default limit of data in a page, in bytes, for including coarse levels."""

_SCRIPTS = ("light.js", "picture.js", "engine.js", "state.js", "controls.js", "app.js")
_BASE64 = 4 / 3


@dataclass(frozen=True)
class Comparison:
    """A transport or picture for comparison with a view's transport.

    Attributes
    ----------
    light : Transport or ndarray
        A transport between the same rays, or a picture ``(*camera_shape[, channels])`` of radiance
        under any light.
    name : str
    """

    light: Transport | NDArray[Any]
    name: str


@dataclass(frozen=True)
class PageContent:
    """Content of a page.

    Attributes
    ----------
    transport : Transport
    title : str
        Heading of the page.
    facts : sequence of (str, str)
        Names and values in the footer.
    comparison : Comparison, optional
    """

    transport: Transport
    title: str
    facts: Sequence[tuple[str, str]] = ()
    comparison: Comparison | None = None


@dataclass(frozen=True)
class WrittenPage:
    """Path and size of a written page, and the levels that can be selected in it."""

    page: Path
    nbytes: int
    levels: list[int]


def write_view(view: PageContent, output: Path, max_bytes: int = MAX_BYTES) -> WrittenPage:
    """Write a self-contained page that relights a transport in any browser.

    Parameters
    ----------
    view : PageContent
    output : Path
        The HTML file.
    max_bytes : int
        Limit of data in bytes; the page includes as many coarse levels as fit, and always the last.

    Returns
    -------
    WrittenPage

    Raises
    ------
    InputError
        If the comparison has different rays or channels, or the name doesn't end in .html.
    StoreError
        If the page can't be written.
    """
    suffix_of(output, OUTPUTS["view"])
    transport = view.transport
    comparison = None if view.comparison is None else _pack_comparison(transport, view.comparison)
    limit = max_bytes / _BASE64 - (comparison.nbytes if comparison else 0)
    levels, packed = _pack_levels(lower(transport, transport.known_levels), limit)
    light = comparison.manifest if comparison else {}
    manifest = {
        **packed.manifest,
        "white": _white_of(transport),
        "coaxial": looks_coaxial(transport),
        "name": output.stem,
        "other": light if "operations" in light else None,
        "still": light if "operations" not in light and comparison else None,
    }
    embedded = {"l": packed, **({"c": comparison} if comparison else {})}
    blobs = {
        f"{name}{index}": b64encode(blob).decode()
        for name, data in embedded.items()
        for index, blob in enumerate(data.blobs)
    }
    text = _render(view, manifest, blobs).encode()
    write_atomically(output, text, resumes=False)
    return WrittenPage(output, len(text), levels)


def _pack_levels(program: Program, max_bytes: float) -> tuple[list[int], Packed]:
    """Pack the last level, and as many of the coarsest levels as fit."""
    blobs: dict[str, bytes] = {}
    levels = program.levels[-1:]
    packed = pack_program(program.restricted_to(levels), blobs)
    for level in program.levels[:-1]:
        more = sorted([*levels, level])
        larger = pack_program(program.restricted_to(more), blobs)
        if larger.nbytes > max_bytes:
            break
        levels, packed = more, larger
    return levels, packed


def _pack_comparison(transport: Transport, comparison: Comparison) -> Packed:
    """Pack a transport for comparison, or a picture as a single array."""
    light = comparison.light
    if isinstance(light, Transport):
        expected, actual = (
            (item.camera_shape, item.projector_shape, item.channels) for item in (transport, light)
        )
        if expected != actual:
            raise InputError(
                f"{comparison.name}: has camera, projector and channels {actual}, the transport "
                f"has {expected}; compare transports of the same rig"
            )
        return pack_program(lower(light))
    shape = (*transport.camera_shape, transport.channels)
    try:
        picture = np.broadcast_to(np.asarray(light, np.float32).reshape(*shape[:-1], -1), shape)
    except ValueError as error:
        raise InputError(
            f"{comparison.name}: isn't a picture of shape {shape}: {error}; compare a picture of "
            "the camera's size"
        ) from error
    return Packed({"arrays": [{"level": 0}]}, [pack_array(np.moveaxis(picture, -1, 0))])


def _white_of(transport: Transport) -> float:
    """Radiance displayed as white: the 99.5th percentile of the floodlit image."""
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    white = float(np.percentile(floodlit, 99.5))
    return white if white > 0 else float(floodlit.max()) or 1.0


def _render(view: PageContent, manifest: dict[str, Any], blobs: dict[str, str]) -> str:
    """Render the page as HTML."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    web = files("rfpipe.viewer").joinpath("web")

    def source(*names: str) -> str:
        return "\n".join(web.joinpath(name).read_text(encoding="utf-8") for name in names)

    kernel = files("rfpipe.viewer").joinpath("kernel/kernels.wasm").read_bytes()
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    return environment.from_string(source("page.html.j2")).render(
        title=view.title,
        facts=view.facts,
        comparison=view.comparison.name if view.comparison else "nothing",
        has_views=RayDomain(view.transport.projector_shape).views > 1,
        style=Markup(source("style.css")),
        script=Markup(source(*_SCRIPTS)),
        worker=_in_script(source("kernels.js", "worker.js")),
        manifest=_in_script(manifest),
        kernel=b64encode(kernel).decode(),
        blobs=blobs.items(),
    )


def _in_script(value: Any) -> Any:
    """Encode data as JavaScript for embedding in HTML."""
    from markupsafe import Markup

    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True)
    return Markup(text.replace("<", "\\u003c"))
