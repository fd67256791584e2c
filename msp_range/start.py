"""Entry point of the command. Before any slow import it arranges that SIGINT ends the program without a traceback.

Python's own handler raises KeyboardInterrupt anywhere, and during an import that prints a traceback. This happens when
this module is imported; only ``bin/msp-range`` imports it, with SIGINT blocked.
"""

import signal

signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def main() -> None:
    """Entry point of the command msp-range."""
    from msp_range.cli import main as command

    command()
