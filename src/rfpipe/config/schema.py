"""JSON schemas of settings, for editors that check and complete YAML."""

from __future__ import annotations

from typing import Any

from rfpipe import plugins
from rfpipe.config.base import Described, SectionsOf, Settings
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
    for node, model in _inner(schema):
        if issubclass(model, Described) and model.model_fields[model.key].is_required():
            _choose(schema, node, model)
    models = [(schema, kind), *_inner(schema)]
    for node, model in models:
        if issubclass(model, DeviceDriver):
            _describe_drivers(schema, node, model)
        for name, field in model.model_fields.items():
            for mark in field.metadata:
                if isinstance(mark, SectionsOf) and name in node.get("properties", {}):
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
        options = _defined(schema, model.options_model(name))
        rules.append(_rule("driver", name, {"properties": {"options": options}}))
    node["properties"]["options"] = {"type": "object", "description": "The driver's options."}
    if rules:
        node["allOf"] = rules


def _defined(schema: dict[str, Any], model: type[Settings]) -> dict[str, Any]:
    """Add a model to the schema's definitions; return the reference to it."""
    definitions = schema.setdefault("$defs", {})
    described = model.model_json_schema(ref_template=_REFERENCE)
    definitions |= described.pop("$defs", {})
    definitions[model.__name__] = described
    return {"$ref": _REFERENCE.format(model=model.__name__)}


def _rule(key: str, name: str, then: dict[str, Any]) -> dict[str, Any]:
    """Say what holds where a key has a value."""
    return {"if": {"properties": {key: {"const": name}}}, "then": then}


def _choose(schema: dict[str, Any], node: dict[str, Any], model: type[Described]) -> None:
    """Say what a section holds by the name that it says: any installed one, or a path."""
    installed = plugins.names(model.group)
    key = node["properties"][model.key]
    rules = [_rule(model.key, name, _defined(schema, model.model_of(name))) for name in installed]
    said = {"anyOf": [{"enum": list(installed)}, {"pattern": ":"}]}
    node.clear()
    node |= {
        "type": "object",
        "description": model.__doc__.splitlines()[0] if model.__doc__ else "",
        "properties": {model.key: key | said},
        "required": [model.key],
        "allOf": rules,
    }


def _describe(schema: dict[str, Any], node: dict[str, Any], mark: SectionsOf) -> None:
    """Say what sections there may be, by the names that are installed."""
    installed = plugins.names(mark.model.group)
    sections = {name: _defined(schema, mark.model.model_of(name)) for name in installed}
    if mark.partial:
        sections = {name: {"anyOf": [it, {"type": "null"}]} for name, it in sections.items()}
    own = {"type": "object", "required": [mark.model.key]}
    for group in (node, *node.get("anyOf", [])):
        if group.get("type") == "object":
            group.pop("patternProperties", None)
            group |= {"properties": sections, "additionalProperties": own}
