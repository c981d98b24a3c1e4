"""Reading YAML files of settings: what can't be meant is an error that names its line."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import yaml

from rfpipe.errors import ConfigError

_MORE_THAN_ONE_NUMBER = re.compile(r"[-+]?(0[0-9_]+|[0-9][0-9_]*(:[0-9]{1,2})+(\.[0-9_]*)?)")
"""Octal with a leading zero, and sixties with colons: 010 is 8 and 1:30 is 90 in YAML 1.1."""


def read_yaml(path: str | Path) -> object:
    """Read a YAML file.

    Raises
    ------
    ConfigError
        When it can't be read, is empty, isn't UTF-8 or YAML, has a key twice or one that is no
        text, or holds what may be meant as one of two numbers: with its place.
    """
    try:
        text = Path(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(
            f"{path}: can't be read as a settings file in the encoding UTF-8: {error}"
        ) from error
    try:
        data = parse_yaml(text)
    except (yaml.YAMLError, RecursionError, ValueError, OverflowError) as error:
        said = str(error).replace('"<unicode string>"', f'"{path}"')
        raise ConfigError(f"{path}: is not valid YAML: {said}") from error
    if data in (None, {}):
        raise ConfigError(f"{path}: is empty; expected 'key: value' lines, see config/README.md")
    return data


def parse_yaml(text: str) -> Any:
    """Read YAML as settings files have it; raises yaml.YAMLError with the place."""
    return yaml.load(text, Loader=_Loader)


class _Loader(yaml.SafeLoader):
    """YAML's safe loader, stricter."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key_node, _ in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                kind = "list" if isinstance(key_node, yaml.SequenceNode) else "group"
                raise _wrong(f"a key is a {kind}; expected a name", key_node.start_mark)
            key = key_node.value
            if key in seen:
                raise _wrong(f"the key {key!r} stands twice; remove one", key_node.start_mark)
            seen.add(key)
        return super().construct_mapping(node, deep)

    def checked_scalar(self, node: yaml.ScalarNode) -> Any:
        """Construct a number or a text, unless it could be meant as one of two numbers."""
        text = str(node.value)
        if node.style is None and _MORE_THAN_ONE_NUMBER.fullmatch(text):
            raise _wrong(
                f"{text} may be meant as one of two numbers: a leading 0 means octal in YAML, and "
                "colons sixties. Write a decimal number without them, or put it in quotes if it "
                "is a text",
                node.start_mark,
            )
        return yaml.SafeLoader.yaml_constructors[node.tag](self, node)


for _kind in ("int", "float", "str", "timestamp"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.checked_scalar)


def _wrong(what: str, mark: yaml.Mark | None) -> yaml.constructor.ConstructorError:
    return yaml.constructor.ConstructorError(None, None, what, mark)
