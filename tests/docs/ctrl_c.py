"""``python -m tests.docs.ctrl_c COMMAND...``: press Ctrl-C 3 s after the command's first line; returns what it returns.

A busy computer may need longer than that until the command runs at all.
"""

import os
import signal
import subprocess
import sys
import time

RUNS_S = 3.0


def main() -> int:
    """Run it."""
    surroundings = {**os.environ, "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        sys.argv[1:], env=surroundings, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as program:
        assert program.stdout is not None
        print(program.stdout.readline(), end="", flush=True)
        time.sleep(RUNS_S)
        program.send_signal(signal.SIGINT)
        print(program.stdout.read(), end="", flush=True)
    return program.returncode if program.returncode >= 0 else 128 - program.returncode


if __name__ == "__main__":
    sys.exit(main())
