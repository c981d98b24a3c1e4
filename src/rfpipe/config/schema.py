"""JSON schemas of settings, for editors, and all settings as commented YAML.

``python -m rfpipe.config.schema`` writes these files to the folder ``config``.
"""

from __future__ import annotations

import json
import textwrap
from collections.abc import Sequence
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

import yaml
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from rfpipe import plugins
from rfpipe.config.base import MethodSettings, Settings
from rfpipe.config.devices import BenchConfig, RigConfig
from rfpipe.config.drivers import CameraDriver, DeviceDriver, ProjectorDriver, RigDriver
from rfpipe.config.model import Config
from rfpipe.config.scenes import SceneSettings
from rfpipe.output import write_atomically

_REFERENCE = "#/$defs/{model}"

_BOUNDS = {"gt": "above", "ge": "at least", "lt": "below", "le": "at most"}
"""Words for the bounds of a number, by pydantic's names."""


def schema_of(kind: type[Settings]) -> dict[str, Any]:
    """Return the JSON schema of a model, with the options of all methods, scenes and drivers."""
    schema = kind.model_json_schema(ref_template=_REFERENCE)
    definitions = schema.get("$defs", {})
    for model in (SceneSettings, MethodSettings, ProjectorDriver, CameraDriver, RigDriver):
        if model.__name__ in definitions:
            describe = _by_driver if issubclass(model, DeviceDriver) else _by_name
            definitions[model.__name__] = describe(model, definitions)
    for node in definitions.values():  # the field of each group describes it
        node.pop("description", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _defined(model: type[Settings], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a model; its definitions are added to the others."""
    described = model.model_json_schema(ref_template=_REFERENCE)
    for name, node in described.pop("$defs", {}).items():
        definitions.setdefault(name, node)
    return described


def _by_name(model: type[Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a section whose options depend on the name in it.

    It has each option of any name once, and a rule for each name that lists its options.
    """
    key, names = model.key, plugins.names(model.group)
    options: dict[str, list[Any]] = {}
    rules = []
    for name in names:
        schema = _defined(model.model_of(name), definitions)
        for option, node in schema["properties"].items():
            variants = options.setdefault(option, [])
            variants += [] if node in variants else [node]
        then = {"propertyNames": {"enum": sorted(schema["properties"])}}
        if schema.get("required"):
            then["required"] = schema["required"]
        called = {"properties": {key: {"const": name}}, "required": [key]}
        rules.append({"if": called, "then": then})
    properties = {
        option: nodes[0] if len(nodes) == 1 else {"anyOf": nodes}
        for option, nodes in options.items()
    }
    properties[key] = model.model_json_schema()["properties"][key] | {
        "anyOf": [{"enum": list(names)}, {"pattern": ":"}]
    }
    required = {"required": [key]} if model is not MethodSettings else {}
    return {"type": ["object", "null"], "properties": properties, "allOf": rules, **required}


def _by_driver(model: type[Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a driver, whose options depend on its name."""
    node, rules = definitions[model.__name__], []
    for name in plugins.names(model.group):
        options = model.options_model(name)
        definitions[options.__name__] = _defined(options, definitions)
        reference = {"$ref": _REFERENCE.format(model=options.__name__)}
        condition = {"properties": {"driver": {"const": name}}}  # true without a driver, too
        rules.append({"if": condition, "then": {"properties": {"options": reference}}})
    node["properties"]["options"] = {"type": "object", "description": "The driver's options."}
    return {**node, **({"allOf": rules} if rules else {})}


def generated() -> dict[str, str]:
    """Return the text of each generated file by its name."""
    bench = BenchConfig()
    rig_of_bench = RigConfig(
        projector=ProjectorDriver.model_validate({"options": {"settle_seconds": 0}}),
        bench=bench,
        rays=bench.scene.shape,
        calibration="calibration",
        seconds_per_pattern=0.2,
    )
    note = "Generated from the settings' models by `make config`"
    run, schema = Config.model_validate({"scenes": {"one": {"kind": "plane"}}}), "rig.schema.json"
    return {
        "config.schema.json": json.dumps(schema_of(Config), indent=2) + "\n",
        schema: json.dumps(schema_of(RigConfig), indent=2) + "\n",
        "all.yaml": _file_of(
            run,
            "config.schema.json",
            f"All settings of a run with their defaults, and one scene. {note}. 'rfpipe settings "
            "scenes' and 'rfpipe settings methods' list the options of each kind of scene and of "
            "each method.",
        ),
        "rig.yaml": _file_of(
            RigConfig(),
            schema,
            f"A rig: a window on the projector and a Basler camera. {note}. Copy this file, change "
            "the copy, and start the rig's server with `rfpipe serve <copy>`.",
        ),
        "bench.yaml": _file_of(
            rig_of_bench,
            schema,
            "The optical bench in software: a rig without hardware, which consists of a display in "
            f"memory, a simulated scene and a real camera driver. {note}. Use it as rig.yaml.",
        ),
    }


def _file_of(settings: Settings, schema: str, head: str) -> str:
    """Return settings as YAML under a head of comments."""
    lines = [f"# yaml-language-server: $schema={schema}", _comment(head, ""), ""]
    return "\n".join([*lines, *_yaml_lines(settings, "")])


def _comment(text: str, margin: str) -> str:
    return textwrap.fill(text, 98, initial_indent=f"{margin}# ", subsequent_indent=f"{margin}# ")


def _yaml_lines(settings: BaseModel, margin: str) -> list[str]:
    """Lines of a model's settings, with their descriptions as comments."""
    lines: list[str] = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        lines.append(_comment(description_of(field), margin))
        if isinstance(value, BaseModel):
            lines += [f"{margin}{name}:", *_yaml_lines(value, margin + "  ")]
        else:
            plain = settings.model_dump(mode="json", include={name})[name]
            text = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=10_000)
            lines.append(f"{margin}{name}: " + text.removesuffix("\n").removesuffix("\n..."))
        if not margin:
            lines.append("")
    return lines


def description_of(field: FieldInfo) -> str:
    """Return the description of a setting with its choices and its range."""
    text = str(field.description)
    choices = [str(choice) for choice in _choices(field.annotation)]
    if not all(choice in text for choice in choices):
        text += f" One of {', '.join(choices)}."
    limits = _limits(field.annotation, field.metadata)
    return f"{text} {limits[0].upper()}{limits[1:]}." if limits else text


def _choices(annotation: object) -> list[object]:
    """Return the values of the Literals in an annotation."""
    arguments = get_args(annotation)
    if get_origin(annotation) is Literal:
        return list(arguments)
    return [choice for argument in arguments for choice in _choices(argument)]


def _limits(annotation: object, metadata: Sequence[object]) -> str:
    """Describe the range of a number, or of each number of a tuple, such as ``at least 0``."""
    constraints = [
        constraint
        for item in metadata
        for constraint in (item.metadata if isinstance(item, FieldInfo) else [item])
    ]
    bounds = {
        name: getattr(constraint, name)
        for constraint in constraints
        for name in _BOUNDS
        if hasattr(constraint, name)
    }
    if {"ge", "le"} <= bounds.keys():
        return f"from {bounds['ge']:,} to {bounds['le']:,}"
    if bounds:
        return ", ".join(f"{_BOUNDS[name]} {bounds[name]:,}" for name in _BOUNDS if name in bounds)
    if get_origin(annotation) is Annotated:
        return _limits(annotation.__origin__, annotation.__metadata__)  # type: ignore[attr-defined]
    if get_origin(annotation) not in (Union, UnionType, tuple):
        return ""
    limits = {_limits(argument, ()) for argument in get_args(annotation)} - {""}
    if len(limits) != 1:
        return ""
    return f"{'each ' if get_origin(annotation) is tuple else ''}{limits.pop()}"


if __name__ == "__main__":
    for _name, _text in generated().items():
        write_atomically(Path("config", _name), _text.encode())
