"""JSON schemas of settings, for editors, and all settings as commented YAML.

``python -m rfpipe.config.schema`` writes what is made of the models into the folder ``config``.
"""

from __future__ import annotations

import json
import textwrap
from collections import Counter
from pathlib import Path
from typing import Any

import yaml
from pydantic import BaseModel

from rfpipe import plugins
from rfpipe.config.base import Described, MethodSettings, Settings
from rfpipe.config.devices import BenchConfig, RigConfig
from rfpipe.config.drivers import DeviceDriver, ProjectorDriver
from rfpipe.config.model import Config

_REFERENCE = "#/$defs/{model}"


def schema_of(kind: type[Settings]) -> dict[str, Any]:
    """Return the JSON schema of a model, with the options of all methods, scenes and drivers."""
    schema = kind.model_json_schema(ref_template=_REFERENCE)
    definitions = schema.get("$defs", {})
    models = {model.__name__: model for model in _descendants(Settings)}
    for name in list(definitions):
        model = models.get(name)
        if model is not None and Described in model.__bases__:
            definitions[name] = _by_name(model, definitions)
        elif model is not None and issubclass(model, DeviceDriver):
            _describe_drivers(definitions[name], model, definitions)
    _limit_methods(schema)
    for node in definitions.values():  # the group itself says what it is for
        node.pop("description", None)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _descendants(model: type[Settings]) -> list[type[Settings]]:
    children = model.__subclasses__()
    return children + [found for child in children for found in _descendants(child)]


def _defined(model: type[Settings], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a model, whose own definitions join the others."""
    described = model.model_json_schema(ref_template=_REFERENCE)
    for name, node in described.pop("$defs", {}).items():
        definitions.setdefault(name, node)
    return described


def _by_name(model: type[Any], definitions: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a section whose options depend on the name in it.

    An option that is the same for all names that have it stands once, another one in a rule for the
    names that share it; a rule for each name lists all of its options.
    """
    names = plugins.names(model.group)
    schemas = {name: _defined(model.model_of(name), definitions) for name in names}
    variants: dict[tuple[str, str], list[str]] = {}
    for name, schema in schemas.items():
        for option, node in schema["properties"].items():
            variants.setdefault((option, json.dumps(node, sort_keys=True)), []).append(name)
    options = Counter(option for option, _ in variants)
    shared, rules = {}, []
    for (option, node), having in variants.items():
        if options[option] == 1:
            shared[option] = json.loads(node)
        elif option != model.key:
            rules.append(_rule(model.key, having, {"properties": {option: json.loads(node)}}))
    shared[model.key] = model.model_json_schema()["properties"][model.key] | {
        "anyOf": [{"enum": list(names)}, {"pattern": ":"}]
    }
    for name, schema in schemas.items():
        then = {"propertyNames": {"enum": sorted(schema["properties"])}}
        if schema.get("required"):
            then["required"] = schema["required"]
        rules.append(_rule(model.key, [name], then))
    required = {"required": [model.key]} if model is not MethodSettings else {}
    return {"type": ["object", "null"], "properties": shared, "allOf": rules, **required}


def _limit_methods(node: Any) -> None:
    """Say which options each method has, where sections are called by the methods' names."""
    if isinstance(node, list):
        for each in node:
            _limit_methods(each)
    elif isinstance(node, dict):
        for section in node.get("patternProperties", {}).values():
            if section == {"$ref": _REFERENCE.format(model="MethodSettings")}:
                node["properties"] = {
                    name: {"propertyNames": {"enum": [*MethodSettings.model_of(name).model_fields]}}
                    for name in plugins.names(plugins.METHODS)
                }
        for each in node.values():
            _limit_methods(each)


def _rule(key: str, names: list[str], then: dict[str, Any]) -> dict[str, Any]:
    """Return what holds where a key has one of some values."""
    return {"if": {"properties": {key: {"enum": names}}, "required": [key]}, "then": then}


def _describe_drivers(
    node: dict[str, Any], model: type[DeviceDriver], definitions: dict[str, Any]
) -> None:
    """Say what options a driver has, by the names that are installed."""
    rules = []
    for name in plugins.names(model.group):
        options = model.options_model(name)
        definitions[options.__name__] = _defined(options, definitions)
        reference = {"$ref": _REFERENCE.format(model=options.__name__)}
        asked = {"properties": {"driver": {"const": name}}}  # which may be left out
        rules.append({"if": asked, "then": {"properties": {"options": reference}}})
    node["properties"]["options"] = {"type": "object", "description": "The driver's options."}
    if rules:
        node["allOf"] = rules


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
    made = "Made from the settings' models by `make config`"
    run, schema = Config.model_validate({"scenes": {"one": {"kind": "plane"}}}), "rig.schema.json"
    return {
        "config.schema.json": json.dumps(schema_of(Config), indent=2) + "\n",
        schema: json.dumps(schema_of(RigConfig), indent=2) + "\n",
        "all.yaml": _file_of(
            run,
            "config.schema.json",
            f"All settings of a run, at their defaults, with one plain scene. {made}; 'rfpipe "
            "settings scenes' and 'rfpipe settings methods' list those of each kind of scene and "
            "of each method.",
        ),
        "rig.yaml": _file_of(
            RigConfig(),
            schema,
            f"A rig: a window on the projector and a Basler camera. {made}: copy this file, change "
            "the copy and serve it with `rfpipe serve <copy>`.",
        ),
        "bench.yaml": _file_of(
            rig_of_bench,
            schema,
            "The optical bench in software: a rig without hardware, of a display in memory, a "
            f"scene and a real camera driver. {made}, as rig.yaml.",
        ),
    }


def _file_of(settings: Settings, schema: str, head: str) -> str:
    """Return settings as YAML under a head of comments."""
    lines = [f"# yaml-language-server: $schema={schema}", _comment(head, ""), ""]
    return "\n".join([*lines, *_yaml_lines(settings, "")])


def _comment(text: object, margin: str) -> str:
    return textwrap.fill(
        str(text), 98, initial_indent=f"{margin}# ", subsequent_indent=f"{margin}# "
    )


def _yaml_lines(settings: BaseModel, margin: str) -> list[str]:
    """Lines of a model's settings, with their descriptions as comments."""
    lines: list[str] = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        lines.append(_comment(field.description, margin))
        if isinstance(value, BaseModel):
            lines += [f"{margin}{name}:", *_yaml_lines(value, margin + "  ")]
        else:
            plain = settings.model_dump(mode="json", include={name})[name]
            text = yaml.safe_dump(plain, default_flow_style=True, sort_keys=False, width=10_000)
            lines.append(f"{margin}{name}: " + text.removesuffix("\n").removesuffix("\n..."))
        if not margin:
            lines.append("")
    return lines


if __name__ == "__main__":
    for _name, _text in generated().items():
        Path("config", _name).write_text(_text, encoding="utf-8")
