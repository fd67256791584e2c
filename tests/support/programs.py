"""The three programs, each run in this process."""

from importlib import import_module
from typing import Any

import typer
from typer.testing import CliRunner, Result

PROGRAMS = ("msp-range", "msp-sim", "msp-lab")


def app_of(program: str) -> typer.Typer:
    """Its commands, of which a test that runs another program imports nothing."""
    app = import_module(f"{program.replace('-', '_')}.cli").app
    assert isinstance(app, typer.Typer)
    return app


def commands_of(program: str) -> list[str]:
    """Names of its commands."""
    group: Any = typer.main.get_command(app_of(program))
    return list(group.commands)


def run(command: object, *arguments: object, code: int = 0, **options: Any) -> Result:
    """``run("msp-sim fly", scenario, "--out", folder)``; AssertionError if it ends with another exit code."""
    program, *words = str(command).split()
    result = CliRunner().invoke(app_of(program), [*words, *map(str, arguments)], prog_name=program, **options)
    assert result.exit_code == code, (result.output, result.exception)
    return result
