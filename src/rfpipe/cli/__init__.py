"""The commands of ``rfpipe``: thin, each importing what it needs when it runs."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from rfpipe.cli import fit, offline
from rfpipe.cli.aim import aim
from rfpipe.cli.calibrate import calibrate
from rfpipe.cli.catalogue import catalogue
from rfpipe.cli.collection import app as collection
from rfpipe.cli.export import app as export
from rfpipe.cli.info import info, open_checked, times
from rfpipe.cli.keep import keep
from rfpipe.cli.plan import plan
from rfpipe.cli.publish import publish
from rfpipe.cli.run import PASSED_ON, Directory, run, working_in
from rfpipe.cli.verify import verify
from rfpipe.cli.view import view
from rfpipe.errors import InputError, RfpipeError
from rfpipe.version import __version__

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from rfpipe.config.base import Described
    from rfpipe.transport.base import Light

__all__ = ["app", "main"]

_LISTED = 20

app = typer.Typer(
    name="rfpipe",
    help="Serve a rig; inspect and relight the light transport between a projector and a camera.",
    no_args_is_help=True,
    invoke_without_command=True,
    pretty_exceptions_enable=False,
)


@app.callback()
def _common(
    version: Annotated[
        bool,
        typer.Option("--version", help="Print rfpipe's version and exit.", is_eager=True),
    ] = False,
) -> None:
    if version:
        typer.echo(f"rfpipe {__version__}")
        raise typer.Exit


ConfigPath = Annotated[Path, typer.Argument(metavar="CONFIG", help="A YAML file of settings.")]


def _pattern_names(incomplete: str) -> list[str]:
    """Complete the name of a pattern; a file is completed by the shell."""
    from rfpipe.scenes.relighting import RELIGHTING_PATTERNS

    return [name for name in ("white", *RELIGHTING_PATTERNS) if name.startswith(incomplete)]


TransportPath = Annotated[
    Path,
    typer.Argument(
        metavar="TRANSPORT",
        help="A transport.zarr that a run left in results/; or a folder, zip file or address "
        "(https://, s3://) that holds one.",
    ),
]


@app.command()
def validate(config: ConfigPath, directory: Directory = Path()) -> None:
    """Check a settings file, a run's or a rig's; say every mistake in it."""
    from rfpipe.config import load_config, load_rig_config, read_yaml
    from rfpipe.config.files import is_rig

    with working_in(directory, config) as path:
        if is_rig(read_yaml(path)):
            rig = load_rig_config(path)
            what = "a bench in software" if rig.bench is not None else f"a rig, {rig.kind}"
            typer.echo(f"{config}: valid. The settings of {what}, for rfpipe calibrate and serve")
            return
        settings = load_config(path)
        named = [f"{scene} by {', '.join(settings.methods_of(scene))}" for scene in settings.scenes]
        if len(named) > _LISTED:
            named[_LISTED:] = [f"and {len(named) - _LISTED} more"]
        count = len(settings.acquisitions)
        typer.echo(f"{config}: valid. {count} acquisitions: {'; '.join(named)}")


@app.command()
def methods() -> None:
    """List the methods that are installed, each with its options."""
    from rfpipe.methods import get_method, method_names

    for name in method_names():
        method = get_method(name)
        rig = "coaxial rigs" if method.needs_coaxial_rig else "any rig"
        typer.echo(f"{name}: {method.title.lower()}, {rig}")
        _list_options(method.Options)


@app.command()
def scenes() -> None:
    """List the kinds of scenes that are installed, each with its options."""
    from rfpipe import plugins
    from rfpipe.config import SceneSettings

    typer.echo("every kind:")
    _list_options(SceneSettings)
    for name in plugins.names(plugins.SCENES):
        kind = plugins.find(plugins.SCENES, name)
        typer.echo(f"{name}: {(kind.__doc__ or '').partition('.')[0]}")
        _list_options(SceneSettings.model_of(name), beside=SceneSettings)


app.command()(plan)
app.command()(catalogue)
app.add_typer(collection, name="collection")


@app.command()
def schema() -> None:
    """Print the JSON schema of a settings file."""
    from rfpipe.config import json_schema

    typer.echo(json.dumps(json_schema(), indent=2))


app.command()(info)
app.command(context_settings=PASSED_ON)(run)
app.command()(verify)


@app.command()
def relight(
    path: TransportPath,
    pattern: Annotated[
        str,
        typer.Option(
            metavar="NAME|FILE",
            autocompletion=_pattern_names,
            help="The light: white, vertical_bar, horizontal_bar, noise, binary or spot; or a "
            "picture of the projector's size, one channel (white light) or RGB, its values taken "
            "as linear weights: whole numbers as fractions of their largest, 255 of 8 bits.",
        ),
    ],
    output: Annotated[
        Path,
        typer.Option(help="Picture to write: .exr (radiance, float32) or .png (8 bits, sRGB)."),
    ],
    dual: Annotated[
        bool, typer.Option("--dual", help="Light from the camera, see from the projector.")
    ] = False,
    one_view: Annotated[
        int | None,
        typer.Option(
            "--view",
            min=0,
            metavar="NUMBER",
            help="Of several views, write this one alone, counted from 0; of what lies behind an "
            "address, little else is fetched.",
        ),
    ] = None,
    level: Annotated[
        int | None,
        typer.Option(min=0, help="Use the transport as known after this level only."),
    ] = None,
    white: Annotated[
        float | None,
        typer.Option(help="Radiance shown as white in a .png; the image's maximum by default."),
    ] = None,
    scale: Annotated[
        float,
        typer.Option(
            min=0.01,
            max=100,
            help="Write the picture so many times as large: whole numbers make squares of pixels, "
            "others are interpolated.",
        ),
    ] = 1.0,
    resize: Annotated[
        bool,
        typer.Option(
            "--resize", help="Resize a pattern that has another size than the rays; says so."
        ),
    ] = False,
) -> None:
    """Render the image under a pattern.

    Several views stand one above the other in the pattern and in the output.
    """
    from rfpipe.blocks import RayDomain
    from rfpipe.pictures.images import scaled, write_image

    transport = open_checked(path)
    if level is not None:
        transport = transport.truncate(level)
    lit = transport.T if dual else transport
    weights = _pattern(pattern, lit.projector_shape, lit.channels, resize=resize)
    if one_view is not None:
        lit = _view_of(lit, one_view)
    image = lit.relight(weights)
    picture = image.reshape(*RayDomain(lit.camera_shape).picture_shape, lit.channels)
    picture = scaled(picture, scale)
    write_image(output, picture, white)
    size = times(lit.camera_shape if scale == 1 else picture.shape[:2])
    typer.echo(f"{output}: {size}, radiance up to {image.max():.4g}")


app.add_typer(export, name="export")
app.command()(offline.patterns)
app.command("import")(offline.import_)
app.command()(fit.fit)
app.command()(publish)
app.command()(keep)


app.command()(view)


@app.command("check-report")
def check_report(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Such as results/report.")],
) -> None:
    """Check a run's report: no figure missing or blank, no link to nothing."""
    from rfpipe.report import check_report as check

    results = check(folder)
    typer.echo(f"{folder}: whole. {len(results.figures)} figures, none blank")


