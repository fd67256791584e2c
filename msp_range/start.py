"""Entry point of the command. Before any slow import it arranges that SIGINT ends the program without a traceback.

Python's own handler raises KeyboardInterrupt anywhere, and during an import that prints a traceback. This happens when
this module is imported; only ``bin/msp-range`` imports it, with SIGINT blocked.
"""

import os
import signal

# Before numpy is imported. Matrices are small: more threads only wait for each other, which doubles the processor time
# of `msp-lab gap` on a busy computer, delays the service's start by 25 ms, and changes last digits.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
signal.signal(signal.SIGINT, signal.SIG_DFL)
signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGINT])


def main() -> None:
    """Entry point of the command msp-range."""
    from msp_range.cli import main as command

    command()
