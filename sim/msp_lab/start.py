"""Where the command begins; see `msp_range.start`."""

import os
import signal

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def main() -> None:
    """Entry point of the command msp-lab."""
    from msp_lab.cli import main as command

    command()
