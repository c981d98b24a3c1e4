"""``rfpipe view``: an interactive page that relights a transport in any browser."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.transports import TransportPath, picture_of_rays

if TYPE_CHECKING:
    from rfpipe.transport import Transport
    from rfpipe.viewer import Comparison


def view(
    path: TransportPath,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", help="Page to write; default: SCENE_METHOD.html in this folder."
        ),
    ] = None,
    compare: Annotated[
        Path | None,
        typer.Option(
            metavar="PATH",
            help="A transport between the same rays, or an .exr picture of radiance of the "
            "camera's size, for comparison.",
        ),
    ] = None,
    title: Annotated[str | None, typer.Option(help="Heading of the page.")] = None,
    largest: Annotated[
        float,
        typer.Option(min=0, help="Limit in megabytes for including coarse levels."),
    ] = 30.0,
) -> None:
    """Write a page that relights the scene in any browser, offline and from a single file.

    Drag a spot, a bar or a brush over the scene, use a picture as light, click a pixel to see
    where its light comes from, step through the levels, or light the camera's side; see
    docs/viewer.md.

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
        content, facts = view_of(store, title, _comparison(compare, content.transport))
    names = [str(facts[name]) for name in ("scene", "method") if facts.get(name)]
    page = output or Path(f"{'_'.join(names) or Path(str(store)).stem}.html")
    written = write_view(content, page, round(largest * 1e6))
    levels = ", ".join(map(str, written.levels))
    typer.echo(f"{written.page}: {written.nbytes / 1e6:.1f} MB, levels {levels}")


def _comparison(path: Path, transport: Transport) -> Comparison:
    """Read a transport or a picture for comparison."""
    from rfpipe.transport.storage import find_transport
    from rfpipe.viewer import Comparison
    from rfpipe.viewer.stored import view_of

    if path.suffix == ".exr":
        return Comparison(picture_of_rays(str(path), path, transport.camera_shape), path.name)
    view_to_compare, _ = view_of(find_transport(path))
    return Comparison(view_to_compare.transport, view_to_compare.title)
