"""``rfpipe export``: a transport in forms that other programs read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from rfpipe.cli.parallel import WorkersOption, resources_of
from rfpipe.config.addresses import THREADS
from rfpipe.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rfpipe.transport.base import Light

__all__ = ["app"]

app = typer.Typer(
    help="Write a transport for other programs: its matrix (npz, HDF5, MATLAB), pictures of rays, "
    "relit pictures, movies.",
    no_args_is_help=True,
)

TransportPath = Annotated[
    Path, typer.Argument(metavar="TRANSPORT", help="A transport.zarr that a run left in results/.")
]
Dual = Annotated[
    bool, typer.Option("--dual", help="Light from the camera, see from the projector.")
]
Level = Annotated[
    int | None, typer.Option(min=0, help="Use the transport as known after this level only.")
]
White = Annotated[
    float | None,
    typer.Option(help="Radiance shown as white; by default that of the brightest, all but a few."),
]
View = Annotated[
    int | None,
    typer.Option(help="Of several views show this one, from 0; all, one above the other, if none."),
]
Form = Annotated[
    Literal["exr", "png"],
    typer.Option("--format", help="exr: radiance, float32; png: for the eye, 8 bits, sRGB."),
]
PICTURE_SCALE = "Size: 4 makes each ray 4 x 4 pixels, 1/4 takes the mean of 4 x 4 rays."

_GIB = 2**30
_LOOKED_AT = 360  # pixels that the shorter side of a movie has at least, unless told otherwise


@app.command()
def matrix(
    path: TransportPath,
    output: Annotated[
        Path,
        typer.Argument(metavar="FILE", help="To write: .npz, .h5, .hdf5 or .mat (MATLAB v7.3)."),
    ],
    rows: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Camera rays to keep, as numpy's indices: 31,35 is a pixel (row,column), 31,: a "
            "line, 10:20,30:40 a rectangle, 2,31,35 one of view 2; may be repeated.",
        ),
    ] = None,
    columns: Annotated[
        list[str] | None, typer.Option(metavar="PLACE", help="Projector rays to keep, likewise.")
    ] = None,
    scale: Annotated[
        str,
        typer.Option(
            help="1/4 joins 4 x 4 rays on both sides, which makes the matrix 256 times smaller; "
            "places are those of the joined rays."
        ),
    ] = "1",
    dual: Dual = False,
    level: Level = None,
    limit_gib: Annotated[
        float, typer.Option(help="GiB that the matrix may take before compression.")
    ] = 8.0,
) -> None:
    """Write the transport matrix T, (channels, camera rays, projector rays).

    It is written part by part, in little memory. docs/export.md tells what the files hold and how
    MATLAB, numpy and others read them.
    """
    from rfpipe.export import Scale
    from rfpipe.transport import coarser
    from rfpipe.transport.files import write_matrix

    factor = Scale.parse(scale)
    if factor.enlarge > 1:
        raise InputError(f"scale {scale}: a matrix has no more rays than were acquired; give 1/4")
    light = _opened(path, False, level)
    if factor.reduce > 1:
        light = coarser(light, factor.reduce)
    if dual:
        light = light.T
    chosen = (_rays(rows, light.camera_shape), _rays(columns, light.projector_shape))
    write_matrix(light, output, *chosen, int(limit_gib * _GIB), progress=True)
    typer.echo(f"{output}: T, {output.stat().st_size / 1e6:,.1f} MB")


@app.command()
def rays(
    path: TransportPath,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where to write the pictures.")],
    row: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Camera rays, each a picture of where its light comes from; as numpy's indices: "
            "31,35 is a pixel (row,column), 31,: a line, ::8,::8 every eighth; may be repeated.",
        ),
    ] = None,
    column: Annotated[
        list[str] | None,
        typer.Option(
            metavar="PLACE",
            help="Projector rays, each a picture of where its light goes; likewise.",
        ),
    ] = None,
    form: Form = "exr",
    scale: Annotated[str, typer.Option(help=PICTURE_SCALE)] = "1",
    white: White = None,
    dual: Dual = False,
    level: Level = None,
    limit_gib: Annotated[
        float, typer.Option(help="GiB that all pictures may take before compression.")
    ] = 2.0,
) -> None:
    """Write single rows and columns of the matrix as pictures.

    They are named after their ray, as row_31_35.exr. In a .png each has its own white, unless
    told otherwise, which cuts off the ray's direct light, often the brightest by far.
    """
    import math

    import numpy as np

    from rfpipe.export import Scale, ray_pictures
    from rfpipe.transport.algebra import gibibytes

    light, size = _opened(path, dual, level), Scale.parse(scale)
    chosen = {
        "row": _rays(row, light.camera_shape),
        "column": _rays(column, light.projector_shape),
    }
    pixels = {"row": math.prod(light.projector_shape), "column": math.prod(light.camera_shape)}
    found = {side: rays for side, rays in chosen.items() if rays is not None}
    if not found:
        raise InputError("no rays to export: give --row or --column, as in --row 31,35")
    entries = sum(pixels[side] * len(rays) for side, rays in found.items()) * light.channels
    expected = int(4 * entries * (size.enlarge / size.reduce) ** 2)
    count = sum(map(len, found.values()))
    if expected > limit_gib * _GIB:
        raise InputError(
            f"{count:,} pictures take {gibibytes(expected)}, the limit is {limit_gib:g} GiB; "
            "choose fewer rays, as by ::8,::8, or a smaller scale, or raise the limit"
        )
    folder.mkdir(parents=True, exist_ok=True)
    for side, numbers in found.items():
        shape = light.camera_shape if side == "row" else light.projector_shape
        digits = [len(str(length - 1)) for length in shape]
        for place, picture in ray_pictures(light, "row" if side == "row" else "column", numbers):
            numbered = (f"{index:0{n}d}" for index, n in zip(place, digits, strict=True))
            name = "_".join([side, *numbered])
            about = {"rfpipe:kind": side, "rfpipe:ray": ",".join(map(str, place))}
            top = float(np.percentile(picture, 99.5)) if white is None else white
            _write(folder / f"{name}.{form}", size.apply(picture), top or None, about)
    typer.echo(f"{folder}: {count} pictures")


@app.command()
def relit(
    path: TransportPath,
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where to write the pictures.")],
    patterns: Annotated[
        list[str],
        typer.Argument(
            metavar="PATTERN...",
            help="Names, pictures (as for rfpipe relight), folders of pictures, or .npy files of "
            "weights, (count, *rays) or (count, *rays, channels).",
        ),
    ],
    form: Form = "exr",
    scale: Annotated[str, typer.Option(help=PICTURE_SCALE)] = "1",
    white: White = None,
    view: View = None,
    dual: Dual = False,
    level: Level = None,
    workers: WorkersOption = THREADS,
) -> None:
    """Relight with many patterns, a picture each, named as its pattern.

    All .png have one white, so that they can be compared; without --white it is found by relighting
    twice.
    """
    from rfpipe.export import Scale, open_light, relit_files

    light, size = open_light(path, level, dual), Scale.parse(scale)
    lights = list(_lightings(patterns, light))
    used = relit_files(
        path, lights, folder, form=form, scale=size, white=white, view=view, level=level,
        dual=dual, resources=resources_of(workers),
    )  # fmt: skip
    shown = f", white is {used:.4g}" if form == "png" else ""
    typer.echo(f"{folder}: {len(lights)} pictures{shown}")


@app.command()
def movie(
    path: TransportPath,
    output: Annotated[Path, typer.Argument(metavar="FILE", help="To write: .mp4 or .webm.")],
    along: Annotated[
        str,
        typer.Option(
            "--path",
            help="How the light moves: across (a bar from left to right), down, circle (a disc), "
            "views (of a light field), or places '10,12 40,55 20,60', each row,column, between "
            "which a disc goes.",
        ),
    ] = "across",
    size: Annotated[
        float | None,
        typer.Option(help="Width of the bar or disc, in rays; an eighth of the shorter side."),
    ] = None,
    colour: Annotated[
        str | None, typer.Option(help="Weights of the light's channels, as 1,0.8,0.5; white.")
    ] = None,
    seconds: Annotated[float, typer.Option(help="How long the movie is.")] = 6.0,
    fps: Annotated[float, typer.Option(help="Pictures a second.")] = 25.0,
    scale: Annotated[
        str | None, typer.Option(help=PICTURE_SCALE + " At least 360 pixels, if none is given.")
    ] = None,
    white: White = None,
    view: View = None,
    dual: Dual = False,
    level: Level = None,
) -> None:
    """Write a movie of a light that moves over the scene, in mp4 (H.264) or webm (VP9).

    Needs PyAV, which the extra "export" has. Without --white all is relit twice, first to find it.
    """
    from rfpipe.blocks import RayDomain
    from rfpipe.export import Scale, light_path, relit_movie

    light = _opened(path, dual, level)
    shorter = min(RayDomain(light.camera_shape).image_shape)
    shown = Scale(-(-_LOOKED_AT // shorter)) if scale is None else Scale.parse(scale)
    count = round(seconds * fps) if 0 < seconds * fps < 1e6 else 0
    lights = light_path(along, light.projector_shape, count, size, _colour(colour, light.channels))
    used = relit_movie(
        light, output, lights, fps=fps, scale=shown, white=white, view=view, progress=True
    )
    typer.echo(f"{output}: {count} pictures, white is {used:.4g}")


def _opened(path: Path, dual: bool, level: int | None) -> Light:
    from rfpipe.export import open_light

    return open_light(path, level, dual)


def _rays(places: Sequence[str] | None, shape: tuple[int, ...]) -> NDArray[np.int64] | None:
    """Return the rays at some places, each once, or None where none are named."""
    import numpy as np

    from rfpipe.export import rays_at

    if not places:
        return None
    found = np.concatenate([rays_at(place, shape) for place in places])
    return found[np.sort(np.unique(found, return_index=True)[1])]


def _colour(text: str | None, channels: int) -> tuple[float, ...]:
    if text is None:
        return ()
    try:
        weights = tuple(float(part) for part in text.split(","))
    except ValueError:
        weights = ()
    if len(weights) != channels:
        raise InputError(f"colour {text!r}: expected {channels} weights with commas between")
    return weights


@dataclass(frozen=True)
class _Lighting:
    """A pattern by where it comes from: of a stack of weights in a file the one at `index`."""

    name: str
    source: str
    index: int | None
    shape: tuple[int, ...]
    channels: int

    def weights(self) -> NDArray[np.float32]:
        """Make or read the weights."""
        from rfpipe.cli import _pattern

        if self.index is None:
            return _pattern(self.source, self.shape, self.channels)
        weights: NDArray[np.float32] = _stack(Path(self.source))[self.index]
        return weights


def _lightings(sources: Sequence[str], light: Light) -> Iterator[_Lighting]:
    """Yield all patterns, none of them read yet."""
    rays = (light.projector_shape, light.channels)
    for source in sources:
        file = Path(source)
        if file.is_dir():
            pictures = sorted(part for part in file.iterdir() if part.is_file())
            if not pictures:
                raise InputError(f"{file}: holds no pictures")
            yield from _lightings([str(part) for part in pictures], light)
        elif file.suffix.lower() == ".npy":
            for index in range(len(_stack(file))):
                yield _Lighting(f"{file.stem}_{index:04d}", str(file.absolute()), index, *rays)
        else:  # a picture, or a name
            place = str(file.absolute()) if file.is_file() else source
            yield _Lighting(file.stem, place, None, *rays)


def _stack(file: Path) -> NDArray[np.float32]:
    import numpy as np

    try:
        stack: NDArray[np.float32] = np.load(file, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError) as error:
        raise InputError(f"{file}: can't be read as .npy: {error}") from error
    return stack


def _write(
    path: Path, picture: NDArray[np.float32], white: float | None, about: dict[str, str]
) -> None:
    """Write a picture, complete or not at all."""
    from rfpipe.pictures.images import write_image
    from rfpipe.store.files import storage_errors, whole_file

    failing = storage_errors(path, "writing", picture.nbytes, resumes=False)
    with failing, whole_file(path) as partial:
        write_image(partial, picture, white, about)
