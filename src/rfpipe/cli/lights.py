"""``rfpipe lights``: directions of lights from pictures of a chrome ball."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from rfpipe.lights.chrome_ball import Ball


def lights(
    folder: Annotated[
        Path,
        typer.Argument(metavar="FOLDER", help="Pictures of a chrome ball, each under one light."),
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .lp.")],
    ball: Annotated[
        str | None,
        typer.Option(
            metavar="ROW,COLUMN,RADIUS",
            help="Circle of the ball in pixels, from the top left corner. By default, it is the "
            "circle of the mask that lies beside the pictures, such as chrome.mask.png.",
        ),
    ] = None,
) -> None:
    """Find the directions of lights by their highlights on a chrome ball, and write an .lp file.

    The ball may lie beside the object in its pictures, or have pictures of its own under the same
    lights. Lights and camera must be far away, compared with ball and object. 'rfpipe fit' reads
    the .lp file in the folder of the object's pictures.
    """
    from rfpipe.errors import InputError
    from rfpipe.fitting.names import sort_pictures
    from rfpipe.light_files import write_directions
    from rfpipe.lights.chrome_ball import light_of_ball
    from rfpipe.output import checked_output
    from rfpipe.pictures import picture_files
    from rfpipe.pictures.images import read_image
    from rfpipe.text import counted

    checked_output("lights", output)
    files = sort_pictures(picture_files(folder, (".jpeg", ".jpg")))
    circle = _circle(ball, folder, files.mask)
    directions = []
    for file in files.pictures:
        try:
            direction, second = light_of_ball(read_image(file), circle)
        except InputError as error:
            raise InputError(f"{file}: {error}") from None
        directions.append(direction)
        if second is not None:
            x, y, z = second
            typer.echo(
                f"note: {file}: has a second highlight, of light from {x:.2f} {y:.2f} {z:.2f}; "
                "the brightest is taken",
                err=True,
            )
    write_directions(output, [file.name for file in files.pictures], directions)
    row, column, radius = circle
    typer.echo(
        f"{output}: {counted(len(directions), 'light')}, from the ball at row {row:.1f}, column "
        f"{column:.1f} with radius {radius:.1f}"
    )


def _circle(ball: str | None, folder: Path, mask: Path | None) -> Ball:
    """Return the circle of the ball, by the option or the mask in the folder."""
    from rfpipe.errors import InputError
    from rfpipe.lights.chrome_ball import Ball, ball_of_mask
    from rfpipe.pictures.images import read_image

    if ball is not None:
        try:
            return Ball(*map(float, ball.split(",")))
        except (TypeError, ValueError):
            raise InputError(
                f"--ball {ball}: expected three numbers, ROW,COLUMN,RADIUS, such as 410,633.5,52"
            ) from None
    if mask is None:
        raise InputError(f"{folder}: has no mask of the ball; give --ball ROW,COLUMN,RADIUS")
    picture = read_image(mask)
    return ball_of_mask((picture if picture.ndim == 2 else picture.max(axis=-1)) > 0.5)
