"""Commands that have moved to another program: the old name prints the new one."""

import sys
from collections.abc import Callable, Mapping

import typer

EXIT_COMMAND_LINE = 2
"""Exit code: invalid command line."""


def add_moved(app: typer.Typer, moved: Mapping[str, str]) -> None:
    """Make each moved command print its new name and end with exit code 2, with any arguments.

    Parameters
    ----------
    app
        The application that had the commands.
    moved
        New command by old name, such as ``msp-lab collect``.
    """
    anything = {"ignore_unknown_options": True, "allow_extra_args": True}
    for name, now in moved.items():
        app.command(name, hidden=True, add_help_option=False, context_settings=anything)(_moved(now))


def _moved(now: str) -> Callable[[typer.Context], None]:
    def command(context: typer.Context) -> None:
        print(f"{context.command_path} is now {now}", file=sys.stderr)
        raise typer.Exit(EXIT_COMMAND_LINE)

    return command
