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
            help="Folder with the pictures, directly or in 'pictures', and the patterns, as image "
            "files in 'patterns' or as an array (pictures, H, W[, 3]) in patterns.npy. A folder "
            "with pictures in cam/raw/train and cam/raw/test and patterns in train and test is "
            "read as well, and so is an EXR file with a part for each light.",
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="Transport to write, such as transport.zarr.")
    ],
    lights: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="ROWS COLUMNS",
            help="For one light at a time (OLAT) instead of patterns: rows and columns of the "
            "array of lights; 1 N for a light stage. Not needed if FOLDER has a file with the "
            "lights' directions or positions: an .lp file of RTI, light_directions.txt, "
            "lights.txt, light_pos.npy or lights.npy.",
        ),
    ] = None,
    patterns: Annotated[
        str | None,
        typer.Option(
            metavar="CODE",
            help="Code that the projector displayed, such as gray:1920x1080 (OpenCV's Gray code) "
            "or phase:1920x1080,period=32,steps=4; docs/photographs.md lists all options.",
        ),
    ] = None,
    settings: Annotated[
        Path | None,
        typer.Option(
            help="Settings file of a run whose section camera describes the camera. The brackets "
            "are then merged, and the noise is known. By default, there is one picture per "
            "pattern, with values proportional to light."
        ),
    ] = None,
    black: Annotated[
        Path | None,
        typer.Option(help="Picture without light, to be subtracted; or a folder of several."),
    ] = None,
    ambient: Annotated[
        Path | None, typer.Option(help="Picture of the ambient light, to be subtracted as well.")
    ] = None,
    flat_field: Annotated[
        Path | None,
        typer.Option(
            help="Folder with pictures of a matt white card in the object's place, one under each "
            "light of a dome, by which uneven light is divided out."
        ),
    ] = None,
    transfer: Annotated[
        Literal["linear", "srgb"] | None,
        typer.Option(
            help="Transfer curve of integer pictures; by default linear, or srgb in cam/raw."
        ),
    ] = None,
    camera_bin: Annotated[
        int | None,
        typer.Option(min=1, help="Average pictures over squares of this side in pixels."),
    ] = None,
    projector_bin: Annotated[
        int | None,
        typer.Option(min=1, help="Average patterns over squares of this side in pixels."),
    ] = None,
    memory_gib: Annotated[
        float,
        typer.Option(
            min=0.1, help="Memory that the fit may use, in GiB; the bins are chosen accordingly."
        ),
    ] = 2.0,
    coaxial: Annotated[
        bool, typer.Option("--coaxial", help="Camera and projector share their rays.")
    ] = False,
    anyway: Annotated[
        bool,
        typer.Option("--anyway", help="Write the transport even if the pictures contradict it."),
    ] = False,
) -> None:
    """Fit the light transport to existing pictures of known patterns.

    Any patterns will do: one light at a time, Gray code, Hadamard, random and so on, given as
    weights of the projector's light. The models are least squares, footprints with smooth light,
    and, for a coaxial rig, near/far. Each model is fitted without some held-out pictures; the
    model that predicts these best is then fitted to all pictures. Its error is the error in the
    held-out pictures, or in the validation pictures if there are any. Coloured patterns are fitted
    per channel.

    Nothing is written if the pictures contradict each other, or if the mean picture predicts the
    held-out pictures as well as the best model. Open the transport in Python with
    rfpipe.open_transport, or relight it with 'rfpipe relight'.
    """
    from rfpipe.config import load_camera
    from rfpipe.errors import InputError
    from rfpipe.fitting import fit_transport, flat_fielded, read_series
    from rfpipe.jobs.job import Progress
    from rfpipe.output import checked_output
    from rfpipe.photometry import CameraModel, sensor_from_config
    from rfpipe.steps import displayed_by
    from rfpipe.text import counted, percent
    from rfpipe.transport import save_transport

    checked_output("fit", output)
    if patterns and lights:
        raise InputError("--patterns and --lights exclude each other; give one of them")
    camera = None
    if settings is not None:
        sensor = sensor_from_config(load_camera(settings))
        if not isinstance(sensor, CameraModel):
            raise InputError(
                "the section camera is null", place=settings, remedy="leave --settings out"
            )
        camera = sensor
    series = read_series(
        folder, lights=lights, patterns=patterns, camera=camera, black=black, ambient=ambient,
        transfer=transfer, camera_bin=camera_bin, projector_bin=projector_bin,
        memory_gib=memory_gib, progress=True,
    )  # fmt: skip
    if flat_field is not None:
        card = read_series(
            flat_field, lights=(1, len(series.patterns)), camera=camera, black=black,
            ambient=ambient, transfer=transfer, camera_bin=camera_bin or 1, progress=True,
        )  # fmt: skip
        series = flat_fielded(series, card)
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
        typer.echo(
            "the error is unknown, since the fit needs every picture; take a few more patterns"
        )
        return
    typer.echo(f"error in {result.held_out} held-out pictures: {percent(result.error)}%")
    rivals = {name: error for name, error in result.errors.items() if name != result.model}
    if rivals:
        typer.echo("; ".join(f"by {name} {percent(error)}%" for name, error in rivals.items()))
