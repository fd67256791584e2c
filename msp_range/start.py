"""Where the command begins. Before anything is imported that takes its time, SIGINT is made to end it in silence.

Python's own handler raises KeyboardInterrupt wherever the program is; in the middle of an import that is a traceback.
This is done while this module is imported, and nothing but ``bin/msp-range`` imports it, which has blocked SIGINT.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def main() -> None:
    """Entry point of the command msp-range."""
    from msp_range.cli import main as command

    command()
