"""All settings of a run in tables of Markdown: names, defaults and meanings, from their models."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import to_jsonable_python

from rfpipe import plugins
from rfpipe.config.base import Described, MethodSettings
from rfpipe.config.files import flow
from rfpipe.config.model import Config
from rfpipe.config.problems import model_within
from rfpipe.config.scenes import SceneSettings

_BEGIN, _END = "<!-- Made by `make config`. -->\n", "<!-- So far. -->\n"

Row = tuple[str, str, str]
"""Name, default and meaning of a setting."""


def listed() -> str:
    """Return every setting in tables: those of a run by group, of scenes by kind, of methods."""
    groups = {name: _group(field) for name, field in Config.model_fields.items()}
    own = {name: field for name, field in Config.model_fields.items() if groups[name] is None}
    parts = [_table("Of the run", _rows(own))]
    for name, model in groups.items():
        if model is not None:
            said = str(Config.model_fields[name].description)
            parts.append(_table(f"`{name}`", _rows(model.model_fields), said))
    for about, settings in (("a scene", SceneSettings), ("a method", MethodSettings)):
        name = f"{about.split()[1]}s"
        shared = _rows(settings.model_fields)
        parts.append(_table(f"`{name}`: of {about}", shared, "Under the name of each."))
        parts.append(_of_each(f"`{name}`: by `{settings.key}`", settings))
    return "\n".join(parts)


def with_listing(text: str) -> str:
    """Return a page with the tables between its two marks as they should be."""
    before, _, rest = text.partition(_BEGIN)
    _, _, after = rest.partition(_END)
    return f"{before}{_BEGIN}\n{listed()}\n{_END}{after}"


def _group(field: FieldInfo) -> type[BaseModel] | None:
    """Return the model of a field that is a group of settings, not many by names of their own."""
    model = model_within(field)
    return None if model is None or issubclass(model, Described) else model


def _rows(fields: Mapping[str, FieldInfo], within: str = "") -> Iterator[Row]:
    """Yield the settings of a model, and those of models in it, with the path to each."""
    for name, field in fields.items():
        default = "needed" if field.is_required() else _plain(field)
        yield f"{within}{name}", default, str(field.description)
        inner = _group(field)
        if inner is not None:
            yield from _rows(inner.model_fields, f"{within}{name}.")


def _plain(field: FieldInfo) -> str:
    """Return a default as YAML has it; of sections, their names."""
    value = field.get_default(call_default_factory=True)
    if isinstance(value, dict) and all(isinstance(each, Described) for each in value.values()):
        value = {name: {} for name in value}
    return f"`{flow(to_jsonable_python(value))}`"


def _of_each(title: str, settings: type[Described]) -> str:
    """Return a table of the options that not all have, those that are the same once."""
    having: dict[Row, list[str]] = {}
    for name in plugins.names(settings.group):
        fields = settings.model_of(name).model_fields
        own = {key: fields[key] for key in fields if key not in settings.model_fields}
        for row in _rows(own):
            having.setdefault(row, []).append(f"`{name}`")
    rows = sorted(having.items(), key=lambda each: (-len(each[1]), each[1]))
    return _table(title, ((*row, _some(names)) for row, names in rows))


def _table(title: str, rows: Iterable[tuple[str, ...]], said: str = "") -> str:
    """Return a table under a title."""
    lines = [f"### {title}", "", *([said, ""] if said else [])]
    found = list(rows)
    columns = ("setting", "default", "meaning", "of")[: len(found[0])]
    lines += [_line(columns), _line("---" for _ in columns)]
    lines += [_line((f"`{name}`", *rest)) for name, *rest in found]
    return "\n".join([*lines, ""])


def _line(cells: Iterable[str]) -> str:
    return " | ".join(["", *(cell.replace("|", "\\|") for cell in cells), ""]).strip()


def _some(names: list[str]) -> str:
    """Name some, and count those beyond four."""
    more = len(names) - 4
    return ", ".join(names) if more < 1 else f"{', '.join(names[:4])} and {more} more"
