"""``rfpipe settings``: the options of methods and scenes, and the schema of a settings file."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Annotated, Literal

import typer

if TYPE_CHECKING:
    from rfpipe.config.base import PluginSettings


def settings(
    of: Annotated[
        Literal["methods", "scenes", "schema"],
        typer.Argument(
            help="methods or scenes: the installed methods or kinds of scenes, with the default, "
            "meaning and range of each option. schema: the JSON schema of a settings file, with "
            "which an editor completes and checks settings."
        ),
    ],
) -> None:
    """List methods or kinds of scenes with their options, or print the JSON schema."""
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
            _list_options(SceneSettings.model_of(name), base=SceneSettings)


def _list_options(model: type[PluginSettings], base: type[PluginSettings] | None = None) -> None:
    """Print options with default and description, except those equal to options of `base`."""
    reference = _options(base) if base else {}
    for option, line in _options(model).items():
        if option != model.key and reference.get(option) != line:
            typer.echo(f"    {line}")


def _options(model: type[PluginSettings]) -> dict[str, str]:
    from pydantic_core import to_json

    from rfpipe.config.schema import description_of

    lines = {}
    for option, field in model.model_fields.items():
        value = field.get_default(call_default_factory=True, validated_data={})
        default = "required" if field.is_required() else to_json(value).decode()
        lines[option] = f"{option} ({default}): {description_of(field)}"
    return lines
