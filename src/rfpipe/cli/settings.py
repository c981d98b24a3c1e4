"""``rfpipe settings``: what may stand in a settings file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from rfpipe.config.base import Described


def settings(
    of: Annotated[
        Literal["methods", "scenes", "schema"],
        typer.Argument(
            help="The methods or kinds of scenes that are installed, each with its options; or the "
            "JSON schema of a settings file, for editors."
        ),
    ],
) -> None:
    """List the methods or the kinds of scenes, each with its options; or print the JSON schema."""
    from rfpipe import plugins
    from rfpipe.config import SceneSettings
    from rfpipe.config.model import Config
    from rfpipe.config.schema import schema_of
    from rfpipe.methods import get_method, method_names

    if of == "schema":
        typer.echo(json.dumps(schema_of(Config), indent=2))
    elif of == "methods":
        for name in method_names():
            method = get_method(name)
            rig = "coaxial rigs" if method.needs_coaxial_rig else "any rig"
            typer.echo(f"{name}: {method.title.lower()}, {rig}")
            _list_options(method.Options)
    else:
        typer.echo("every kind:")
        _list_options(SceneSettings)
        for name in plugins.names(plugins.SCENES):
            kind = plugins.find(plugins.SCENES, name)
            typer.echo(f"{name}: {(kind.__doc__ or '').partition('.')[0]}")
            _list_options(SceneSettings.model_of(name), beside=SceneSettings)


def _list_options(model: type[Described], beside: type[Described] | None = None) -> None:
    """Print options with default and description, but for those that are the same `beside`."""
    reference = _options(beside) if beside else {}
    for option, line in _options(model).items():
        if option != model.key and reference.get(option) != line:
            typer.echo(f"    {line}")


def _options(model: type[Described]) -> dict[str, str]:
    from pydantic_core import to_json

    lines = {}
    for option, field in model.model_fields.items():
        value = field.get_default(call_default_factory=True, validated_data={})
        default = "needed" if field.is_required() else to_json(value).decode()
        lines[option] = f"{option} ({default}): {field.description}"
    return lines
