"""What the text of a cell means, by the setting that it is for."""

from __future__ import annotations

import functools
import re
from typing import Any, Literal, get_args, get_origin

import yaml

from rfpipe.config.collection.rows import Path_
from rfpipe.config.model import Config
from rfpipe.config.problems import field_at
from rfpipe.config.reading import parse_yaml

__all__ = ["meant"]

_NOTHING = ("null", "~")
_NUMBER = re.compile(r"[-+]?(0|[1-9][0-9]*)(\.[0-9]*)?([eE][-+]?[0-9]+)?")
_WITH_COMMA = re.compile(r"[-+]?[0-9]*,[0-9]+([eE][-+]?[0-9]+)?")
_BLANKS = re.compile(r"(?<=\d)\s*x\s*(?=\d)|[;\s]+")
_PARTS = re.compile(r"(?<=\d)\s*x\s*(?=\d)|[;,\s]+")


def meant(text: str, path: Path_, kind: object, *, comma: bool = False) -> Any:
    """Read a cell as what the setting that it is for expects.

    Parameters
    ----------
    text : str
        ``null`` means that; what begins with a bracket is YAML, as in ``[62, 70]``. A setting that
        is a list takes its parts with x, blanks, commas or semicolons between them, as in
        ``62 x 70`` or ``white texture``. What is only to be known of a scene is the text itself.
    path : tuple of str
        Of the setting among those of a scene.
    kind : object
        The scene's kind, whose options are known.
    comma : bool
        Whether 0,5 means a half where a number is expected.

    Raises
    ------
    ValueError
        When brackets aren't YAML, or a comma in a list may be that of a number.
    """
    if path[:1] == ("about",) and len(path) > 1:
        return text  # as it stands: titles may well begin with a bracket
    if text in _NOTHING:
        return None
    if text.startswith(("[", "{")):
        try:
            return parse_yaml(text)
        except yaml.YAMLError as error:
            said = " ".join(str(error).split())
            raise ValueError(f"{text[:60]} is not valid YAML: {said[:200]}") from None
    expected = _expected(path, str(kind))
    if "list" in expected:
        if comma:
            text = _with_points(text, reals="reals" in expected)
        return [_number(part) for part in _PARTS.split(text) if part]
    if comma and "number" in expected and _WITH_COMMA.fullmatch(text):
        text = text.replace(",", ".")
    return text if "text" in expected else _number(text)


def _with_points(text: str, *, reals: bool) -> str:
    """Write decimal points in place of commas where these part no numbers: 0,1 0,5 has two.

    Raises
    ------
    ValueError
        When 1,5 may be one number or two.
    """
    parted = [part for part in _BLANKS.split(text) if part]
    if len(parted) > 1 and all(_NUMBER.fullmatch(p) or _WITH_COMMA.fullmatch(p) for p in parted):
        return " ".join(parted).replace(",", ".")
    if reals and _WITH_COMMA.fullmatch(text):
        one, two = text.replace(",", "."), text.replace(",", " ")
        raise ValueError(f"{text} may be one number or two; write {one}, or {two}")
    return text


def _number(text: str) -> int | float | str:
    found = _NUMBER.fullmatch(text)
    if not found:
        return text
    return float(text) if found[2] or found[3] else int(text)


@functools.cache
def _expected(path: Path_, kind: str) -> frozenset[str]:
    """Tell what a setting takes: "list", "number" or "text"."""
    if path[:1] == ("settings",):
        model, _ = field_at(Config, path[1:-1], {})
    else:
        location = ("scenes", "scene", *path[:-1])
        model, _ = field_at(Config, location, {"scenes": {"scene": {"kind": kind}}})
    field = model.model_fields.get(path[-1]) if path else None
    return frozenset(_kinds(field.annotation)) if field else frozenset({"number"})


def _kinds(annotation: object) -> set[str]:
    if annotation is str:
        return {"text"}
    if annotation in (int, float):
        return {"number"}
    origin = get_origin(annotation)
    if origin in (tuple, list):
        inner = {kind for each in get_args(annotation) for kind in _types(each)}
        return {"list", "reals"} if float in inner else {"list"}
    if origin is Literal:
        return {"text" if isinstance(it, str) else "number" for it in get_args(annotation)}
    return {kind for inner in get_args(annotation) for kind in _kinds(inner)}


def _types(annotation: object) -> set[object]:
    """Return the types that an annotation consists of."""
    return {annotation}.union(*(_types(each) for each in get_args(annotation)))
