"""Settings files: YAML in, commented YAML and JSON schema out, and errors that say what to do."""

from __future__ import annotations

import difflib
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args

import yaml
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from rfpipe.config.base import Settings
from rfpipe.config.devices import BenchConfig, RigConfig, WindowConfig
from rfpipe.config.model import Config
from rfpipe.errors import ConfigError

__all__ = [
    "bench_yaml",
    "default_yaml",
    "json_schema",
    "load_config",
    "load_rig_config",
    "parse_config",
    "parse_rig_config",
    "rig_json_schema",
    "rig_yaml",
]

SCHEMA_NAME = "config.schema.json"
RIG_SCHEMA_NAME = "rig.schema.json"

_WIDTH = 98

_S = TypeVar("_S", bound=Settings)


def load_config(path: str | Path) -> Config:
    """Read the settings of a run.

    Parameters
    ----------
    path
        A YAML file. Keys left out have their defaults.

    Raises
    ------
    ConfigError
        When the file can't be read or isn't YAML, and for every unknown key, wrong type and
        value out of range: with the file, the key, the value and what was expected.
    """
    return parse_config(_read(path), str(path))


def parse_config(data: object, source: str) -> Config:
    """Check settings that are already in memory.

    Parameters
    ----------
    data
        A mapping as YAML gives it.
    source
        Where the settings came from, for messages.

    Raises
    ------
    ConfigError
        As for `load_config`.
    """
    return _parsed(Config, data, source)


def load_rig_config(path: str | Path) -> RigConfig:
    """Read the settings of a rig; errors as `load_config`."""
    return parse_rig_config(_read(path), str(path))


def parse_rig_config(data: object, source: str) -> RigConfig:
    """Check settings of a rig that are already in memory; errors as `load_config`."""
    return _parsed(RigConfig, data, source)


def json_schema() -> dict[str, Any]:
    """JSON schema of a settings file, for editors that check and complete YAML."""
    return _schema_of(Config)


def rig_json_schema() -> dict[str, Any]:
    """JSON schema of a rig's settings file."""
    return _schema_of(RigConfig)


def default_yaml() -> str:
    """Return the default settings as YAML, each with its description as a comment."""
    head = (
        "# The default run. Made from the settings' model by `make config`: change the model, or",
        "# copy this file, change the copy and run it with `snakemake --configfile <copy>`.",
    )
    return _file_of(Config(), SCHEMA_NAME, head)


def rig_yaml() -> str:
    """Return the default rig, a window and a Basler camera, as commented YAML."""
    head = (
        "# A rig: a window on the projector and a Basler camera. Made from the settings' model by",
        "# `make config`: copy this file, change the copy and serve it with `rfpipe serve <copy>`.",
    )
    return _file_of(RigConfig(), RIG_SCHEMA_NAME, head)


def bench_yaml() -> str:
    """Return the optical bench in software with its defaults as commented YAML."""
    head = (
        "# The optical bench in software: a rig without hardware, of a real window, X server and",
        "# camera driver. Made from the settings' model by `make config`, as rig.yaml.",
    )
    bench = BenchConfig()
    bench_rig = RigConfig(
        projector=WindowConfig(settle_seconds=0),
        bench=bench,
        rays=bench.scene.shape,
        calibration="calibration",
        seconds_per_pattern=0.2,
    )
    return _file_of(bench_rig, RIG_SCHEMA_NAME, head)


def _read(path: str | Path) -> object:
    """Read a YAML file; an empty one is no settings."""
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: can't be read as a settings file: {error}") from error
    try:
        data = yaml.load(text, Loader=_UniqueKeyLoader)
    except yaml.YAMLError as error:
        raise ConfigError(f"{path}: is not valid YAML: {error}") from error
    return {} if data is None else data


def _parsed(kind: type[_S], data: object, source: str) -> _S:
    """Check settings, and say every mistake in them."""
    if not isinstance(data, Mapping):
        raise ConfigError(
            f"{source}: holds {_shown(data)}; expected 'key: value' lines with the keys "
            f"{', '.join(kind.model_fields)}"
        )
    try:
        return kind.model_validate(dict(data))
    except ValidationError as error:
        problems = error.errors(include_url=False, include_context=False)
        # a list with a wrong item is reported as wrong itself, too: keep the innermost
        outer = {problem["loc"][:n] for problem in problems for n in range(len(problem["loc"]))}
        lines = [
            f"{source}: {_explained(kind, problem)}"
            for problem in problems
            if problem["loc"] not in outer
        ]
        raise ConfigError("\n".join(lines)) from None


def _schema_of(kind: type[Settings]) -> dict[str, Any]:
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **kind.model_json_schema(),
    }


