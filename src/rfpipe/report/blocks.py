"""What a page is made of: sections of pictures, figures and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

    from rfpipe.report.drawing import Drawing
    from rfpipe.report.light import Light

__all__ = [
    "Block",
    "Column",
    "Gallery",
    "Illustration",
    "Picture",
    "Section",
    "Table",
    "Tabulation",
    "table_of",
]


@dataclass(frozen=True)
class Picture:
    """Pictures of one scene side by side, pixel by pixel, without axes.

    Attributes
    ----------
    name : str
        Its heading.
    caption : str
        What is seen; exposure and the scale of the error are added to it.
    slug : str
        Name of its files, without folder and suffix.
    light : list of Light
        From left to right, all of one shape; what each is stands above it.
    compared : (int, int), optional
        Numbers of a relit picture and the true one, whose difference is shown at the right.
    """

    name: str
    caption: str
    slug: str
    light: list[Light]
    compared: tuple[int, int] | None = None


@dataclass(frozen=True)
class Gallery:
    """Pictures that flow over the page's width."""

    pictures: list[Picture]


@dataclass(frozen=True)
class Illustration:
    """A figure with its caption: the one way to add a figure to the report.

    Placing it writes ``figures/{slug}.png``, the
    page's part with its caption, and its entry in ``results.json``.

    Attributes
    ----------
    name : str
        Its heading, such as "Fig. 5.10".
    caption : str
        What is seen, with scales and units, for a reader who doesn't know the code. Exposure is
        added to it.
    slug : str
        Name of its files, without folder and suffix.
    figure : Figure or Drawing
        A `Drawing` where it shows light.
    alt : str
        What the figure says, for those who can't see it; by default its name alone.
    is_folded : bool
        Whether a reader has to open it.
    """

    name: str
    caption: str
    slug: str
    figure: Figure | Drawing
    alt: str = ""
    is_folded: bool = False


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes
    ----------
    groups : sequence of (str, int)
        Headings over so many columns each; may be empty.
    columns : list of str
    rows : list of list of str
    text_columns : int
        Columns from the left that hold text rather than numbers.
    csv : str
        Name of the CSV file beside it, or "".
    numbers : DataFrame or None
        The numbers behind the rows, or more of them; None where there are none.
    is_written : bool
        Whether another stage wrote them to the CSV file already.
    """

    groups: Sequence[tuple[str, int]]
    columns: list[str]
    rows: list[list[str]]
    text_columns: int = 1
    csv: str = ""
    numbers: pd.DataFrame | None = None
    is_written: bool = False

    @property
    def bodies(self) -> list[list[list[str]]]:
        """The rows, those one below the other with the same first cell together."""
        return [list(rows) for _, rows in groupby(self.rows, lambda row: row[0])]


Column = tuple[str, Any, Callable[[Any], str]]


def table_of(
    records: pd.DataFrame | Sequence[Mapping[Any, Any]],
    labels: Sequence[Column],
    columns: Sequence[Column],
    groups: Sequence[tuple[str, int]] = (),
    **options: Any,
) -> Table:
    """Make a table of records, with the numbers of its CSV file.

    Parameters
    ----------
    records : DataFrame or sequence of mapping
        A row each.
    labels, columns : sequence of (str, object, callable)
        The columns of text at the left, and the others: for each its heading, the key of its
        values, and what makes text of a value.
    groups : sequence of (str, int)
        As in `Table`.
    **options
        The rest of `Table`; its numbers are the records by default.
    """
    import pandas as pd

    shown, numbers = [*labels, *columns], pd.DataFrame(records)
    each = records.to_dict("records") if isinstance(records, pd.DataFrame) else records
    rows = [[text(record.get(key)) for _, key, text in shown] for record in each]
    options = {"text_columns": len(labels), "numbers": numbers, **options}
    return Table(groups, [heading for heading, *_ in shown], rows, **options)


@dataclass(frozen=True)
class Tabulation:
    """A table with its caption.

    Attributes
    ----------
    name, caption : str
    table : Table
    is_folded : bool
        Whether a reader has to open it.
    """

    name: str
    caption: str
    table: Table
    is_folded: bool = True


Block = Gallery | Illustration | Tabulation


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes
    ----------
    anchor, title : str
    blocks : sequence of Block
    text : sequence of str
        Paragraphs before them.
    """

    anchor: str
    title: str
    blocks: Sequence[Block]
    text: Sequence[str] = ()
