"""The commands from the first moment on: SIGINT while they start, and where they are started from."""

import os
import signal
import subprocess
import time
from pathlib import Path

import pytest

from msp_range.user_errors import EXIT_INTERRUPTED
from tests.support.service import AIRFRAME, COMMAND
from tests.support.slow import slow
from tests.support.waiting import LIMIT_S


@pytest.mark.parametrize("every", [5, *slow(1)])
def test_sigint_ends_it_in_silence_at_whatever_moment_of_the_start(every: int) -> None:
    """Also while Python itself starts, which takes it 10 to 100 ms."""
    options = ["--bus", "/nonexistent/i2c", "--link", "udpout:127.0.0.1:9", "--log", "json"]
    command: list[str | Path] = [COMMAND, "run", AIRFRAME, *options]
    for delay_ms in (*range(0, 100, 6 * every), *range(100, 1000, 60 * every)):
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        time.sleep(delay_ms / 1e3)
        process.send_signal(signal.SIGINT)
        output, errors = process.communicate(timeout=LIMIT_S)
        assert output == ""
        # What it logged when it was at work already.
        assert all(line.startswith("{") for line in errors.splitlines()), (delay_ms, errors)
        # Ended by the signal; by the command's own answer, as a shell counts it; or stopped as a service.
        assert process.returncode in (-signal.SIGINT, EXIT_INTERRUPTED, 0), delay_ms


def test_the_commands_are_found_by_any_name(tmp_path: Path) -> None:
    """They begin as a shell script, which looks for the Python in the same folder."""
    link = tmp_path / "a link to it"
    link.symlink_to(COMMAND)
    path = os.pathsep.join([str(COMMAND.parent), os.environ["PATH"]])
    for command in ([link], ["msp-range"], ["msp-sim"], ["msp-lab"], ["sh", COMMAND]):
        done = subprocess.run(
            [*command, "--help"], capture_output=True, text=True, cwd=tmp_path, env={**os.environ, "PATH": path}
        )
        assert done.returncode == 0, done.stderr
        assert "Usage: " in done.stdout
