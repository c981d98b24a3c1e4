"""Pages of the site that are made of code: the gallery, and the reference."""

from __future__ import annotations

import ast
import html
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import typer
from figures.index import ORDER
from pydantic import BaseModel
from pydantic.fields import FieldInfo
from pydantic_core import to_json
from typer.cli import get_docs_for_click

import rfpipe
from rfpipe import plugins
from rfpipe.cli import app
from rfpipe.config import SceneSettings
from rfpipe.config.devices import RigConfig
from rfpipe.config.drivers import CameraDriver, ProjectorDriver
from rfpipe.config.model import Config
from rfpipe.config.schema import description_of
from rfpipe.methods import get_method, method_names

PACKAGES = {
    "rfpipe": ("rfpipe.stages.acquire.AcquisitionResult",),
    "rfpipe.transport": (
        "rfpipe.transport.correspondence.Correspondence",
        "rfpipe.transport.compensation.Compensation",
        "rfpipe.transport.separation.Separation",
        "rfpipe.transport.normals.Normals",
    ),
    "rfpipe.methods": (),
    "rfpipe.scenes": (),
    "rfpipe.rigs": (),
    "rfpipe.photometry": (),
    "rfpipe.fitting": (),
    "rfpipe.export": (),
    "rfpipe.pictures": (),
    "rfpipe.store": (),
    "rfpipe.viewer": (),
    "rfpipe.testing": (),
    "rfpipe.errors": (),
}
"""Public packages of the reference, with further classes that their functions return."""

MODELS = (
    "rfpipe.methods.near_far.model",
    "rfpipe.methods.footprints.model",
    "rfpipe.methods.residual.model",
    "rfpipe.methods.multiplexed.fit",
    "rfpipe.methods.symmetric",
    "rfpipe.methods.error_estimate",
    "rfpipe.lights.shading",
    "rfpipe.lights.interpolation",
    "rfpipe.scenes.radiosity",
    "rfpipe.scenes.lenses",
    "rfpipe.scenes.noncoaxial",
)
"""Modules whose docstrings have the equations of a model."""

DRAWN_BY = {
    "light_field": "fig_5_8_a.png",
    "methods": "method_*.png",
    "opening": "bottle.png",
}
"""Pictures in docs/images of scripts in figures, which other pages show."""


def write(root: Path, folder: Path) -> None:
    """Write all generated pages; a page that didn't change keeps its time.

    Parameters
    ----------
    root : Path
        Folder of the repository.
    folder : Path
        Folder of the generated pages, ``docs/site/generated``.
    """
    pages = {"commands.md": _commands(), "settings.md": _settings(), "models.rst": _models()}
    pages |= dict(_packages())
    pages |= dict(_gallery(root))
    folder.mkdir(exist_ok=True)
    for path in set(folder.iterdir()) - {folder / name for name in pages}:
        path.unlink()
    for name, text in pages.items():
        path = folder / name
        if not path.exists() or path.read_text("utf-8") != text:
            path.write_text(text, "utf-8")


def _commands() -> str:
    """Return the page of all commands, from the command line's own help."""
    command = typer.main.get_command(app)
    text = get_docs_for_click(obj=command, ctx=typer.Context(command), name="rfpipe")
    text = text.replace("&#x27;", "'").replace("&quot;", '"')
    text = re.sub(r"^ {2,}(?=\S)", lambda margin: "  " + margin[0], text, flags=re.M)  # tables
    # the list of commands, whose summaries are truncated
    text = re.sub(r"^\*\*Commands\*\*:\n\n(\* .*\n)+\n", "", text, flags=re.M)
    return text.replace("# `rfpipe`", "# Commands", 1)


def _settings() -> str:
    """Return the page of all settings, from their models."""
    run = Config.model_validate({"scenes": {"one": {"kind": "plane"}}})
    lines = [
        "# All settings",
        "[Settings](../../../config/README.md) explains how a run uses them. Defaults are in YAML.",
        "## A run",
        *_sections(run, "###"),
        "## Kinds of scenes",
        "Options of every kind:",
        *_table(_rows(SceneSettings)),
    ]
    common = dict(_rows(SceneSettings))
    for name in plugins.names(plugins.SCENES):
        kind = plugins.find(plugins.SCENES, name)
        rows = [row for row in _rows(SceneSettings.model_of(name)) if row[0] not in common]
        lines += [
            f"### Scene `{name}`",
            f"{(kind.__doc__ or '').partition('.')[0]}.",
            *_table(rows),
        ]
    lines.append("## Methods")
    for name in method_names():
        method = get_method(name)
        rig = "coaxial rigs" if method.needs_coaxial_rig else "any rig"
        lines += [f"### Method `{name}`", f"{method.title}, for {rig}.",
                  *_table(_rows(method.Options))]  # fmt: skip
    lines += ["## A rig", *_sections(RigConfig(), "###"), "## Drivers"]
    for title, driver in (("Projector", ProjectorDriver), ("Camera", CameraDriver)):
        for name in plugins.names(driver.group):
            rows = _rows(driver.options_model(name))
            lines += [f"### {title} `{name}`", *_table(rows)]
    return "\n\n".join(lines) + "\n"


def _sections(settings: BaseModel, marks: str) -> Iterator[str]:
    """Yield the tables of a model, those of its sections under headings."""
    fields = type(settings).model_fields
    sections = {
        name: value for name in fields if isinstance(value := getattr(settings, name), BaseModel)
    }
    yield from _table(row for row in _rows(type(settings)) if row[0] not in sections)
    for name, section in sections.items():
        yield f"{marks} `{name}`"
        yield description_of(fields[name])
        yield from _sections(section, marks + "#")