def _file_of(settings: Settings, schema: str, head: Sequence[str]) -> str:
    """Write settings as YAML under a head of comments."""
    lines = [f"# yaml-language-server: $schema={schema}", *head, ""]
    return "\n".join([*lines, *_yaml_lines(settings, 0, commented=True)]) + "\n"


class _UniqueKeyLoader(yaml.SafeLoader):
    """YAML's safe loader, but a key that stands twice is an error instead of the last one."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            key = key_node.value
            if key in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key!r} stands twice; remove one", key_node.start_mark
                )
            seen.add(key)
        return super().construct_mapping(node, deep)


def _shown(value: object) -> str:
    """Show a value as YAML would, short enough for a message."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return str(value).lower()
    return textwrap.shorten(repr(value), 80, placeholder=" ...")


def _explained(kind: type[Settings], problem: Mapping[str, Any]) -> str:
    """Say one of pydantic's problems as: key, value, what was expected, what the key means."""
    location: tuple[str | int, ...] = tuple(part for part in problem["loc"] if part != "[key]")
    key = _dotted(location)
    model, field = _at(kind, location)
    if problem["type"] == "extra_forbidden":
        return _unknown_key(location, model)
    meaning = f" ({key}: {field.description})" if field is not None else ""
    if problem["type"] == "missing":
        return f"{key} is missing; add it.{meaning}"
    expected = problem["msg"].removeprefix("Value error, ").removesuffix(" after validation")
    if problem["type"] != "value_error":
        expected = expected[expected.find("should") :]  # without "Input", "String", "Tuple"
    if problem["type"] in ("model_type", "dict_type"):
        expected = "should be a group of 'key: value' settings"
    if problem["type"] == "value_error" and not expected.startswith("should"):
        # a rule between settings names them and their values itself
        return f"{key}: {expected}" if key else expected
    return f"{key} is {_shown(problem['input'])}; it {expected}.{meaning}"


def _unknown_key(location: tuple[str | int, ...], model: type[BaseModel]) -> str:
    unknown = str(location[-1])
    known = list(model.model_fields)
    close = difflib.get_close_matches(unknown, known, n=1)
    suggestion = f"did you mean {close[0]}? " if close else ""
    return f"{_dotted(location)} is unknown; {suggestion}Known here: {', '.join(known)}."


def _dotted(location: Sequence[str | int]) -> str:
    """Join a location's parts: ("camera", "exposures", 0) is camera.exposures[0]."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in location)
    return text.removeprefix(".")


def _at(
    kind: type[Settings], location: Sequence[str | int]
) -> tuple[type[BaseModel], FieldInfo | None]:
    """Find the innermost model that a location passes through, and the last field in it."""
    model: type[BaseModel] = kind
    field: FieldInfo | None = None
    for part in location:
        found = model.model_fields.get(str(part))
        if found is None:  # a scene's name, a list's index or an unknown key
            continue
        field = found
        model = _model_within(found.annotation) or model
    return model, field


def _model_within(annotation: object) -> type[BaseModel] | None:
    """Find the settings model inside a field's type, such as ``dict[str, SceneConfig]``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    return next(filter(None, map(_model_within, get_args(annotation))), None)


def _yaml_lines(settings: BaseModel, indent: int, *, commented: bool) -> list[str]:
    """Lines of a model's settings, with their descriptions as comments when asked for."""
    margin = " " * indent
    lines: list[str] = []
    for name, field in type(settings).model_fields.items():
        value = getattr(settings, name)
        if commented:
            lines += textwrap.wrap(
                str(field.description),
                _WIDTH,
                initial_indent=f"{margin}# ",
                subsequent_indent=f"{margin}# ",
            )
        if isinstance(value, BaseModel):
            lines.append(f"{margin}{name}:")
            lines += _yaml_lines(value, indent + 2, commented=commented)
        elif isinstance(value, dict) and _has_groups(field):
            lines.append(f"{margin}{name}:")
            for position, (entry, inner) in enumerate(value.items()):
                lines.append(f"{margin}  {entry}:")
                # the keys of entries are the same: comments at the first will do
                lines += _yaml_lines(inner, indent + 4, commented=commented and position == 0)
        else:
            plain = settings.model_dump(mode="json", include={name})[name]
            lines.append(f"{margin}{name}: {_flow(plain)}")
        if indent == 0:
            lines.append("")
    return lines if indent else lines[:-1]


def _has_groups(field: FieldInfo) -> bool:
    """Whether a field's values are groups of settings by name."""
    return _model_within(field.annotation) is not None


def _flow(value: object) -> str:
    """Write a plain value on one line of YAML."""
    text = yaml.safe_dump(value, default_flow_style=True, width=10_000)
    return text.removesuffix("\n").removesuffix("\n...")
