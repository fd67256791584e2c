"""The project's commands as a user calls them, each in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

from evaluation.runner import ONE_THREAD

BIN = Path(sys.executable).parent
SECONDS = 300.0
"""Longest run of a command; the museum's 40,000 beams take about a minute on one core."""


def run_command(command: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run one command of `msp-lab`, `msp-sim` or `msp-range`, and return its exit code and output."""
    return subprocess.run(
        [BIN / command, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=SECONDS,
        env=os.environ | ONE_THREAD | {"COLUMNS": "120"},
    )