app.command()(aim)
app.command()(calibrate)


@app.command()
def serve(
    rig: Annotated[
        Path, typer.Argument(metavar="RIG.yaml", help="The rig's settings; see config/rig.yaml.")
    ],
    host: Annotated[str, typer.Option(help="Address to listen on.")] = "127.0.0.1",
    port: Annotated[int, typer.Option(help="Port to listen on; 0 takes a free one.")] = 8750,
    allow_remote: Annotated[
        bool,
        typer.Option(
            "--allow-remote",
            help="Let other machines connect, over plain HTTP: an SSH tunnel is safer.",
        ),
    ] = False,
    token_file: Annotated[
        Path | None,
        typer.Option(
            help="File with the token that clients must send, readable by you alone; without it, "
            "the environment variable RFPIPE_TOKEN."
        ),
    ] = None,
    lease_seconds: Annotated[
        float, typer.Option(help="How long a client keeps the rig without a sign of life.")
    ] = 15.0,
    log_file: Annotated[Path | None, typer.Option(help="File to log to beside stderr.")] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Serve a rig whose calibration is not good, too.")
    ] = False,
) -> None:
    """Run the acquisition server, next to a rig's devices, until Ctrl-C or SIGTERM.

    A rig whose calibration found faults is refused: mend it, or say --force.
    """
    from rfpipe.config import load_rig_config
    from rfpipe.rigs.build import rig_from_config
    from rfpipe.rigs.calibrated import calibration_of, check_verdicts
    from rfpipe.rigs.token import read_token
    from rfpipe.server import ServerSettings
    from rfpipe.server import serve as run

    settings = ServerSettings(
        host=host,
        port=port,
        allow_remote=allow_remote,
        lease_seconds=lease_seconds,
        log_file=log_file,
    )
    config = load_rig_config(rig)
    if config.kind == "devices" and config.rig is None:
        check_verdicts(calibration_of(config).facts, config.calibration, force=force)
    run(lambda: rig_from_config(config), read_token(token_file), settings)


