"""``rfpipe relight``: the scene under patterns or the light around, as pictures or a movie."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from rfpipe.cli.transports import (
    Dual,
    Form,
    Level,
    TransportPath,
    View,
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
"""Share of a panorama's light above which no note is printed."""


def relight(
    path: TransportPath,
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Picture to write, .exr (radiance, float32) or .png (8 bits, sRGB); .npy for all "
            "pictures as one array of radiance, (count, H, W, channels); .mp4 for a movie, which "
            "needs the extra 'export'; else, of several patterns, the folder of their pictures.",
        ),
    ],
    pattern: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME|FILE",
            help="The light: white, vertical_bar, horizontal_bar, noise, binary or spot; a picture "
            "of the projector's size, one channel (white light) or RGB, its values taken as linear "
            "weights, whole numbers as fractions of their largest; or a .npy file of weights, "
            "(*rays) or (*rays, channels), or of many such. May be repeated.",
        ),
    ] = None,
    environment: Annotated[
        Path | None,
        typer.Option(
            help="The light instead: a panorama, twice as wide as high, .hdr, .exr or a picture of "
            "linear values, around a transport of single lights in known directions. Its centre is "
            "+z, +x is left of it, as in OpenEXR and USD."
        ),
    ] = None,
    mirror: Annotated[
        bool, typer.Option("--mirror", help="In the panorama, +x is right of the centre instead.")
    ] = False,
    turns: Annotated[
        int, typer.Option(min=1, help="So many pictures while the panorama turns once, rightward.")
    ] = 1,
    form: Form = "exr",
    dual: Dual = False,
    view: View = None,
    level: Level = None,
    white: White = None,
) -> None:
    """Render the image under a pattern, under each of many, or under the light around.

    Several views stand one above the other in patterns and pictures. All .png of one call, and a
    movie, have one white; without --white it is found by relighting twice.
    """
    from tqdm import tqdm

    from rfpipe.blocks import RayDomain
    from rfpipe.export.movies import movie_of
    from rfpipe.output import FOLDER, checked_output

    suffix = checked_output("relight", output)
    if bool(pattern) == bool(environment) or (pattern and (turns > 1 or mirror)):
        raise InputError("give --pattern, or --environment, which alone has --turns and --mirror")
    light = opened(path, dual, level, view)
    if environment:
        lit = list(_turning(environment, turns, light, mirror))
    else:
        lit = list(_lit(pattern or (), light))
    names = [name for name, _ in lit]
    count, shape = len(names), RayDomain(light.camera_shape).picture_shape

    def pictures(what: str = "relit") -> Iterator[Float]:
        made = (relit().reshape(*shape, -1) for _, relit in lit)
        return iter(tqdm(made, what, count, unit="picture", disable=None if count > 1 else True))

    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"two patterns are named {min(twice)}; rename one, or relight them apart")
    if suffix == ".mp4":
        white = movie_of(pictures, output, enlarge=enlarged(light), white=white)
        typer.echo(f"{output}: {counted(count, 'picture')}, white is {white:.4g}")
    elif suffix == ".npy":
        _write_stack(output, (count, *shape, light.channels), pictures())
    elif suffix == FOLDER:
        _write_folder(output, names, pictures, form, white)
    elif count > 1:
        raise InputError(f"{output}: for {counted(count, 'picture')}, name a folder, .npy or .mp4")
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
    """Write pictures of one white into a folder, a file each by its name."""
    from rfpipe.export.movies import white_of
    from rfpipe.pictures.images import write_image

    if white is None and len(names) > 1 and form == "png":
        white = white_of(pictures("white"))
    for name, image in zip(names, pictures(), strict=True):
        write_image(folder / f"{name}.{form}", image, white or None, {"rfpipe:pattern": name})
    suffix = f", white is {white:.4g}" if white and form == "png" else ""
    typer.echo(f"{folder}: {counted(len(names), 'picture')}{suffix}")


def _write_stack(output: Path, shape: tuple[int, ...], pictures: Iterator[Float]) -> None:
    """Write pictures as one array (count, H, W, channels) of NumPy, one at a time."""
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


def _turning(
    environment: Path, turns: int, light: Relightable, mirrored: bool
) -> Iterator[tuple[str, Callable[[], Float]]]:
    """Yield the name of each picture under a panorama that turns, and a function that relights it.

    Before the first, print the least share of the panorama's light that the lights cover.
    """
    from rfpipe.environment import as_panorama, environment_coverage
    from rfpipe.pictures.images import read_image

    panorama = as_panorama(read_image(environment), str(environment))
    angles = [360 * turn / turns for turn in range(turns)]
    if light.lights is not None:
        covered = [environment_coverage(panorama, light.lights, at, mirrored) for at in angles]
        if min(covered) < _COMPLETE:
            typer.echo(
                f"{environment}: {1 - min(covered):.1%} of its light comes from farther than twice "
                "the lights' spacing from any light, and is left out",
                err=True,
            )
    for turn, angle in enumerate(angles):
        name = f"{environment.stem}_{turn:04d}" if turns > 1 else environment.stem
        yield name, partial(light.relight_environment, panorama, None, angle, mirrored)


def _lit(sources: Sequence[str], light: Relightable) -> Iterator[tuple[str, Callable[[], Float]]]:
    """Yield the pictures under all patterns: their names, and what makes them."""
    import numpy as np

    def under(weights: Callable[..., Float], *of: Any) -> Float:
        return light.relight(weights(*of))

    for source in sources:
        file = Path(source)
        if file.suffix.lower() == ".npy":
            try:
                stack = np.load(file, mmap_mode="r", allow_pickle=False)
            except (OSError, ValueError) as error:
                raise InputError(f"{file}: can't be read as .npy: {error}") from error
            if light.projector_shape in (stack.shape, stack.shape[:-1]):
                yield file.stem, partial(under, np.asarray, stack)
                continue
            for index in range(len(stack)):
                yield f"{file.stem}_{index:04d}", partial(under, stack.__getitem__, index)
        else:
            shape, channels = light.projector_shape, light.channels
            yield file.stem, partial(under, pattern_weights, source, shape, channels)


def pattern_weights(name: str, shape: tuple[int, ...], channels: int) -> Float:
    """Return a named pattern, or the weights of a picture: its views one above the other.

    Raises
    ------
    InputError
        When it is neither a file nor a name, or a picture of another size or too many channels.
    """
    import numpy as np

    from rfpipe.scenes.relighting import RELIGHTING_PATTERNS, relighting_patterns

    if name == "white":
        return np.ones(shape, np.float32)
    if name in RELIGHTING_PATTERNS:
        return relighting_patterns(shape)[name]
    if not Path(name).is_file():
        raise InputError(
            f"pattern {name}: is no file and no name of a pattern; expected a picture, white, "
            f"{', '.join(RELIGHTING_PATTERNS)}"
        )
    picture = picture_of_rays(f"pattern {name}", Path(name), shape)
    if picture.ndim > len(shape) and channels == 1:
        raise InputError(
            f"pattern {name}: is RGB, but the transport has one channel; give a grey picture"
        )
    return picture
