"""Writing a transport's page: one file, or a folder where it is large."""

from __future__ import annotations

import json
import math
from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rfpipe.blocks import RayDomain
from rfpipe.errors import InputError
from rfpipe.pictures.images import png_bytes, resized
from rfpipe.provenance import generator
from rfpipe.store.files import storage_errors, write_atomically
from rfpipe.transport.base import Transport
from rfpipe.viewer.lowering import lower
from rfpipe.viewer.program import Packed, pack_array, pack_program

LARGEST = 30 * 10**6
"""Bytes of data, as the page holds them, beyond which a folder is written."""

_SCRIPTS = ("light.js", "picture.js", "engine.js", "state.js", "controls.js", "app.js")
_TRIALS = 3
# A coaxial rig's pictures and dual pictures of the same light differ by less, of their norm.
_COAXIAL = 0.2
_BASE64 = 4 / 3
# Pixels of the preview: the text of the page takes as much, and both come in the first 100 kB.
_PREVIEW_SIDE = 112


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
    title, lead : str
        Its heading, and a sentence below it.
    about : sequence of (str, str)
        Facts that its foot lists.
    compared : Compared, optional
    """

    transport: Transport
    title: str
    lead: str = "Drag the light over the scene; what comes back is computed here, in the browser."
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
        Of all files.
    levels : list of int
        The levels that can be chosen.
    left_out : list of int
        Those for which one file had no room.
    is_folder : bool
    """

    page: Path
    nbytes: int
    levels: list[int]
    left_out: list[int] = field(default_factory=list)
    is_folder: bool = False


