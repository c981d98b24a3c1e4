"""Reading a collection from a YAML file."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from rfpipe.config.collection.rows import Path_, Row, refused, target_of
from rfpipe.config.reading import read_yaml
from rfpipe.errors import ConfigError

__all__ = ["read_yaml_rows"]

_KEYS = {"defaults", "scenes"}


def read_yaml_rows(path: Path) -> list[Row]:
    """Read the rows of a YAML file: a list of scenes, or ``{defaults: ..., scenes: [...]}``.

    A scene's settings may be written as groups or by dotted paths, as in CSV. What a scene doesn't
    set, the defaults do.

    Raises
    ------
    ConfigError
        When it isn't readable, or holds something else: with line and column.
    """
    data: Any = read_yaml(path)
    node: Any = yaml.compose(path.read_text(encoding="utf-8-sig"), Loader=yaml.SafeLoader)
    defaults: dict[Path_, object] = {}
    places: dict[Path_, str] = {}
    if isinstance(data, Mapping):
        nodes = {key.value: (key, value) for key, value in node.value}
        strange = [key for key in data if key not in _KEYS]
        if strange or not isinstance(data.get("defaults", {}), Mapping):
            at = _place(nodes[strange[0] if strange else "defaults"][0])
            raise refused(
                path, [(at, "expected a list 'scenes', and a group 'defaults' if there are any")]
            )
        if data.get("defaults"):
            defaults = _paths(data["defaults"])
            places = dict(_places(nodes["defaults"][1], ()))
        data = data.get("scenes", [])
        node = nodes["scenes"][1] if "scenes" in nodes else None
    if not isinstance(data, list):
        raise ConfigError(f"{path}: expected a list of scenes, such as '- name: bowl' and so on")
    rows, problems = [], []
    for entry, inner in zip(data, node.value if data else (), strict=True):
        if not isinstance(entry, Mapping):
            problems.append((_place(inner), "expected a group of settings, such as name: bowl"))
            continue
        own = dict(_places(inner, ()))
        at = f"line {inner.start_mark.line + 1}"
        values = _paths(entry)
        problems.extend((own[path], what) for path, what in _twice(values))
        rows.append(Row(at, {**defaults, **values}, {**places, **own}))
    if problems:
        raise refused(path, problems)
    return rows


def _paths(settings: Mapping[str, Any]) -> dict[Path_, object]:
    """Return values by paths, of groups as well, so that one default of a group can be another."""
    found: dict[Path_, object] = {}
    for key, value in settings.items():
        path = tuple(str(key).split("."))
        if isinstance(value, Mapping) and value and path != ("methods",):
            found |= {(*path, *inner): it for inner, it in _paths(value).items()}
        else:
            found[path] = value
    return found


def _twice(paths: Iterable[Path_]) -> Iterator[tuple[Path_, str]]:
    """Yield paths that stand for the same setting as one before, and what is wrong with that."""
    known: dict[Path_, Path_] = {}
    for path in paths:
        first = known.setdefault(target_of(path), path)
        if first != path:
            yield path, f"sets what {'.'.join(first)} does; remove one"


def _places(node: yaml.Node, path: Path_) -> Iterator[tuple[Path_, str]]:
    if isinstance(node, yaml.MappingNode):
        for key, value in node.value:
            inner = (*path, *str(key.value).split("."))
            yield inner, f"{_place(key)} ({'.'.join(inner)})"
            yield from _places(value, inner)


def _place(node: yaml.Node) -> str:
    mark = node.start_mark
    return f"line {mark.line + 1}, column {mark.column + 1}"