def _rows(model: type[BaseModel]) -> Iterator[tuple[str, FieldInfo]]:
    yield from model.model_fields.items()


def _table(rows: Iterable[tuple[str, FieldInfo]]) -> list[str]:
    """Return settings as a table with default and meaning; none without settings."""
    lines = []
    for name, field in rows:
        value = field.get_default(call_default_factory=True, validated_data={})
        default = "required" if field.is_required() else f"`{to_json(value).decode()}`"
        meaning = html.escape(description_of(field), quote=False).replace("|", "\\|")
        lines.append(f"| `{name}` | {default} | {meaning} |")
    head = "| setting | default | meaning |\n|---|---|---|\n"
    return [head + "\n".join(lines)] if lines else ["No options."]


def _models() -> str:
    """Return the page of equations."""
    lines = [_title("Equations of the models"), "Letters are local to a module."]
    for module in MODELS:
        lines += [_title(module, "-"), f".. automodule:: {module}\n   :no-members:"]
    return "\n\n".join(lines) + "\n"


def _packages() -> Iterator[tuple[str, str]]:
    """Yield a page for each public package: its names, then their docstrings."""
    exported = ",".join(rfpipe.__all__)
    for package, more in PACKAGES.items():
        left_out = "errors, __version__" if package == "rfpipe" else f"{exported}, Options"
        lines = [
            _title(package),
            f".. automodule:: {package}\n   :members:\n   :exclude-members: {left_out}",
        ]
        lines += [f".. autoclass:: {name}\n   :members:" for name in more]
        yield f"{package}.rst", "\n\n".join(lines) + "\n"


def _title(text: str, mark: str = "=") -> str:
    return f"{text}\n{mark * len(text)}"


@dataclass(frozen=True)
class Script:
    """A script that draws: its address among the pages, its docstring, and its pictures.

    Attributes
    ----------
    path : str
        In the repository, like the paths of the pictures.
    page : str
        Document that has the script in its context.
    pictures : list of tuple (path, caption)
    """

    path: str
    page: str
    title: str
    text: str
    pictures: list[tuple[str, str]]

    @property
    def name(self) -> str:
        """Name of the script's page."""
        folder, stem = Path(self.path).parent.name, Path(self.path).stem
        return f"{folder}_{stem}"

    def its_page(self) -> str:
        """Return the page: pictures, docstring, code."""
        parts = [f"# {self.title}"]
        for picture, caption in self.pictures:
            parts += [f"![{caption or self.title}](../../../{picture})", caption]
        context = f"See [{self.page}](../../../{self.page})."
        code = f"```{{literalinclude}} ../../../{self.path}\n:language: python\n```"
        return "\n\n".join(filter(None, [*parts, self.text, context, code])) + "\n"

    def card(self) -> str:
        """Return the script's first picture and its title, as a link to its page."""
        picture, _ = self.pictures[0]
        return (
            f"   .. figure:: ../../../{picture}\n      :target: {self.name}.html\n"
            f"      :alt: {self.title}\n\n      :doc:`{self.title} <{self.name}>`"
        )


def _gallery(root: Path) -> Iterator[tuple[str, str]]:
    """Yield a page for each script that draws, and the gallery of them."""
    scripts = list(_scripts(root))
    for script in scripts:
        yield f"{script.name}.md", script.its_page()
    drawn = [script for script in scripts if script.pictures]
    others = [script for script in scripts if not script.pictures]
    names = "\n".join(f"   {script.name}" for script in [*drawn, *others])
    lines = [
        _title("Gallery"),
        "Each picture leads to the script that makes it.",
        ".. container:: gallery",
        *(script.card() for script in drawn),
        _title("Without a picture here", "-"),
        "``make figures`` makes them.",
        "\n".join(f"- :doc:`{script.title} <{script.name}>`" for script in others),
        ".. toctree::\n   :hidden:",
        names,
    ]
    yield "gallery.rst", "\n\n".join(lines) + "\n"


def _scripts(root: Path) -> Iterator[Script]:
    """Yield the scripts of docs/uses, and those of figures that draw, in the thesis' order."""
    figures = [f"figures/{name}.py" for name in (*ORDER, "methods", "opening")]
    uses = sorted(str(path.relative_to(root)) for path in (root / "docs/uses").glob("*.py"))
    for path in (*uses, *figures):
        docstring = ast.get_docstring(ast.parse((root / path).read_text("utf-8"))) or ""
        title, _, text = docstring.partition("\n")
        title, _, command = title.partition(": ``")
        if command:
            text = f"Run ``{command}\n{text}"
        elif path in figures:
            text = f"Run ``python -m figures {Path(path).stem} FOLDER``.\n{text}"
        page = "docs/uses.md" if path in uses else "docs/figures.md"
        yield Script(path, page, title.rstrip("."), text.strip(), list(_pictures(root, path)))


def _pictures(root: Path, script: str) -> Iterator[tuple[str, str]]:
    """Yield path and caption of each picture of a script that the repository has."""
    stem = Path(script).stem
    listed = root / "docs/images/figures" / f"{stem}.json"
    if script.startswith("figures/") and listed.exists():
        for item in json.loads(listed.read_text("utf-8"))["shown"]:
            if item["file"].endswith(".png"):
                caption = f"*{item['name']}.* The thesis: {item['thesis']} {item['caption']}"
                yield f"docs/images/figures/{item['file']}", caption
    else:
        for path in sorted((root / "docs/images").glob(DRAWN_BY.get(stem, f"{stem}.png"))):
            yield str(path.relative_to(root)), ""
