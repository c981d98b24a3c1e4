"""``rfpipe fit``: light transport from a folder of pictures and their patterns."""

from __future__ import annotations

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
            "any .lp of RTI, light_directions.txt, light_pos.npy or lights.npy.",
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
    transfer: Annotated[
        Literal["linear", "srgb"] | None,
        typer.Option(
            help="What integers in pictures stand for; by default linear, beside cam/raw srgb."
        ),
    ] = None,
    coaxial: Annotated[
        bool, typer.Option("--coaxial", help="Camera and projector share their rays.")
    ] = False,
    anyway: Annotated[
        bool, typer.Option("--anyway", help="Write a transport that is worth nothing, too.")
    ] = False,
) -> None:
    """Find the light transport behind pictures of patterns that were chosen elsewhere.

    Patterns may be one light at a time, Hadamard, random or any others, as weights of light.
    Where they tell of each projector ray by itself, the transport follows directly; where they are
    few, from what is most probable, on a coaxial rig by the model of near_far. Coloured patterns
    light each channel by itself. How far it is off is told by pictures that are left out, or are
    there for validation. Nothing is written where pictures contradict the
    others, or the patterns are too few to tell much more than their mean. The transport opens in
    Python by rfpipe.open_transport, and relights by 'rfpipe relight'.
    """
    from rfpipe.config import load_config
    from rfpipe.errors import InputError
    from rfpipe.fitting import fit_transport, read_series
    from rfpipe.photometry import CameraModel, sensor_from_config
    from rfpipe.transport import save_transport

    camera = None
    if settings is not None:
        sensor = sensor_from_config(load_config(settings).camera)
        if not isinstance(sensor, CameraModel):
            raise InputError(f"{settings}: camera is null; without --settings pictures are light")
        camera = sensor
    series = read_series(folder, lights=lights, camera=camera, black=black, transfer=transfer)
    result = fit_transport(series, coaxial=coaxial, anyway=anyway)
    save_transport(result.transport, output, scene=folder.name, method="fit")
    training = series.training
    count, *_, rays = training.patterns.shape
    typer.echo(
        f"{output}: {count} pictures of {rays} projector rays "
        f"({'complete' if result.complete else f'{training.rank} independent'}), by {result.model}"
        f"{'' if series.lights is None else ', with the directions of lights'}"
    )
    typer.echo(
        "no error is known: each pattern is needed. A few more patterns would tell"
        if result.error is None
        else f"left-out pictures ({result.held_out}) are off by {result.error:.2%}"
    )
