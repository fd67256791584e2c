"""Shared parts of the commands: a progress bar and a folder for results."""

import os
from pathlib import Path
from typing import Self

from rich.console import Console
from rich.progress import Progress, ProgressColumn

from msp_range.yaml_file import ConfigError


class Bar:
    """A progress bar on a terminal; shows nothing if the output is a file or a pipe.

    Parameters
    ----------
    columns
        Columns of the bar's line.
    total
        Value at which the bar is complete.
    on
        Console to draw on; None: standard output.
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
        """Show what is being done, and how much of it is complete."""
        self._progress.update(self._task, description=description, completed=completed)


def make_folder(folder: Path) -> None:
    """Create a folder for results unless it exists; ConfigError if that fails, or nothing can be written into it."""
    if folder.exists() and not folder.is_dir():
        raise ConfigError(f"{folder}: is a file; expected a folder for results, which is made if it does not exist")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(f"{folder}: this folder cannot be created: {error.strerror}") from None
    if not os.access(folder, os.W_OK | os.X_OK):
        raise ConfigError(f"{folder}: no permission to write into this folder; name another one")
