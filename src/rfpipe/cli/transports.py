"""``rfpipe info``, ``export`` and ``movie``: properties of a transport, and files made from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rfpipe.errors import InputError
from rfpipe.text import counted, percent

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rfpipe.store.places import Place
    from rfpipe.transport import Transport
    from rfpipe.transport.relightable import Relightable

TransportPath = Annotated[
    Path,
    typer.Argument(
        metavar="TRANSPORT",
        help="A transport.zarr in a run's results; or a folder, zip file or address (https://, "
        "s3://) that contains one.",
    ),
]
DualOption = Annotated[
    bool,
    typer.Option(
        "--dual",
        help="Exchange camera and projector: light from the camera, picture from the projector.",
    ),
]
Level = Annotated[
    int | None,
    typer.Option(
        min=0, help="Truncate the transport to this level, as if the acquisition had ended there."
    ),
]
White = Annotated[
    float | None, typer.Option(help="Radiance that becomes white; by default nearly the largest.")
]
ViewOption = Annotated[
    int | None, typer.Option(help="Number of a single view, from 0; by default all views.")
]
Form = Annotated[
    Literal["exr", "png"],
    typer.Option("--format", help="exr: radiance, float32; png: 8 bits, sRGB, for viewing."),
]

_GIB = 2**30
_SMALLEST_MOVIE = 360  # pixels of its shorter side


def info(path: TransportPath) -> None:
    """Print a transport's shape, channels, bytes and the statistics of its levels.

    For a folder with several transports, the error message lists their names.
    """
    transport = open_checked(path)
    rows, columns = map(math.prod, (transport.camera_shape, transport.projector_shape))
    dense = rows * columns * transport.channels * 4  # float32
    typer.echo(
        f"camera     {times(transport.camera_shape)} = {rows:,} rays\n"
        f"projector  {times(transport.projector_shape)} = {columns:,} rays\n"
        f"channels   {transport.channels}\n"
        f"bytes      {transport.nbytes:,} ({transport.nbytes / dense:.2%} of a dense matrix)\n"
    )
    levels = transport.levels
    is_used = levels.drop(columns="level", errors="ignore").fillna(0).any(axis=1)
    typer.echo(levels[is_used].to_string(index=False))


def open_checked(path: Path | Place) -> Transport:
    """Open a transport, or the only one in a folder, and check it against its manifest.

    Raises
    ------
    StoreError
        When a folder contains no transport or several.
    IntegrityError
        When the transport is damaged, or isn't the one of the manifest beside it.
    """
    from rfpipe.stages.relight import check_transport
    from rfpipe.transport.storage import find_transport, open_transport

    place = find_transport(path)
    if isinstance(place, Path):
        check_transport(place)
    return open_transport(place)


def times(shape: tuple[int, ...]) -> str:
    """Format a shape as ``62 x 70``."""
    return " x ".join(map(str, shape))


def export(
    path: TransportPath,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .npz, .h5, .hdf5 or .mat (MATLAB v7.3); .exr with a part for the "
            "picture of each projector ray, and an .lp file with the lights' directions next to "
            "it; with --photographs, a folder; with --relight, a folder or .ptm.",
        ),
    ],
    rows: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Camera rays to export, as NumPy indices: 31,35 is a pixel (row,column), 31,: a "
            "row, 10:20,30:40 a rectangle, ::8,::8 every eighth pixel in both directions, 2,31,35 "
            "a pixel of view 2. May be repeated.",
        ),
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(metavar="PLACE", help="Projector rays to export, as for --rows."),
    ] = None,
    joined: Annotated[
        int,
        typer.Option(
            "--coarser",
            min=1,
            help="Join blocks of rays of this side on both sides of the matrix: 4 makes it 256 "
            "times smaller. --rows and --columns then count joined rays. In .exr files, the camera "
            "keeps its resolution.",
        ),
    ] = 1,
    dual: DualOption = False,
    level: Level = None,
    limit_gib: Annotated[
        float, typer.Option(help="Largest size of the output before compression, in GiB.")
    ] = 8.0,
    photographs: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="TRAINING VALIDATION",
            help="Write these numbers of random patterns and their pictures instead, in the format "
            "of CompenNet.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the patterns of --photographs.")] = 0,
    form: Form = "png",
    normals: Annotated[
        bool,
        typer.Option(
            "--normals",
            help="Write surface normals instead, from photometric stereo with the lights of the "
            "transport: .exr with the parts normals, albedo and uncertainty (degrees), or .png "
            "with a normal map.",
        ),
    ] = False,
    relight: Annotated[
        bool,
        typer.Option(
            "--relight",
            help="Write a relightable image (RTI) of a dome instead: a folder for OpenLIME, or a "
            ".ptm file for RTIViewer.",
        ),
    ] = False,
) -> None:
    """Export the transport matrix T, or some rows and columns; photographs; normals; or an RTI.

    T has the shape (channels, camera rays, projector rays). It is written in parts, with little
    memory. docs/export.md shows how to read it in MATLAB, NumPy and other programs.
    """
    from rfpipe.export import write_lights, write_photographs
    from rfpipe.output import checked_output
    from rfpipe.transport import coarser
    from rfpipe.transport.matrix_export import write_matrix

    kinds = {"--normals": normals, "--relight": relight, "--photographs": photographs}
    chosen = [name for name, value in kinds.items() if value]
    if len(chosen) > 1:
        raise InputError(f"{' and '.join(chosen)} exclude each other; give one of them")
    option = "".join(f" {name}" for name in chosen)
    suffix = checked_output(f"export{option}", output)
    light, limit_bytes = opened(path, level=level), int(limit_gib * _GIB)
    joint = coarser(light, joined) if joined > 1 else light
    light, joint = (light.T, joint.T) if dual else (light, joint)
    camera_rays = _rays(rows, joint.camera_shape)
    projector_rays = _rays(columns, joint.projector_shape)
    is_exr = suffix == ".exr"
    if (is_exr and rows) or (photographs and (rows or columns)):
        raise InputError(
            "an .exr file needs all camera rays, and --photographs needs all rays; leave out "
            "--rows and, with --photographs, --columns"
        )
    if (normals or relight) and (rows or columns or dual or joined > 1):
        raise InputError(f"{option.strip()} needs all pixels and lights; leave out other options")
    if normals:
        _export_normals(light, output)
    elif relight:
        _export_relightable_image(light, output)
    elif photographs:
        white = write_photographs(joint, output, *photographs, seed=seed, form=form)
        typer.echo(f"{output}: {counted(sum(photographs), 'photograph')}, white is {white:.4g}")
    elif is_exr:
        count = write_lights(light, output, projector_rays, side=joined, limit_bytes=limit_bytes)
        typer.echo(f"{output}: {counted(count, 'light')} of {times(joint.projector_shape)}")
    else:
        write_matrix(joint, output, camera_rays, projector_rays, limit_bytes)
        typer.echo(f"{output}: T, {output.stat().st_size / 1e6:,.1f} MB")


def _export_normals(light: Relightable, output: Path) -> None:
    import numpy as np

    from rfpipe.export import write_normals

    surface = write_normals(light, output)
    degrees = np.median(surface.uncertainty[surface.mask]) if surface.mask.any() else np.nan
    typer.echo(
        f"{output}: normals of {surface.mask.mean():.0%} of the pixels, with a median "
        f"uncertainty of {degrees:.2g} degrees, assuming exact light directions"
    )


def _export_relightable_image(light: Relightable, output: Path) -> None:
    from rfpipe.export import write_relightable_image

    image = write_relightable_image(light, output)
    typer.echo(
        f"{output}: relightable image of {times(image.shape)} pixels, "
        f"{percent(image.error)}% off the pictures of the lights, white is {image.white:.4g}"
    )


def movie(
    path: TransportPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .mp4.")],
    along: Annotated[
        str,
        typer.Option(
            "--path",
            help="Movement of the light: across (a bar from left to right), down (a bar from top "
            "to bottom), circle (a disc), or views (all views of a light field in turn).",
        ),
    ] = "across",
    seconds: Annotated[float, typer.Option(help="Duration of the movie in seconds.")] = 6.0,
    fps: Annotated[float, typer.Option(help="Pictures per second.")] = 25.0,
    white: White = None,
    view: ViewOption = None,
    dual: DualOption = False,
    level: Level = None,
) -> None:
    """Write a movie of a light that moves over the scene, as mp4 (H.264).

    Needs PyAV, from the extra "export". Without --white, the scene is relit twice, the first time
    to find the largest radiance.
    """
    from rfpipe.export import relit_movie
    from rfpipe.output import checked_output

    checked_output("movie", output)
    light = opened(path, dual, level, view)
    enlarge = enlarged(light)
    count = round(seconds * fps) if 0 < seconds * fps < 1e6 else 0
    white_radiance = relit_movie(
        light, output, along, count, fps=fps, enlarge=enlarge, white=white, progress=True
    )
    typer.echo(f"{output}: {counted(count, 'picture')}, white is {white_radiance:.4g}")


def enlarged(light: Relightable) -> int:
    """Return the side of a camera ray in a movie, in pixels."""
    from rfpipe.blocks import RayDomain

    return -(-_SMALLEST_MOVIE // min(RayDomain(light.camera_shape).image_shape))


def opened(
    path: Path, dual: bool = False, level: int | None = None, view: int | None = None
) -> Relightable:
    """Open a transport; optionally truncate it, take its dual, and select a view."""
    import numpy as np

    from rfpipe.blocks import RayDomain
    from rfpipe.transport.regrouping import crop

    transport = open_checked(path)
    if level is not None:
        transport = transport.truncate(level)
    light: Relightable = transport.T if dual else transport
    if view is None:
        return light
    domain = RayDomain(light.camera_shape)
    if not domain.is_stack or not 0 <= view < domain.views:
        views = f"{domain.views} views, numbered from 0" if domain.is_stack else "one view"
        raise InputError(f"--view {view}: the transport has {views}; leave it out for all views")
    return crop(light, tuple(map(int, np.unravel_index(view, domain.views_shape))))


def _rays(places: Sequence[str] | None, shape: tuple[int, ...]) -> NDArray[np.int64] | None:
    """Return the rays at places without repetitions, in their order; None without places."""
    import numpy as np

    from rfpipe.export import rays_at

    if not places:
        return None
    rays = np.concatenate([rays_at(place, shape) for place in places])
    return rays[np.sort(np.unique(rays, return_index=True)[1])]


def picture_of_rays(name: str, path: Path, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Read a picture with a pixel per ray, several views one above the other.

    Returns
    -------
    ndarray
        (*shape) or (*shape, channels), float32.

    Raises
    ------
    InputError
        When the picture has another size.
    """
    from rfpipe.blocks import RayDomain
    from rfpipe.pictures.images import read_image

    picture, expected = read_image(path), RayDomain(shape).picture_shape
    if picture.shape[:2] != expected:
        raise InputError(
            f"{name}: is {times(picture.shape[:2])} pixels (height x width); expected "
            f"{times(expected)}, the shape of the rays, several views one above the other"
        )
    return picture.reshape(*shape, *picture.shape[2:])
