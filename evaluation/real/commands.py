"""The project's commands as a user calls them, each in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

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
        env=os.environ | {"COLUMNS": "120", "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"},
    )
