"""Commands on a transport: what it is, and forms that other programs read."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rfpipe.errors import InputError
from rfpipe.text import counted

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
        help="A transport.zarr that a run left in results/; or a folder, zip file or address "
        "(https://, s3://) that holds one.",
    ),
]
Dual = Annotated[bool, typer.Option("--dual", help="Light from the camera, see the projector.")]
Level = Annotated[
    int | None, typer.Option(min=0, help="Use the transport as known after this level only.")
]
White = Annotated[
    float | None, typer.Option(help="Radiance shown as white; by default nearly the brightest.")
]
View = Annotated[
    int | None, typer.Option(help="Of several views show this one, from 0; all without it.")
]
Form = Annotated[
    Literal["exr", "png"],
    typer.Option("--format", help="exr: radiance, float32; png: for the eye, 8 bits, sRGB."),
]

_GIB = 2**30
_SMALLEST_MOVIE = 360  # pixels of its shorter side


def info(path: TransportPath) -> None:
    """Show a transport's shape, channels, bytes and levels that showed or found something.

    Of a folder of several transports, show their names.
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
    told = levels.drop(columns="level", errors="ignore").fillna(0).any(axis=1)
    typer.echo(levels[told].to_string(index=False))


def open_checked(path: Path | Place) -> Transport:
    """Open a transport, or that in a folder, checked against the manifest beside it.

    Raises
    ------
    StoreError
        When it is a folder of several, or of none.
    IntegrityError
        When it is damaged, or another than the manifest's.
    """
    from rfpipe.stages.relight import check_transport
    from rfpipe.transport.storage import find_transport, open_transport

    place = find_transport(path)
    if isinstance(place, Path):
        check_transport(place)
    return open_transport(place)


def times(shape: tuple[int, ...]) -> str:
    """Show a shape, as in ``62 x 70``."""
    return " x ".join(map(str, shape))


def export(
    path: TransportPath,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="File to write: .npz, .h5, .hdf5 or .mat (MATLAB v7.3); .exr, in which each "
            "projector ray's picture is a part, with the lights' directions in an .lp beside it; "
            "or the folder of --photographs.",
        ),
    ],
    rows: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Camera rays, as numpy's indices: 31,35 is a pixel (row,column), 31,: a line, "
            "10:20,30:40 a rectangle, ::8,::8 every eighth, 2,31,35 one of view 2; may be "
            "repeated.",
        ),
    ] = None,
    columns: Annotated[
        list[str] | None,
        typer.Option(metavar="PLACE", help="Projector rays, likewise."),
    ] = None,
    joined: Annotated[
        int,
        typer.Option(
            "--coarser",
            min=1,
            help="Join so many rays down and across on both sides: 4 makes the matrix 256 times "
            "smaller. Places are those of joined rays. In .exr the camera keeps its rays.",
        ),
    ] = 1,
    dual: Dual = False,
    level: Level = None,
    limit_gib: Annotated[
        float, typer.Option(help="GiB that all of it may take before compression.")
    ] = 8.0,
    photographs: Annotated[
        tuple[int, int] | None,
        typer.Option(
            metavar="TRAINING VALIDATION",
            help="Write so many patterns and photographs, as CompenNet and its like read them.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of the patterns of --photographs.")] = 0,
    form: Form = "png",
    normals: Annotated[
        bool,
        typer.Option(
            "--normals",
            help="Write surface normals by photometric stereo instead, from one light at a time: "
            ".exr has the parts normals, albedo and uncertainty (degrees), .png a normal map.",
        ),
    ] = False,
) -> None:
    """Write the transport matrix T, or some of its rows and columns; photographs; or normals.

    T is (channels, camera rays, projector rays), written part by part, in little memory.
    docs/export.md tells how MATLAB, numpy and others read it.
    """
    import numpy as np

    from rfpipe.export import write_lights, write_normals, write_photographs
    from rfpipe.output import checked_output
    from rfpipe.transport import coarser
    from rfpipe.transport.matrix_export import write_matrix

    option = " --normals" if normals else " --photographs" if photographs else ""
    suffix = checked_output(f"export{option}", output)
    light, limit_bytes = opened(path, level=level), int(limit_gib * _GIB)
    joint = coarser(light, joined) if joined > 1 else light
    light, joint = (light.T, joint.T) if dual else (light, joint)
    seen, lit = _rays(rows, joint.camera_shape), _rays(columns, joint.projector_shape)
    is_exr = suffix == ".exr"
    if (is_exr and rows) or (photographs and (rows or columns)):
        raise InputError("pictures are of all camera rays, photographs under all projector rays")
    if normals:
        if photographs or rows or columns or dual or joined > 1:
            raise InputError("--normals are of all pixels and lights; leave the other options out")
        surface = write_normals(light, output)
        off = np.median(surface.uncertainty[surface.mask]) if surface.mask.any() else np.nan
        typer.echo(
            f"{output}: normals of {surface.mask.mean():.0%} of the pixels, uncertain by {off:.2g} "
            "degrees in the median, without errors of the lights' directions"
        )
    elif photographs:
        white = write_photographs(joint, output, *photographs, seed=seed, form=form)
        typer.echo(f"{output}: {counted(sum(photographs), 'photograph')}, white is {white:.4g}")
    elif is_exr:
        count = write_lights(light, output, lit, side=joined, limit_bytes=limit_bytes)
        typer.echo(f"{output}: {counted(count, 'light')} of {times(joint.projector_shape)}")
    else:
        write_matrix(joint, output, seen, lit, limit_bytes)
        typer.echo(f"{output}: T, {output.stat().st_size / 1e6:,.1f} MB")


