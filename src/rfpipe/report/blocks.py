"""What a page is made of: sections of pictures, figures and tables."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

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
    """Images of one scene side by side, without axes.

    Attributes
    ----------
    name : str
        Its heading.
    caption : str
    slug : str
        Name of its PNG file, without folder and suffix.
    panels : dict of str to ndarray, shape (H, W, 3)
        From left to right, by what stands above them: sRGB in [0, 1], all of one shape.
    """

    name: str
    caption: str
    slug: str
    panels: dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Gallery:
    """Pictures that flow over the page's width."""

    pictures: list[Picture]


@dataclass(frozen=True)
class Illustration:
    """A figure with its caption.

    Attributes
    ----------
    name : str
        Its heading, such as "Fig. 5.10".
    caption : str
        What is seen, with scales and units.
    slug : str
        Name of its PNG file, without folder and suffix.
    figure : Figure
    alt : str
        What the figure says, for those who can't see it; by default its name alone.
    is_folded : bool
        Whether a reader has to open it.
    """

    name: str
    caption: str
    slug: str
    figure: Figure
    alt: str = ""
    is_folded: bool = False


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes
    ----------
    groups : list of (str, int)
        Headings over so many columns each; may be empty.
    columns : list of str
    rows : list of list of str
    text_columns : int
        Columns from the left that hold text rather than numbers.
    csv : str
        Name of the CSV file beside it, or "".
    is_grouped : bool
        Whether rows with the same first cell, one below the other, show it once.
    """

    groups: list[tuple[str, int]]
    columns: list[str]
    rows: list[list[str]]
    text_columns: int = 1
    csv: str = field(default="")
    is_grouped: bool = False

    @property
    def bodies(self) -> list[list[list[str]]]:
        """The rows, those that share their first cell together; all apart unless it is grouped."""
        if not self.is_grouped:
            return [[row] for row in self.rows]
        return [list(rows) for _, rows in groupby(self.rows, lambda row: row[0])]


Column = tuple[str, str, Callable[[Any], str]]


def table_of(
    records: Iterable[Mapping[Any, Any]],
    columns: Sequence[Column],
    groups: Sequence[tuple[str, int]] = (),
    **options: Any,
) -> Table:
    """Make a table of records.

    Parameters
    ----------
    records : iterable of mapping
        A row each.
    columns : sequence of (str, str, callable)
        For each column its heading, the key of its values, and what makes text of a value.
    groups : sequence of (str, int)
        As in `Table`.
    **options
        The rest of `Table`.
    """
    rows = [[shown(record.get(key)) for _, key, shown in columns] for record in records]
    return Table(list(groups), [heading for heading, *_ in columns], rows, **options)


@dataclass(frozen=True)
class Tabulation:
    """A table with its caption.

    Attributes
    ----------
    name, caption : str
    table : Table
    numbers : DataFrame or None
        Written to the table's CSV file; None where another stage wrote it, or there is none.
    is_folded : bool
        Whether a reader has to open it.
    """

    name: str
    caption: str
    table: Table
    numbers: pd.DataFrame | None = None
    is_folded: bool = True


Block = Gallery | Illustration | Tabulation


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes
    ----------
    anchor, title : str
    text : list of str
        Paragraphs.
    blocks : list of Block
    """

    anchor: str
    title: str
    text: list[str] = field(default_factory=list)
    blocks: list[Block] = field(default_factory=list)
