"""Self-contained page of sections with figures and tables, and the files of these."""

from __future__ import annotations

import io
import re
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from numpy.typing import NDArray

from rfpipe.pictures.images import write_image
from rfpipe.report.text import DASH
from rfpipe.stages.evaluate import write_table
from rfpipe.store.files import write_atomically

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

_PIXEL_RATIO = 1.5
"""Pixels of a PNG per displayed pixel, for high-resolution screens."""

_PRINT_DPI = 300
"""Dots per inch of pictures in a PDF."""

_LINK = re.compile(r'(?:href|src)="(?!#|data:|https?:)([^"]+)"')


@dataclass(frozen=True)
class Illustration:
    """Figure with its caption.

    Attributes
    ----------
    name, caption : str
    slug : str
        Stem of its files, ``figures/{slug}.png``, ``figures/{slug}.pdf`` of vectors, and
        ``figures/{slug}_{picture}.exr``.
    figure : Figure
    light : mapping of str to ndarray, shape (H, W, C)
        Linear radiance of pictures in the figure, written as EXR files.
    """

    name: str
    caption: str
    slug: str
    figure: Figure
    light: Mapping[str, NDArray[Any]] = field(default_factory=dict)


@dataclass(frozen=True)
class Gallery:
    """Figures in a row that wraps at the page's width."""

    figures: Sequence[Illustration]


@dataclass(frozen=True)
class Table:
    """Table with its caption.

    Attributes
    ----------
    name, caption : str
    columns : list of str
    rows : list of list of str
    text_columns : int
        Number of columns with text, from the left.
    csv : str
        Name of the file with its numbers in ``tables/``; "" for no file.
    numbers : DataFrame, optional
        Content of that file; None if another stage wrote it.
    is_folded : bool
        Whether the table is collapsed at first.
    has_latex : bool
        Whether the table is also written as a ``.tex`` file.
    alarmed : frozenset of int
        Rows that are shown in red.
    """

    name: str
    caption: str
    columns: list[str]
    rows: list[list[str]]
    text_columns: int = 1
    csv: str = ""
    numbers: pd.DataFrame | None = None
    is_folded: bool = True
    has_latex: bool = False
    alarmed: frozenset[int] = frozenset()

    @property
    def files(self) -> dict[str, str]:
        """Paths of its files, relative to the page, and texts of the links to them."""
        if not self.csv:
            return {}
        path = f"tables/{self.csv}"
        latex = path.removesuffix(".csv") + ".tex"
        return {path: path} | ({latex: "LaTeX"} if self.has_latex else {})


Block = Gallery | Illustration | Table
Column = tuple[str, Any, Callable[[Any], str]]


@dataclass(frozen=True)
class Section:
    """Section of a page: alarms in red, then paragraphs, then blocks."""

    anchor: str
    title: str
    blocks: Sequence[Block]
    text: Sequence[str] = ()
    alarms: Sequence[str] = ()


def table_of(
    name: str,
    caption: str,
    records: pd.DataFrame | Sequence[Mapping[Any, Any]],
    labels: Sequence[Column],
    columns: Sequence[Column],
    **options: Any,
) -> Table:
    """Return a table with a row for each record; its CSV file has the records' values.

    Parameters
    ----------
    name, caption : str
    records : DataFrame or sequence of mapping
    labels, columns : sequence of (str, object, callable)
        Columns of text and of numbers: heading, key, and a function that formats a value.
        Columns without any value are omitted.
    **options
        Further fields of `Table`.
    """
    import pandas as pd

    fields, numbers = [*labels, *columns], pd.DataFrame(records)
    entries = records.to_dict("records") if isinstance(records, pd.DataFrame) else records
    fields = [
        (heading, key, text)
        for heading, key, text in fields
        if any(text(entry.get(key)) != DASH for entry in entries)
    ]
    rows = [[text(record.get(key)) for _, key, text in fields] for record in entries]
    options = {"text_columns": len(labels), "numbers": numbers, **options}
    return Table(name, caption, [heading for heading, *_ in fields], rows, **options)


def write_page(
    page: Path,
    title: str,
    lead: str,
    sections: Sequence[Section],
    swatches: Mapping[str, str],
    views: Mapping[str, Sequence[tuple[str, str]]] | None = None,
) -> None:
    """Write a page with embedded figures, and the files in ``figures/`` and ``tables/``.

    Parameters
    ----------
    page : Path
    title, lead : str
    sections : sequence of Section
    swatches : mapping of str to str
        Colours of marks before texts in tables.
    views : mapping of str to sequence of (str, str), optional
        Pages of the viewer by scene: title of the method, and path relative to this page.
    """
    text = rendered(
        "page.html.j2",
        title=title,
        lead=lead,
        sections=[
            (section, [_written(page.parent, block) for block in section.blocks])
            for section in sections
        ],
        swatches=swatches,
        views=views or {},
    )
    write_atomically(page, text.encode())