def _list_options(model: type[Described], beside: type[Described] | None = None) -> None:
    """Print options, each with its default as in YAML and its description.

    Those that are the same `beside` are left out.
    """
    lines = _options(model)
    known = _options(beside) if beside else {}
    for option, line in lines.items():
        if option != model.key and known.get(option) != line:
            typer.echo(f"    {line}")


def _options(model: type[Described]) -> dict[str, str]:
    from pydantic_core import to_json

    lines = {}
    for option, field in model.model_fields.items():
        value = field.get_default(call_default_factory=True, validated_data={})
        default = "needed" if field.is_required() else to_json(value).decode()
        lines[option] = f"{option} ({default}): {field.description}"
    return lines


def _view_of(lit: Light, view: int) -> Light:
    """Return what passes light to one view of several."""
    import numpy as np

    from rfpipe.blocks import RayDomain
    from rfpipe.transport.cropped import crop

    domain = RayDomain(lit.camera_shape)
    if not domain.is_stack or view >= domain.views:
        has = f"has {domain.views} views, from 0" if domain.is_stack else "has one view"
        raise InputError(f"--view {view}: the transport {has}; leave it out for all")
    return crop(lit, tuple(map(int, np.unravel_index(view, domain.views_shape))))


def _pattern(
    name: str, shape: tuple[int, ...], channels: int, *, resize: bool = False
) -> NDArray[np.float32]:
    """Make a named pattern, or read a picture: its views one above the other."""
    import numpy as np

    from rfpipe.blocks import RayDomain
    from rfpipe.pictures.images import read_image, resized
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
    picture = read_image(Path(name))
    expected = RayDomain(shape).picture_shape
    if picture.shape[:2] != expected and resize:
        typer.echo(
            f"pattern {name}: resized from {times(picture.shape[:2])} to {times(expected)} pixels",
            err=True,
        )
        picture = resized(picture, expected).clip(0, 1)
    if picture.shape[:2] != expected:
        raise InputError(
            f"pattern {name}: is {times(picture.shape[:2])} pixels (height x width); expected "
            f"{times(expected)}, the shape of the rays that send the light; resize the picture, or "
            "add --resize"
        )
    if picture.ndim == 3 and channels == 1:
        raise InputError(
            f"pattern {name}: is RGB, but the transport has one channel; give a grey picture"
        )
    return picture.reshape(*shape, *picture.shape[2:])


def main() -> None:
    """Run the command line; an expected error is a message and exit status 1."""
    try:
        app()
    except RfpipeError as error:
        typer.echo(f"rfpipe: {error}", err=True)
        sys.exit(1)
