"""The console, tables and progress bar of all commands: text from files is printed literally.

rich interprets ``[red]`` as a style and ``:warning:`` as an emoji, and terminals execute escape sequences. Names of
vehicles, sensors, runs and files must not be interpreted.
"""

import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Self

from rich import box
from rich.console import Console
from rich.progress import Progress, ProgressColumn, TextColumn
from rich.table import Table
from rich.text import Text

from msp_range.input_file import printable

WIDTH = 120
"""Line width without a terminal [characters]: the widest table fits."""
NARROW = 80
"""Columns of a terminal over ssh, for what is read while flying or on a bench [characters]."""


class PlainConsole(Console):
    """A rich console that prints text literally, without markup, emoji codes, colours for numbers and control
    characters; styles are arguments."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Convert a string that is printed or in a table to a literal text."""
        return super().render_str(printable(text), **options)


def plain_table(
    header: Sequence[str], rows: Iterable[Sequence[str | Text]] = (), align: str = "lr", title: str | None = None
) -> Table:
    """A table with a line below its headings only.

    Parameters
    ----------
    header
        Heading of each column.
    rows
        Cells; a row may be shorter than the header.
    align
        For each column ``l`` (words) or ``r`` (numbers), as in LaTeX; the last letter is that of all further columns.
    title
        Line above the table.
    """
    table = Table(title=title, box=box.SIMPLE_HEAD, pad_edge=False)
    for heading, side in zip(header, align.ljust(len(header), align[-1]), strict=False):
        table.add_column(heading, justify="right" if side == "r" else "left", overflow="fold")
    for row in rows:
        table.add_row(*row)
    return table


def wrapped(text: str) -> list[str]:
    """The lines of a text, at most `NARROW` wide; what is folded goes on below what its line's first column precedes.

    Examples
    --------
    >>> wrapped("right    port: " + 15 * "word ")[1], wrapped("         -> " + 15 * "word ")[1]
    ('         word word', '            word word')
    """
    lines: list[str] = []
    for line in map(printable, text.split("\n")):
        column = re.match(r"[ >-]*(\S+ {2,})?", line)
        indent = " " * len(column[0] if column else "")
        lines += textwrap.wrap(line, NARROW, subsequent_indent=indent, break_on_hyphens=False) or [""]
    return lines


def console() -> Console:
    """A console on standard output, wide enough for tables even without a terminal."""
    found = PlainConsole()
    return found if found.is_terminal else PlainConsole(width=WIDTH)


class Bar:
    """A progress bar on a terminal; shows nothing if the output is a file or a pipe.

    Parameters
    ----------
    columns
        Columns of the bar's line, after what is being done.
    total
        Value at which the bar is complete.
    on
        Console to draw on; None: standard output.
    """

    def __init__(self, *columns: str | ProgressColumn, total: float, on: Console | None = None) -> None:
        doing = TextColumn("{task.description}", markup=False)
        self._progress = Progress(doing, *columns, console=on, transient=True)
        self._task = self._progress.add_task("", total=total)
        self.is_shown = self._progress.console.is_terminal
        self._progress.disable = not self.is_shown

    def __enter__(self) -> Self:
        self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._progress.stop()

    @contextmanager
    def paused(self) -> Iterator[None]:
        """Hide the bar while something is printed."""
        self.__exit__()
        try:
            yield
        finally:
            self.__enter__()

    def show(self, description: str, completed: float) -> None:
        """Show what is being done, and how much of it is complete."""
        self._progress.update(self._task, description=description, completed=completed)
