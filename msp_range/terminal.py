"""The console that all commands print to: text from files is shown as it is, whatever it holds.

rich takes ``[red]`` in a printed text for an instruction and ``:warning:`` for a picture, and a terminal obeys escape
sequences. Names of vehicles, sensors, runs and files are none of these.
"""

from typing import Any

from rich.console import Console
from rich.text import Text

from msp_range.input_file import printable

WIDTH = 120
"""Width of lines where there is no terminal [characters]: the widest table fits."""


class PlainConsole(Console):
    """A rich console without markup, emoji codes and control characters in what is printed; styles are arguments."""

    def __init__(self, **options: Any) -> None:
        super().__init__(markup=False, emoji=False, **options)

    def render_str(self, text: str, **options: Any) -> Text:
        """Make a text of a string that is printed or stands in a table."""
        return super().render_str(printable(text), **options)


def console() -> Console:
    """Standard output, with room for a table also where there is no terminal."""
    found = PlainConsole()
    return found if found.is_terminal else PlainConsole(width=WIDTH)