def rendered(template: str, **parts: Any) -> str:
    """Render a template of this package."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    options: Any = {"trim_blocks": True, "lstrip_blocks": True, "undefined": StrictUndefined}
    loader = PackageLoader("rfpipe.report", ".")
    environment = Environment(loader=loader, autoescape=True, **options)
    return environment.get_template(template).render(parts)


def _written(folder: Path, block: Block) -> dict[str, Any]:
    """Write a block's files; return the template's variables of the block."""
    if isinstance(block, Gallery):
        return {"gallery": [_written(folder, figure) for figure in block.figures]}
    if isinstance(block, Table):
        if block.numbers is not None and block.csv:
            write_table(folder / "tables" / block.csv, block.numbers)
        if block.has_latex:
            path = (folder / "tables" / block.csv).with_suffix(".tex")
            write_atomically(path, latex_table(block).encode())
        return {"table": block}
    image, name = _png(block.figure), f"figures/{block.slug}.png"
    vectors = f"figures/{block.slug}.pdf"
    write_atomically(folder / name, image)
    block.figure.set_layout_engine("none")  # keep the layout of the PNG
    write_atomically(folder / vectors, pdf_of(block.figure))
    files = {name: name, vectors: "PDF"}
    for picture, radiance in block.light.items():
        name = f"figures/{block.slug}_{picture}.exr"
        write_image(folder / name, radiance, attributes={"DateTime": ""})  # reproducible bytes
        files[name] = f"{picture}.exr"
    box = block.figure.bbox
    size = {"width": int(box.width), "height": int(box.height)}
    return {"figure": block, "files": files, "image": b64encode(image).decode(), **size}


def _png(figure: Figure) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    buffer = io.BytesIO()
    canvas: Any = FigureCanvasAgg(figure)
    with _resolution(figure, _PIXEL_RATIO * figure.dpi):
        canvas.print_png(buffer, metadata={"Software": None})
    return buffer.getvalue()


# TrueType fonts: accepted by publishers, searchable
_PDF_STYLE: Any = {"pdf.fonttype": 42}


def pdf_of(figure: Figure) -> bytes:
    """Return a figure as PDF: lines and text as vectors, pictures as pixels."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    buffer = io.BytesIO()
    metadata = {"Creator": None, "Producer": None, "CreationDate": None}
    canvas: Any = FigureCanvasPdf(figure)
    with rc_context(_PDF_STYLE), _resolution(figure, _PRINT_DPI):
        canvas.print_pdf(buffer, metadata=metadata)
    return buffer.getvalue()


@contextmanager
def _resolution(figure: Figure, dpi: float) -> Iterator[None]:
    """Draw a figure at another resolution; `Figure.savefig` would draw it twice."""
    before = figure.dpi
    figure.dpi = dpi
    try:
        yield
    finally:
        figure.dpi = before


_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_",
    "{": r"\{", "}": r"\}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "\N{EN DASH}": "--", "\N{PLUS-MINUS SIGN}": r"$\pm$", "\N{MULTIPLICATION SIGN}": r"$\times$",
    "\N{NO-BREAK SPACE}": "~", "\N{SUPERSCRIPT SIX}": r"\textsuperscript{6}",
    "\N{LESS-THAN OR EQUAL TO}": r"$\leq$",
}  # fmt: skip


def latex_table(table: Table) -> str:
    """Return a table as LaTeX for the package booktabs."""

    def line(cells: Sequence[str]) -> str:
        return " & ".join(map(latex_text, cells)) + r" \\"

    columns = [*zip(*table.rows, strict=True)][table.text_columns :]
    alignments = ("l" if any(cell[:1].isalpha() for cell in column) else "r" for column in columns)
    kinds = "l" * table.text_columns + "".join(alignments)
    lines = [
        "% needs \\usepackage{booktabs}",
        rf"\begin{{tabular}}{{{kinds}}}",
        r"\toprule",
        line(table.columns),
        r"\midrule",
        *map(line, table.rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    return "\n".join(lines) + "\n"


def latex_text(text: str) -> str:
    """Return a text with LaTeX's special characters escaped."""
    return "".join(_LATEX.get(sign, sign) for sign in text)


def check_page(page: Path) -> list[str]:
    """Return the faults of a page and of its figures.

    Parameters
    ----------
    page : Path
        Such as ``results/report/index.html``, in a folder with ``figures/*.png``.

    Returns
    -------
    list of str
        Sentences on links to missing files, pictures of a single colour, and pages without
        pictures.
    """
    import OpenImageIO as oiio

    text = page.read_text(encoding="utf-8")
    faults = [
        f"{page}: links to {link}, which is missing"
        for link in dict.fromkeys(_LINK.findall(text))
        if not (page.parent / link).is_file()
    ]
    if "<img" not in text:
        faults.append(f"{page}: has no picture")
    for picture in sorted(page.parent.glob("figures/*.png")):
        pixels = oiio.ImageBuf(str(picture)).get_pixels(oiio.UINT8)
        if pixels is None or (pixels == pixels[:1, :1]).all():
            faults.append(f"{picture}: blank, all pixels have one colour")
    return faults
