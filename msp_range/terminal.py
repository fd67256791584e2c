"""The console of all commands: text from files is printed literally.

rich interprets ``[red]`` as a style and ``:warning:`` as an emoji, and terminals execute escape sequences. Names of
vehicles, sensors, runs and files must not be interpreted.
"""

from typing import Any

from rich.console import Console
from rich.table import Column
from rich.text import Text

from msp_range.input_file import printable

WIDTH = 120
"""Line width without a terminal [characters]: the widest table fits."""


class PlainConsole(Console):
    """A rich console that prints text literally, without markup, emoji codes, control characters and colours that it
    finds for numbers and words itself; styles are arguments."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, highlight=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Convert a string that is printed or in a table to a literal text."""
        return super().render_str(printable(text), **options)


def number_columns(*headings: str) -> list[Column]:
    """Columns of a table that hold numbers."""
    return [Column(heading, justify="right") for heading in headings]


def console() -> Console:
    """A console on standard output, wide enough for tables even without a terminal."""
    found = PlainConsole()
    return found if found.is_terminal else PlainConsole(width=WIDTH)
