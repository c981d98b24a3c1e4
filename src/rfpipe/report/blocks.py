"""What a page is made of: sections of figures and tables."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from rfpipe.report.tables import Table

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.figure import Figure

__all__ = ["Illustration", "Section", "Tabulation"]


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
    """

    name: str
    caption: str
    slug: str
    figure: Figure


@dataclass(frozen=True)
class Tabulation:
    """A table with its caption.

    Attributes
    ----------
    name, caption : str
    table : Table
    numbers : DataFrame or None
        Written to the table's CSV file; None where another stage wrote it, or there is none.
    """

    name: str
    caption: str
    table: Table
    numbers: pd.DataFrame | None = None


@dataclass(frozen=True)
class Section:
    """A section of the page.

    Attributes
    ----------
    anchor, title : str
    text : list of str
        Paragraphs.
    blocks : list of Illustration or Tabulation
    """

    anchor: str
    title: str
    text: list[str] = field(default_factory=list)
    blocks: list[Illustration | Tabulation] = field(default_factory=list)
