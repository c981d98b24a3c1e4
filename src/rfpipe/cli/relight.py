"""``rfpipe relight``: the scene under patterns or an environment, as pictures or a movie."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rfpipe.cli.transports import (
    DualOption,
    Form,
    Level,
    TransportPath,
    ViewOption,
    White,
    enlarged,
    opened,
    picture_of_rays,
    times,
)
from rfpipe.errors import InputError
from rfpipe.text import counted

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rfpipe.transport.relightable import Relightable

    Float = NDArray[np.float32]


_COMPLETE = 0.999
"""Fraction of a panorama's light above which the coverage by the lights isn't reported."""


def relight(
    path: TransportPath,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Picture to write, .exr (radiance, float32) or .png (8 bits, sRGB). For several "
            "pictures: a folder; .npy for an array of radiance, (count, H, W, channels); or .mp4 "
            "for a movie, which needs the extra 'export'.",
        ),
    ],
    pattern: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="Pattern of the projector: white, vertical_bar, horizontal_bar, noise, binary or "
            "spot; an image file of the projector's size, grey or RGB, whose values are linear "
            "weights (integers are divided by their largest possible value); or a .npy file of "
            "weights, (*rays) or (*rays, channels), or with several such patterns along the first "
            "axis. May be repeated.",
        ),
    ] = None,
    environment: Annotated[
        Path | None,
        typer.Option(
            help="Environment instead of a pattern, for a transport of lights in known directions: "
            "a panorama, twice as wide as high, .hdr, .exr or another picture with linear values. "
            "Its centre is in direction +z, and +x is left of it, as in OpenEXR and USD."
        ),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="Mirror the panorama: +x is right of the centre.")
    ] = False,
    turns: Annotated[
        int,
        typer.Option(min=1, help="Number of pictures in one turn of the panorama, to the right."),
    ] = 1,
    form: Form = "exr",
    dual: DualOption = False,
    view: ViewOption = None,
    level: Level = None,
    white: White = None,
) -> None:
    """Render the scene under a pattern, under each of several, or in an environment.

    In patterns and pictures, several views are stacked vertically. All .png files of a call, or
    the pictures of a movie, share one white level; without --white, the scene is relit twice, the
    first time to find the largest radiance.
    """
    from tqdm import tqdm

    from rfpipe.blocks import RayDomain
    from rfpipe.export.movies import movie_of
    from rfpipe.output import FOLDER, checked_output

    suffix = checked_output("relight", output)
    if bool(pattern) == bool(environment) or (pattern and (turns > 1 or mirror)):
        raise InputError(
            "give either --pattern, or --environment with its options --turns and --mirror"
        )
    light = opened(path, dual, level, view)
    if environment:
        renderings = list(_environment_renderings(environment, turns, light, mirror))
    else:
        renderings = list(_pattern_renderings(pattern or (), light))
    names = [name for name, _ in renderings]
    count, shape = len(names), RayDomain(light.camera_shape).picture_shape

    def pictures(label: str = "relit") -> Iterator[Float]:
        images = (render().reshape(*shape, -1) for _, render in renderings)
        disable = None if count > 1 else True
        return iter(tqdm(images, label, count, unit="picture", disable=disable))

    repeated = {name for name in names if names.count(name) > 1}
    if repeated:
        raise InputError(
            f"two patterns are named {min(repeated)}; rename one, or relight them separately"
        )
    if suffix == ".mp4":
        white = movie_of(pictures, output, enlarge=enlarged(light), white=white)
        typer.echo(f"{output}: {counted(count, 'picture')}, white is {white:.4g}")
    elif suffix == ".npy":
        _write_stack(output, (count, *shape, light.channels), pictures())
    elif suffix == FOLDER:
        _write_folder(output, names, pictures, form, white)
    elif count > 1:
        raise InputError(
            f"{output}: can't contain {counted(count, 'picture')}; name a folder, .npy or .mp4"
        )
    else:
        _write_picture(output, names[0], next(pictures()), white)


def _write_picture(output: Path, name: str, image: Float, white: float | None) -> None:
    """Write one picture, and print its size."""
    from rfpipe.pictures.images import write_image

    write_image(output, image, white or None, {"rfpipe:pattern": name})
    typer.echo(f"{output}: {times(image.shape[:2])}, radiance up to {image.max():.4g}")


def _write_folder(
    folder: Path,
    names: Sequence[str],
    pictures: Callable[..., Iterator[Float]],
    form: str,
    white: float | None,
) -> None:
    """Write pictures with a common white level into a folder, each to a file of its name."""
    from rfpipe.export.movies import white_of
    from rfpipe.pictures.images import write_image

    if white is None and len(names) > 1 and form == "png":
        white = white_of(pictures("white"))
    for name, image in zip(names, pictures(), strict=True):
        write_image(folder / f"{name}.{form}", image, white or None, {"rfpipe:pattern": name})
    suffix = f", white is {white:.4g}" if white and form == "png" else ""
    typer.echo(f"{folder}: {counted(len(names), 'picture')}{suffix}")


def _write_stack(output: Path, shape: tuple[int, ...], pictures: Iterator[Float]) -> None:
    """Write pictures one by one to a NumPy file of shape (count, H, W, channels)."""
    import numpy as np

    from rfpipe.output import whole_file

    brightest = 0.0
    with whole_file(output, 4 * math.prod(shape)) as partial_file, partial_file.open("wb") as file:
        header = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, header)
        for image in pictures:
            file.write(np.ascontiguousarray(image, "<f4").data)
            brightest = max(brightest, float(image.max()))
    typer.echo(f"{output}: {times(shape)}, radiance up to {brightest:.4g}")


def _environment_renderings(
    environment: Path, turns: int, light: Relightable, mirrored: bool
) -> Iterator[tuple[str, Callable[[], Float]]]:
    """Yield name and rendering function of each picture in a rotating panorama.

    A note on the terminal reports light of the panorama that the transport's lights don't cover.
    """
    from rfpipe.environment import as_panorama, environment_coverage
    from rfpipe.pictures.images import read_image

    panorama = as_panorama(read_image(environment), str(environment))
    angles = [360 * turn / turns for turn in range(turns)]
    if light.lights is not None:
        coverage = min(
            environment_coverage(panorama, light.lights, angle, mirrored) for angle in angles
        )
        if coverage < _COMPLETE:
            typer.echo(
                f"{environment}: {1 - coverage:.1%} of its light is omitted, since it comes from "
                "directions farther than twice the lights' spacing from any light",
                err=True,
            )
    for turn, angle in enumerate(angles):
        name = f"{environment.stem}_{turn:04d}" if turns > 1 else environment.stem
        yield name, partial(light.relight_environment, panorama, None, angle, mirrored)


def _pattern_renderings(
    sources: Sequence[str], light: Relightable
) -> Iterator[tuple[str, Callable[[], Float]]]:
    """Yield name and rendering function of the picture under each pattern."""
    import numpy as np

    def render(read_weights: Callable[..., Float], *arguments: Any) -> Float:
        return light.relight(read_weights(*arguments))

    for source in sources:
        file = Path(source)
        if file.suffix.lower() == ".npy":
            try:
                stack = np.load(file, mmap_mode="r", allow_pickle=False)
            except (OSError, ValueError) as error:
                raise InputError(f"{file}: can't be read as .npy: {error}") from error
            if light.projector_shape in (stack.shape, stack.shape[:-1]):
                yield file.stem, partial(render, np.asarray, stack)
                continue
            for index in range(len(stack)):
                yield f"{file.stem}_{index:04d}", partial(render, stack.__getitem__, index)
        else:
            shape, channels = light.projector_shape, light.channels
            yield file.stem, partial(render, pattern_weights, source, shape, channels)


def pattern_weights(name: str, shape: tuple[int, ...], channels: int) -> Float:
    """Return the weights of a named pattern or of a picture file.

    Returns
    -------
    ndarray
        (*shape) or (*shape, channels), float32.

    Raises
    ------
    InputError
        When there is no such pattern or file, or the picture has another size or too many
        channels.
    """
    import numpy as np

    from rfpipe.scenes.relighting import RELIGHTING_PATTERNS, relighting_patterns

    if name == "white":
        return np.ones(shape, np.float32)
    if name in RELIGHTING_PATTERNS:
        return relighting_patterns(shape)[name]
    if not Path(name).is_file():
        raise InputError(
            f"there is no pattern or file {name}; expected a picture, white, "
            f"{', '.join(RELIGHTING_PATTERNS)}"
        )
    picture = picture_of_rays(f"pattern {name}", Path(name), shape)
    if picture.ndim > len(shape) and channels == 1:
        raise InputError(
            f"pattern {name}: is RGB, but the transport has one channel; give a grey picture"
        )
    return picture