def movie(
    path: TransportPath,
    output: Annotated[Path, typer.Option("--output", "-o", help="File to write: .mp4.")],
    along: Annotated[
        str,
        typer.Option(
            "--path",
            help="How the light moves: across (a bar from left to right), down, circle (a disc) or "
            "views (of a light field).",
        ),
    ] = "across",
    seconds: Annotated[float, typer.Option(help="How long the movie is.")] = 6.0,
    fps: Annotated[float, typer.Option(help="Pictures a second.")] = 25.0,
    white: White = None,
    view: View = None,
    dual: Dual = False,
    level: Level = None,
) -> None:
    """Write a movie of a light that moves over the scene, in mp4 (H.264).

    Needs PyAV, which the extra "export" has. Without --white all is relit twice, first to find it.
    """
    from rfpipe.export import relit_movie
    from rfpipe.output import checked_output

    checked_output("movie", output)
    light = opened(path, dual, level, view)
    enlarge = enlarged(light)
    count = round(seconds * fps) if 0 < seconds * fps < 1e6 else 0
    used = relit_movie(
        light, output, along, count, fps=fps, enlarge=enlarge, white=white, progress=True
    )
    typer.echo(f"{output}: {counted(count, 'picture')}, white is {used:.4g}")


def enlarged(light: Relightable) -> int:
    """Return how many pixels down and across a camera ray has in a movie."""
    from rfpipe.blocks import RayDomain

    return -(-_SMALLEST_MOVIE // min(RayDomain(light.camera_shape).image_shape))


def opened(
    path: Path, dual: bool = False, level: int | None = None, view: int | None = None
) -> Relightable:
    """Open a transport, or its dual, as known after a level, to one view of several."""
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
        has = f"has {domain.views} views, from 0" if domain.is_stack else "has one view"
        raise InputError(f"--view {view}: the transport {has}; leave it out for all")
    return crop(light, tuple(map(int, np.unravel_index(view, domain.views_shape))))


def _rays(places: Sequence[str] | None, shape: tuple[int, ...]) -> NDArray[np.int64] | None:
    """Return the rays at some places, each once, or None where none are named."""
    import numpy as np

    from rfpipe.export import rays_at

    if not places:
        return None
    rays = np.concatenate([rays_at(place, shape) for place in places])
    return rays[np.sort(np.unique(rays, return_index=True)[1])]


def picture_of_rays(name: str, path: Path, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Read a picture of rays, several views one above the other: (*shape) or (*shape, channels).

    Raises
    ------
    InputError
        When it has another size.
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