def write_view(view: View, output: Path, largest: int = LARGEST) -> Written:
    """Write a page that lights a transport, for any browser, without anything from elsewhere.

    Parameters
    ----------
    view : View
    output : Path
        The HTML file. Where the data would take more than `largest` bytes in it, a folder of that
        name without its suffix, to be put on any web server: ``index.html``, and the data by
        levels, which browsers read coarse first; the file then leads there.
    largest : int

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
    if output.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{output}: expected the name of a page, one that ends in .html")
    transport = view.transport
    program = lower(transport, transport.known_levels)
    beside = _compared(view)
    room = largest / _BASE64 - (beside.nbytes if beside else 0)
    chosen, whole = program.levels[-1:], pack_program(program.seen_at(program.levels[-1:]))
    is_folder = whole.nbytes > room
    for level in program.levels[:-1]:
        more = sorted([*chosen, level])
        packed = pack_program(program.seen_at(more))
        if packed.nbytes > room and not is_folder:
            break
        chosen, whole = more, packed
    held = {"levels": whole, **({"compared": beside} if beside else {})}
    page = output.with_suffix("") / "index.html" if is_folder else output
    written = 0
    if is_folder:
        written = sum(_write_files(page.parent, name, packed) for name, packed in held.items())
    light = beside.manifest if beside else {}
    manifest = {
        **whole.manifest,
        "white": white_of(transport),
        "coaxial": _is_coaxial(transport),
        "name": output.stem,
        "other": light if "operations" in light else None,
        "still": light if "operations" not in light and beside else None,
    }
    embedded = {
        f"{name[0]}{index}": b64encode(blob).decode()
        for name, packed in held.items()
        for index, blob in enumerate(packed.blobs if not is_folder else [])
    }
    text = _render(view, manifest, embedded).encode()
    _write(page, text)
    if is_folder:
        _write(output, _leading_to(page.relative_to(output.parent), view.title))
    left_out = [level for level in program.levels if level not in chosen]
    return Written(page, written + len(text), chosen, left_out, is_folder)


def _compared(view: View) -> Packed | None:
    """Return what the page holds of a transport or, as one array, of a picture to compare with."""
    if view.compared is None:
        return None
    transport, light = view.transport, view.compared.light
    if isinstance(light, Transport):
        own, other = (
            (each.camera_shape, each.projector_shape, each.channels) for each in (transport, light)
        )
        if own != other:
            raise InputError(
                f"{view.compared.name}: is between rays and channels {other} (camera, projector, "
                f"channels), the transport between {own}; compare transports of the same rig"
            )
        return pack_program(lower(light))
    shape = (*transport.camera_shape, transport.channels)
    picture = np.asarray(light, np.float32)
    if picture.shape == shape[:-1]:
        picture = np.broadcast_to(picture[..., None], shape)
    if picture.shape != shape:
        raise InputError(
            f"{view.compared.name}: is a picture of shape {picture.shape}, the camera's is "
            f"{shape}; resize the picture"
        )
    return Packed({"arrays": [{"level": 0}]}, [pack_array(np.moveaxis(picture, -1, 0))])


def white_of(transport: Transport) -> float:
    """Return the radiance that a page shows as white: all but 0.5 % of the floodlit picture."""
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    white = float(np.percentile(floodlit, 99.5))
    return white if white > 0 else float(floodlit.max()) or 1.0


def _is_coaxial(transport: Transport) -> bool:
    """Tell whether pictures and dual pictures of the same random light are alike."""
    if transport.camera_shape != transport.projector_shape:
        return False
    size = (_TRIALS, transport.channels, math.prod(transport.camera_shape))
    light = generator(0).standard_normal(size).astype(np.float32)
    channels = range(transport.channels)
    there, back = transport.forward(light, channels), transport.adjoint(light, channels)
    return bool(np.linalg.norm(there - back) <= _COAXIAL * np.linalg.norm(there))


def _leading_to(page: Path, title: str) -> bytes:
    """Return a page that leads to that of a folder."""
    from markupsafe import escape

    place = escape(page.as_posix())
    return (
        f'<!DOCTYPE html><html lang="en"><meta charset="utf-8"><title>{escape(title)}</title>'
        f'<meta http-equiv="refresh" content="0; url={place}"><p><a href="{place}">{escape(title)}'
        "</a></p></html>\n"
    ).encode()


def _write_files(folder: Path, name: str, packed: Packed) -> int:
    """Write a program's arrays, a file a level, and tell its manifest where they lie."""
    parts: dict[str, list[bytes]] = {}
    places: list[tuple[str, int, int]] = []
    for array, blob in zip(packed.manifest["arrays"], packed.blobs, strict=True):
        file = f"{name}/level_{array['level']:02d}.bin"
        held = parts.setdefault(file, [])
        places.append((file, sum(map(len, held)), len(blob)))
        held.append(blob)
    for file, held in parts.items():
        _write(folder / file, b"".join(held))
    for older in (folder / name).glob("level_*.bin"):
        if f"{name}/{older.name}" not in parts:
            older.unlink()
    packed.manifest["files"] = places
    return packed.nbytes


def _write(path: Path, content: bytes) -> None:
    with storage_errors(path, "write", len(content)):
        path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, content)


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
        lead=view.lead,
        about=view.about,
        compared=compared.name if compared else "nothing",
        has_views=RayDomain(view.transport.projector_shape).views > 1,
        connects="data:" if "files" not in manifest else "'self' data:",
        preview=Markup(_preview_of(view.transport, manifest["white"])),
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


def _preview_of(transport: Transport, white: float) -> str:
    """Return the first view under floodlight as a small picture in the page itself."""
    domain = RayDomain(transport.camera_shape)
    floodlit = transport.relight(np.ones(transport.projector_shape, np.float32))
    view = floodlit.reshape(domain.views, *domain.image_shape, transport.channels)[0]
    step = max(1.0, max(view.shape[:2]) / _PREVIEW_SIDE)
    height, width = (max(1, round(side / step)) for side in view.shape[:2])
    picture = png_bytes(resized(view, (height, width)), white)
    return f"data:image/png;base64,{b64encode(picture).decode()}"
