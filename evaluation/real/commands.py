"""The project's commands as a user calls them, each in a process of its own."""

import os
import subprocess
import sys
from pathlib import Path

from evaluation.runner import ONE_THREAD

BIN = Path(sys.executable).parent


def run_command(command: str, *arguments: object, longest_s: float | None = None) -> subprocess.CompletedProcess[str]:
    """Run one command of `msp-lab`, `msp-sim` or `msp-range`, and return its exit code and output.

    Raises
    ------
    subprocess.TimeoutExpired
        It was stopped after so long [s]; None: it takes as long as it does.
    """
    return subprocess.run(
        [BIN / command, *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=longest_s,
        env=os.environ | ONE_THREAD | {"COLUMNS": "120"},
    )
