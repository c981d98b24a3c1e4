"""`rfpipe view`: a transport as a page that any browser opens."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.transports import TransportPath, picture_of_rays

if TYPE_CHECKING:
    from rfpipe.transport import Transport
    from rfpipe.viewer import Compared


def view(
    path: TransportPath,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Page to write; by default SCENE_METHOD.html, here."),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="Another transport of the same rays, or a picture of the camera's size, an .exr "
            "of radiance, to wipe to.",
        ),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Heading of the page.")] = None,
    largest: Annotated[
        float,
        typer.Option(min=0, help="Megabytes up to which it has the coarse levels, too."),
    ] = 30.0,
) -> None:
    """Write a page that lights the scene in any browser: offline, from one file, no server.

    Drag a spot, a bar or a brush over the scene, take a picture as light, click a pixel to see
    where its light comes from, go through the levels, light the camera's side; docs/viewer.md has
    all of it.

    For example: rfpipe view results/planes_iv/symmetric -o scene.html
    """
    from rfpipe.output import checked_output
    from rfpipe.transport.storage import find_transport
    from rfpipe.viewer import write_view
    from rfpipe.viewer.stored import view_of

    if output is not None:
        checked_output("view", output)
    store = find_transport(path)
    content, facts = view_of(store, title)
    if compare is not None:
        content, facts = view_of(store, title, _compared(compare, content.transport))
    names = [str(facts[name]) for name in ("scene", "method") if facts.get(name)]
    page = output or Path(f"{'_'.join(names) or Path(str(store)).stem}.html")
    written = write_view(content, page, round(largest * 1e6))
    levels = ", ".join(map(str, written.levels))
    typer.echo(f"{written.page}: {written.nbytes / 1e6:.1f} MB, levels {levels}")


def _compared(path: Path, transport: Transport) -> Compared:
    """Read what to compare with: a transport, or a picture."""
    from rfpipe.transport.storage import find_transport
    from rfpipe.viewer import Compared
    from rfpipe.viewer.stored import view_of

    if path.suffix == ".exr":
        return Compared(picture_of_rays(str(path), path, transport.camera_shape), path.name)
    other, _ = view_of(find_transport(path))
    return Compared(other.transport, other.title)
