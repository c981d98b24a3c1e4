"""``rfpipe relight``: the scene under one pattern or many, as pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli.transports import (
    Dual,
    Form,
    Level,
    TransportPath,
    View,
    White,
    opened,
    picture_of_rays,
    times,
)
from rfpipe.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rfpipe.transport.light import Light

    Float = NDArray[np.float32]

_WHITE_PERCENTILE = 99.9  # a glint may be cut off


def relight(
    path: TransportPath,
    pattern: Annotated[
        list[str],
        typer.Option(
            metavar="NAME|FILE",
            help="The light: white, vertical_bar, horizontal_bar, noise, binary or spot; a picture "
            "of the projector's size, one channel (white light) or RGB, its values taken as linear "
            "weights, whole numbers as fractions of their largest; or a .npy file of weights, "
            "(*rays) or (*rays, channels), or of many such. May be repeated.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            help="Picture to write, .exr (radiance, float32) or .png (8 bits, sRGB); .npy for all "
            "pictures as one array of radiance, (count, H, W, channels); else, of several "
            "patterns, the folder of their pictures.",
        ),
    ],
    form: Form = "exr",
    dual: Dual = False,
    view: View = None,
    level: Level = None,
    white: White = None,
) -> None:
    """Render the image under a pattern, or under each of many.

    Several views stand one above the other in patterns and pictures. All .png of one call have one
    white, so that they can be compared; without --white it is found by relighting twice.
    """
    import numpy as np

    from rfpipe.export import relit_pictures
    from rfpipe.export.photographs import write_picture
    from rfpipe.store.files import whole_file

    light = opened(path, dual, level, view)
    patterns = list(_patterns(pattern, light))
    names = [name for name, _ in patterns]
    twice = {name for name in names if names.count(name) > 1}
    if twice:
        raise InputError(f"two patterns are named {min(twice)}; rename one, or relight them apart")
    if output.suffix == ".npy":
        stack = np.stack(list(relit_pictures(light, (weights() for _, weights in patterns))))
        with whole_file(output) as partial_file:
            np.save(partial_file, stack)
        typer.echo(f"{output}: {times(stack.shape)}, radiance up to {stack.max():.4g}")
        return
    is_picture = len(patterns) == 1 and output.suffix in (".exr", ".png")
    if not is_picture:
        output.mkdir(parents=True, exist_ok=True)
    files = [output if is_picture else output / f"{name}.{form}" for name in names]

    def pictures() -> Iterator[Float]:
        return relit_pictures(light, (weights() for _, weights in patterns))

    if white is None and len(patterns) > 1 and form == "png":
        white = max(float(np.percentile(image, _WHITE_PERCENTILE)) for image in pictures())
    for file, name, image in zip(files, names, pictures(), strict=True):
        write_picture(file, image, white or None, {"rfpipe:pattern": name})
    if is_picture:
        typer.echo(f"{output}: {times(image.shape[:2])}, radiance up to {image.max():.4g}")
    else:
        suffix = f", white is {white:.4g}" if white and form == "png" else ""
        typer.echo(f"{output}: {len(patterns)} pictures{suffix}")


def _patterns(sources: Sequence[str], light: Light) -> Iterator[tuple[str, Callable[[], Float]]]:
    """Yield all patterns: their names, and what makes or reads their weights."""
    import numpy as np

    for source in sources:
        file = Path(source)
        if file.suffix.lower() == ".npy":
            try:
                stack = np.load(file, mmap_mode="r", allow_pickle=False)
            except (OSError, ValueError) as error:
                raise InputError(f"{file}: can't be read as .npy: {error}") from error
            if light.projector_shape in (stack.shape, stack.shape[:-1]):
                yield file.stem, partial(np.asarray, stack)
                continue
            for index in range(len(stack)):
                yield f"{file.stem}_{index:04d}", partial(stack.__getitem__, index)
        else:
            shape, channels = light.projector_shape, light.channels
            yield file.stem, partial(pattern_weights, source, shape, channels)


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
