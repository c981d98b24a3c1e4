"""Check of the built pages: links lead to files and anchors, and nothing loads from elsewhere."""

from __future__ import annotations

from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

from sphinx.application import Sphinx
from sphinx.util import logging

_LOADED = {("script", "src"), ("img", "src"), ("link", "href"), ("iframe", "src")}
"""Elements and attributes whose files a browser loads with the page."""


class Page(HTMLParser):
    """Anchors and references of a page.

    Attributes
    ----------
    anchors : set of str
    references : set of tuple (tag, address)
        Of each ``href`` and ``src``.
    """

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.anchors: set[str] = set()
        self.references: set[tuple[str, str]] = set()
        self.feed(path.read_text("utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect the anchors and references of a tag."""
        for name, value in attrs:
            if name == "id":
                self.anchors.add(value or "")
            elif name in ("href", "src"):
                self.references.add((tag, name, value or ""))


def check(app: Sphinx, exception: Exception | None) -> None:
    """Warn of each link that leads nowhere, and of each file that isn't part of the site."""
    if exception or app.builder.format != "html":
        return
    folder = Path(app.outdir)
    pages = {path: Page(path) for path in folder.rglob("*.html")}
    for path, page in pages.items():
        for tag, name, address in sorted(page.references):
            fault = _fault(address, path, pages, loaded=(tag, name) in _LOADED)
            if fault:
                place = path.relative_to(folder)
                logging.getLogger(__name__).warning("%s: %s: %s", place, address, fault)


def _fault(address: str, path: Path, pages: dict[Path, Page], *, loaded: bool) -> str:
    """Return the reason why a reference of a page is wrong, or an empty text."""
    parts = urlsplit(address)
    if parts.scheme or parts.netloc:
        return "loaded from elsewhere" if loaded and parts.scheme != "data" else ""
    target = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if not target.exists():
        return "no such file"
    if parts.fragment and target in pages and unquote(parts.fragment) not in pages[target].anchors:
        return "no such anchor"
    return ""
