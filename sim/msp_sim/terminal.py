"""What the commands of msp-sim do alike: a bar of progress, a folder for results.

Where there is no terminal, what is printed goes into a file or a pipe: lines, and no bar.
"""

from pathlib import Path
from typing import Self

from rich.console import Console
from rich.progress import Progress, ProgressColumn

from msp_range.yaml_file import ConfigError


class Bar:
    """A bar of progress on a terminal, and nothing elsewhere, where whoever uses it prints lines.

    Parameters
    ----------
    columns
        What stands in its line.
    total
        What is complete.
    on
        Where to draw; None: standard output.
    """

    def __init__(self, *columns: str | ProgressColumn, total: float, on: Console | None = None) -> None:
        self._progress = Progress(*columns, console=on, transient=True)
        self._task = self._progress.add_task("", total=total)
        self.is_shown = self._progress.console.is_terminal

    def __enter__(self) -> Self:
        if self.is_shown:
            self._progress.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self.is_shown:
            self._progress.stop()

    def show(self, description: str, completed: float) -> None:
        """Say what is being done, and how much is."""
        self._progress.update(self._task, description=description, completed=completed)


def make_folder(folder: Path) -> None:
    """Make a folder for results where it is not there; ConfigError where that fails."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be made: {error.strerror}") from None
