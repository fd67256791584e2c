"""One form of table for the page, the terminal and the CSV file next to the page; nothing here needs an extra."""

from dataclasses import dataclass
from typing import Literal

from rich.table import Table
from rich.text import Text

from msp_range.terminal import plain_table

MarkKind = Literal["yes", "no", "open"]
"""Kinds of marks: something to look at, nothing to look at, not known."""
MARK_STYLES: dict[MarkKind, str] = {"yes": "yellow", "no": "green", "open": "dim"}


@dataclass(frozen=True)
class VerdictMark:
    """A cell with a verdict of a word or two: coloured on the terminal, framed on the page."""

    words: str
    kind: MarkKind = "open"

    def __str__(self) -> str:
        return self.words


@dataclass(frozen=True)
class PageTable:
    """A table of cells under a header."""

    name: str
    """Its anchor in the page, and the name of its CSV file."""
    title: str
    header: tuple[str, ...]
    """A word or two for each column, with units."""
    rows: tuple[tuple[str | VerdictMark, ...], ...]
    """Rows of cells, each as long as the header."""
    caption: str = ""
    """A remark below the table, on the page only."""
    align: str = "lr"
    """For each column ``l`` (words) or ``r`` (numbers); the last letter is that of all further columns."""

    def __rich__(self) -> Table:
        rows = (
            [Text(cell.words, MARK_STYLES[cell.kind]) if isinstance(cell, VerdictMark) else cell for cell in row]
            for row in self.rows
        )
        return plain_table(self.header, rows, self.align, self.title)

    @property
    def classes(self) -> list[str]:
        """The style of each column's cells on the page."""
        letters = self.align.ljust(len(self.header), self.align[-1])
        return ["word" if letter == "l" else "number" for letter in letters]
