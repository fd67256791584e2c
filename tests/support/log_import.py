"""The command ``msp-lab import``, and logs to try it on."""

import json
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from msp_lab.cli import app
from tests.support import programs

LOGS = Path(__file__).parents[1] / "data" / "logs"


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(each) for each in arguments])


def imported(*arguments: object) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads(programs.run("msp-lab import", *arguments, "--json").stdout)
    return found
