"""Writing a transport's page, one file."""

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
from rfpipe.viewer.program import Packed, pack_array, pack_program

LARGEST = 30 * 10**6
"""Bytes of data, as the page holds them, up to which it has other levels than the last."""

_SCRIPTS = ("light.js", "picture.js", "engine.js", "state.js", "controls.js", "app.js")
_BASE64 = 4 / 3


@dataclass(frozen=True)
class Compared:
    """What a transport is compared with.

    Attributes
    ----------
    light : Transport or ndarray
        Another transport between the same rays; or a picture ``(*camera_shape[, channels])`` in the
        transport's radiance, under whatever light it was taken.
    name : str
        What it is called.
    """

    light: Transport | NDArray[Any]
    name: str


@dataclass(frozen=True)
class View:
    """What a page shows.

    Attributes
    ----------
    transport : Transport
    title : str
        Its heading.
    about : sequence of (str, str)
        Facts that its foot lists.
    compared : Compared, optional
    """

    transport: Transport
    title: str
    about: Sequence[tuple[str, str]] = ()
    compared: Compared | None = None


@dataclass(frozen=True)
class Written:
    """What was written.

    Attributes
    ----------
    page : Path
        The file to open.
    nbytes : int
    levels : list of int
        The levels that can be chosen.
    """

    page: Path
    nbytes: int
    levels: list[int]


def write_view(view: View, output: Path, largest: int = LARGEST) -> Written:
    """Write a page that lights a transport, for any browser, without anything from elsewhere.

    Parameters
    ----------
    view : View
    output : Path
        The HTML file.
    largest : int
        Bytes of data up to which it has the coarse levels, too, as many as fit beside the last.

    Returns
    -------
    Written

    Raises
    ------
    InputError
        If what it is compared with has other rays or channels, or the name doesn't end in .html.
    StoreError
        If it can't be written.
    """
    suffix_of(output, OUTPUTS["view"])
    transport = view.transport
    program = lower(transport, transport.known_levels)
    beside = _compared(view)
    room = largest / _BASE64 - (beside.nbytes if beside else 0)
    chosen, whole = program.levels[-1:], pack_program(program.seen_at(program.levels[-1:]))
    for level in program.levels[:-1]:
        more = sorted([*chosen, level])
        packed = pack_program(program.seen_at(more))
        if packed.nbytes > room:
            break
        chosen, whole = more, packed
    light = beside.manifest if beside else {}
    manifest = {
        **whole.manifest,
        "white": _white_of(transport),
        "coaxial": looks_coaxial(transport),
        "name": output.stem,
        "other": light if "operations" in light else None,
        "still": light if "operations" not in light and beside else None,
    }
    held = {"l": whole, **({"c": beside} if beside else {})}
    embedded = {
        f"{name}{index}": b64encode(blob).decode()
        for name, packed in held.items()
        for index, blob in enumerate(packed.blobs)
    }
    text = _render(view, manifest, embedded).encode()
    write_atomically(output, text, resumes=False)
    return Written(output, len(text), chosen)


def _compared(view: View) -> Packed | None:
    """Return what the page holds of a transport or, as one array, of a picture to compare with."""
    if view.compared is None:
        return None
    transport, light = view.transport, view.compared.light
    if isinstance(light, Transport):
        expected, actual = (
            (each.camera_shape, each.projector_shape, each.channels) for each in (transport, light)
        )
        if expected != actual:
            raise InputError(
                f"{view.compared.name}: is between rays and channels {actual} (camera, projector, "
                f"channels), the transport between {expected}; compare transports of the same rig"
            )
        return pack_program(lower(light))
    shape = (*transport.camera_shape, transport.channels)
    try:
        picture = np.broadcast_to(np.asarray(light, np.float32).reshape(*shape[:-1], -1), shape)
    except ValueError as error:
        raise InputError(f"{view.compared.name}: is no picture of {shape}: {error}") from error
    return Packed({"arrays": [{"level": 0}]}, [pack_array(np.moveaxis(picture, -1, 0))])


def _white_of(transport: Transport) -> float:
    """Return the radiance that a page shows as white: all but 0.5 % of the floodlit picture."""
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    white = float(np.percentile(floodlit, 99.5))
    return white if white > 0 else float(floodlit.max()) or 1.0


def _render(view: View, manifest: dict[str, Any], embedded: dict[str, str]) -> str:
    """Return the page's text."""
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup

    web = files("rfpipe.viewer").joinpath("web")

    def source(*names: str) -> str:
        return "\n".join(web.joinpath(name).read_text(encoding="utf-8") for name in names)

    kernel = files("rfpipe.viewer").joinpath("kernel/kernels.wasm").read_bytes()
    environment = Environment(autoescape=True, undefined=StrictUndefined, trim_blocks=True)
    compared = view.compared
    return environment.from_string(source("page.html.j2")).render(
        title=view.title,
        about=view.about,
        compared=compared.name if compared else "nothing",
        has_views=RayDomain(view.transport.projector_shape).views > 1,
        style=Markup(source("style.css")),
        script=Markup(source(*_SCRIPTS)),
        worker=_in_script(source("kernels.js", "worker.js")),
        manifest=_in_script(manifest),
        kernel=b64encode(kernel).decode(),
        blobs=embedded.items(),
    )


def _in_script(value: Any) -> Any:
    """Return data as JavaScript that can stand in a page."""
    from markupsafe import Markup

    text = json.dumps(value, separators=(",", ":"), ensure_ascii=True)
    return Markup(text.replace("<", "\\u003c"))
