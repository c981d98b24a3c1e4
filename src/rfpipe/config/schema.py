"""JSON schemas of settings, for editors that check and complete YAML."""

from __future__ import annotations

from typing import Any

from rfpipe import plugins
from rfpipe.config.base import SectionsOf, Settings
from rfpipe.config.drivers import DeviceDriver

__all__ = ["schema_of"]

_REFERENCE = "#/$defs/{model}"


def schema_of(kind: type[Settings]) -> dict[str, Any]:
    """Return the JSON schema of a model, with those of all that is installed and describes itself.

    Parameters
    ----------
    kind : type of Settings
    """
    schema = kind.model_json_schema(ref_template=_REFERENCE)
    models = [(schema, kind), *_inner(schema)]
    for node, model in models:
        if issubclass(model, DeviceDriver):
            _describe_drivers(schema, node, model)
        for name, field in model.model_fields.items():
            for mark in field.metadata:
                if isinstance(mark, SectionsOf):
                    _describe(schema, node["properties"][name], mark)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _inner(schema: dict[str, Any]) -> list[tuple[dict[str, Any], Any]]:
    """Return the definitions in a model's schema with the models that they are of."""
    definitions = schema.get("$defs", {})
    known = {model.__name__: model for model in _descendants(Settings)}
    return [(node, known[name]) for name, node in definitions.items() if name in known]


def _descendants(model: type[Settings]) -> list[type[Settings]]:
    children = model.__subclasses__()
    return children + [found for child in children for found in _descendants(child)]


def _describe_drivers(
    schema: dict[str, Any], node: dict[str, Any], model: type[DeviceDriver]
) -> None:
    """Say what options a driver has, by the names that are installed."""
    rules = []
    for name in plugins.names(model.group):
        options = model.options_model(name)
        described = options.model_json_schema(ref_template=_REFERENCE)
        schema["$defs"] |= described.pop("$defs", {})
        schema["$defs"][options.__name__] = described
        then = {"properties": {"options": {"$ref": _REFERENCE.format(model=options.__name__)}}}
        rules.append({"if": {"properties": {"driver": {"const": name}}}, "then": then})
    node["properties"]["options"] = {"type": "object", "description": "The driver's options."}
    if rules:
        node["allOf"] = rules


def _describe(schema: dict[str, Any], node: dict[str, Any], mark: SectionsOf) -> None:
    """Say what sections there may be, by the names that are installed."""
    sections: dict[str, Any] = {}
    definitions = schema.setdefault("$defs", {})
    for name in plugins.names(mark.model.group):
        model = mark.model.model_of(name)
        described = model.model_json_schema(ref_template=_REFERENCE)
        definitions |= described.pop("$defs", {})
        definitions[model.__name__] = described
        sections[name] = {"$ref": _REFERENCE.format(model=model.__name__)}
    if mark.partial:
        sections = {name: {"anyOf": [it, {"type": "null"}]} for name, it in sections.items()}
    own = {"type": "object", "required": [mark.model.key]}
    groups = [node, *node.get("anyOf", [])]
    for group in groups:
        if group.get("type") == "object":
            group.pop("patternProperties", None)
            group |= {"properties": sections, "additionalProperties": own}
