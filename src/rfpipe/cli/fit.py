"""``rfpipe fit``: light transport from a folder of pictures and their patterns."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

import typer


def fit(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="FOLDER",
            help="Pictures in its folder 'pictures' or in itself, patterns as pictures in its "
            "folder 'patterns' or in patterns.npy, (pictures, H, W[, 3]); or in cam/raw/train and "
            "test, patterns in train and test. Or an EXR file with a part for each light.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="The transport to write, such as transport.zarr.")
    ],
    lights: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="ROWS COLUMNS",
            help="One light at a time instead of patterns, OLAT: how the lights stand; 1 N for a "
            "light stage. Needless where a file of their directions or positions lies in FOLDER: "
            "any .lp of RTI, light_directions.txt, lights.txt, light_pos.npy or lights.npy.",
        ),
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(
            metavar="CODE",
            help="Name of the code that the pictures show, such as gray:1920x1080 (OpenCV's Gray "
            "code) or phase:1920x1080,period=32,steps=4; docs/photographs.md has all options.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="A run's settings whose camera took the pictures: their brackets are merged, and "
            "their noise is known. Without it, pictures are light, one for each pattern."
        ),
    ] = None,
    black: Annotated[
        Path | None, typer.Option(help="A picture without light to subtract, or a folder of some.")
    ] = None,
    ambient: Annotated[
        Path | None, typer.Option(help="A picture of the room's light alone, to subtract as well.")
    ] = None,
    transfer: Annotated[
        Literal["linear", "srgb"] | None,
        typer.Option(
            help="Transfer curve of integers in pictures; by default linear, beside cam/raw srgb."
        ),
    ] = None,
    camera_bin: Annotated[
        int | None,
        typer.Option(min=1, help="Average pictures over squares of so many pixels a side."),
    ] = None,
    projector_bin: Annotated[
        int | None,
        typer.Option(min=1, help="Average patterns over squares of so many pixels a side."),
    ] = None,
    memory_gib: Annotated[
        float,
        typer.Option(min=0.1, help="Memory that the fit may take; bins are chosen accordingly."),
    ] = 2.0,
    coaxial: Annotated[
        bool, typer.Option("--coaxial", help="Camera and projector share their rays.")
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write a transport that is worth nothing, too.")
    ] = False,
) -> None:
    """Fit the light transport to pictures of patterns that were chosen elsewhere.

    Patterns may be one light at a time, Gray code, Hadamard, random or any others, as weights of
    light. Models are least squares, footprints with smooth light, and, on a coaxial rig, near/far;
    the one that predicts left-out pictures best fits all of them. Its error is that of these
    pictures, or of those that are there for validation. Coloured patterns light each channel by
    itself. Nothing is written where pictures contradict each other, or where left-out ones are
    predicted no better than by the mean picture. The transport opens in Python by
    rfpipe.open_transport, and relights by 'rfpipe relight'.
    """
    from rfpipe.config import load_camera
    from rfpipe.errors import InputError
    from rfpipe.fitting import fit_transport, read_series
    from rfpipe.jobs.job import Progress
    from rfpipe.output import checked_output
    from rfpipe.photometry import CameraModel, sensor_from_config
    from rfpipe.steps import displayed_by
    from rfpipe.text import counted, percent
    from rfpipe.transport import save_transport

    checked_output("fit", output)
    if patterns and lights:
        raise InputError("--patterns and --lights: give the one that the pictures show")
    camera = None
    if settings is not None:
        sensor = sensor_from_config(load_camera(settings))
        if not isinstance(sensor, CameraModel):
            raise InputError(f"{settings}: camera is null; without --settings pictures are light")
        camera = sensor
    series = read_series(
        folder, lights=lights, patterns=patterns, camera=camera, black=black, ambient=ambient,
        transfer=transfer, camera_bin=camera_bin, projector_bin=projector_bin,
        memory_gib=memory_gib, progress=True,
    )  # fmt: skip
    for note in series.notes:
        typer.echo(f"note: {note}", err=True)
    with displayed_by(partial(Progress, unit="step")):
        result = fit_transport(series, coaxial=coaxial, anyway=anyway, memory_gib=memory_gib)
    for note in result.notes[len(series.notes) :]:
        typer.echo(f"note: {note}", err=True)
    save_transport(result.transport, output, scene=folder.name, method="fit")
    training = series.training
    count, *_, rays = training.patterns.shape
    typer.echo(
        f"{output}: {counted(count, 'picture')} of {counted(rays, 'projector ray')} "
        f"({'complete' if result.complete else f'{training.rank} independent'}), by {result.model}"
        f"{'' if series.lights is None else ', with the directions of lights'}"
    )
    if result.error is None:
        typer.echo("no error is known: each pattern is needed. A few more patterns would tell")
        return
    typer.echo(f"left-out pictures ({result.held_out}) are off by {percent(result.error)}%")
    others = {name: error for name, error in result.errors.items() if name != result.model}
    if others:
        typer.echo("; ".join(f"by {name} {percent(error)}%" for name, error in others.items()))
