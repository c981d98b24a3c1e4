"""JSON schemas of settings, for editors, and all settings as commented YAML.

``python -m rfpipe.config.schema`` writes what is made of the models into the folder ``config``.
"""

from __future__ import annotations

import json
import textwrap
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

import yaml
from pydantic import BaseModel

from rfpipe import plugins
from rfpipe.config.base import MethodSettings, Settings
from rfpipe.config.devices import BenchConfig, RigConfig
from rfpipe.config.drivers import CameraDriver, DeviceDriver, ProjectorDriver, RigDriver
from rfpipe.config.model import Config
from rfpipe.config.scenes import SceneSettings
from rfpipe.output import write_atomically

_REFERENCE = "#/$defs/{model}"


def schema_of(kind: type[Settings]) -> dict[str, Any]:
    """Return the JSON schema of a model, with the options of all methods, scenes and drivers."""
    schema = kind.model_json_schema(ref_template=_REFERENCE)
    definitions = schema.get("$defs", {})
    for model in (SceneSettings, MethodSettings, ProjectorDriver, CameraDriver, RigDriver):
        if model.__name__ in definitions:
            describe = _by_driver if issubclass(model, DeviceDriver) else _by_name
            definitions[model.__name__] = describe(model, definitions)
    for node in definitions.values():  # the group itself says what it is for
        node.pop("description", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _defined(model: type[Settings], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a model, whose own definitions join the others."""
    described = model.model_json_schema(ref_template=_REFERENCE)
    for name, node in described.pop("$defs", {}).items():
        definitions.setdefault(name, node)
    return described


def _by_name(model: type[Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a section whose options depend on the name in it.

    Each option stands once, as it is for any name; a rule for each name lists its options.
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
        condition = {"properties": {"driver": {"const": name}}}  # which may be left out
        rules.append({"if": condition, "then": {"properties": {"options": reference}}})
    node["properties"]["options"] = {"type": "object", "description": "The driver's options."}
    return {**node, **({"allOf": rules} if rules else {})}


def generated() -> dict[str, str]:
    """Return the files that are made of the models, by name."""
    bench = BenchConfig()
    rig_of_bench = RigConfig(
        projector=ProjectorDriver.model_validate({"options": {"settle_seconds": 0}}),
        bench=bench,
        rays=bench.scene.shape,
        calibration="calibration",
        seconds_per_pattern=0.2,
    )
    note = "Made from the settings' models by `make config`"
    run, schema = Config.model_validate({"scenes": {"one": {"kind": "plane"}}}), "rig.schema.json"
    return {
        "config.schema.json": json.dumps(schema_of(Config), indent=2) + "\n",
        schema: json.dumps(schema_of(RigConfig), indent=2) + "\n",
        "all.yaml": _file_of(
            run,
            "config.schema.json",
            f"All settings of a run, at their defaults, with one plain scene. {note}; 'rfpipe "
            "settings scenes' and 'rfpipe settings methods' list those of each kind of scene and "
            "of each method.",
        ),
        "rig.yaml": _file_of(
            RigConfig(),
            schema,
            f"A rig: a window on the projector and a Basler camera. {note}: copy this file, change "
            "the copy and serve it with `rfpipe serve <copy>`.",
        ),
        "bench.yaml": _file_of(
            rig_of_bench,
            schema,
            "The optical bench in software: a rig without hardware, of a display in memory, a "
            f"scene and a real camera driver. {note}, as rig.yaml.",
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
        words, choices = str(field.description), [*map(str, _choices(field.annotation))]
        if not all(choice in words for choice in choices):
            words += f" One of {', '.join(choices)}."
        lines.append(_comment(words, margin))
        if isinstance(value, BaseModel):
            lines += [f"{margin}{name}:", *_yaml_lines(value, margin + "  ")]
        else:
            plain = settings.model_dump(mode="json", include={name})[name]
            text = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=10_000)
            lines.append(f"{margin}{name}: " + text.removesuffix("\n").removesuffix("\n..."))
        if not margin:
            lines.append("")
    return lines


def _choices(annotation: object) -> list[object]:
    """Return the values that a setting is one of, if it is."""
    within = get_args(annotation)
    if get_origin(annotation) is Literal:
        return list(within)
    return [choice for part in within for choice in _choices(part)]


if __name__ == "__main__":
    for _name, _text in generated().items():
        write_atomically(Path("config", _name), _text.encode())
