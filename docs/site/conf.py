"""Settings of the site: `make docs` builds it from the repository's pages, scripts and docstrings.

The source folder is the repository, so that links between pages are those of a code host.
"""

import html
import re
import sys
from pathlib import Path

import ziamath
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(ROOT), str(ROOT / "src")]

import links  # noqa: E402
import pages  # noqa: E402

from rfpipe.version import __version__  # noqa: E402

project = "rfpipe"
author = copyright = "The rfpipe authors"  # noqa: A001
version = release = __version__
extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "numpydoc",
]

root_doc = "docs/site/index"
include_patterns = [
    "README.md",
    "CHANGELOG.md",
    "docs/**",
    "config/README.md",
    "benchmarks/README.md",
]
# other folders, such as .venv, aren't searched
included = {"docs", "config", "benchmarks"}
exclude_patterns = [
    path.name for path in ROOT.iterdir() if path.is_dir() and path.name not in included
]

myst_fence_as_directive = ["math"]
myst_heading_anchors = 4
nb_execution_mode = "off"

default_role = "py:obj"
numpydoc_show_class_members = False  # autodoc lists them
autodoc_typehints = "none"  # docstrings have the types
autodoc_member_order = "bysource"
autodoc_default_options = {"inherited-members": "BaseModel,Exception,tuple"}

html_theme = "furo"
html_title = "rfpipe"
html_static_path = ["static"]
html_extra_path = ["extra"]  # index.html, which leads to the first page
html_css_files = ["site.css"]
html_show_sourcelink = False
html_copy_source = False


def setup(app: Sphinx) -> None:
    """Write the generated pages first; draw equations; check the links at the end."""
    app.connect("builder-inited", lambda _: pages.write(ROOT, HERE / "generated"))
    app.connect("build-finished", links.check)
    app.connect("autodoc-process-docstring", _prepare, priority=400)
    app.add_html_math_renderer("svg", (_equation, None), (_equation, None))


html_math_renderer = "svg"


def _equation(writer: HTML5Translator, node: nodes.math | nodes.math_block) -> None:
    """Draw an equation as SVG, which needs neither a script nor a font."""
    tex = node.astext()
    drawn = ziamath.Latex(tex, size=18, color="currentColor", inline=isinstance(node, nodes.math))
    writer.body.append(f'<span class="equation" role="img" aria-label="{html.escape(tex)}">')
    writer.body.append(f"{drawn.svg()}</span>")
    raise nodes.SkipNode


def _prepare(
    _app: Sphinx, what: str, _name: str, _object: object, _options: object, lines: list[str]
) -> None:
    """Mark indented equations of modules as literal; escape the stars of shapes, (*rays, C)."""
    text = "\n".join(lines)
    text = re.sub(r"(``.*?``)|\*(?=[\w.]+[,()])", lambda found: found[1] or r"\*", text, flags=re.S)
    if what == "module":
        text = re.sub(r"^(\S.*)(?<!::)\n\n(?= {4}\S)", r"\1\n\n::\n\n", text, flags=re.M)
    lines[:] = text.split("\n")
