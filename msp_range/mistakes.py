"""What every command does about a user's mistake: a line on standard error, an exit code, no traceback."""

import errno
import signal
import sys
from collections.abc import Callable
from functools import wraps
from typing import ParamSpec

import typer

from msp_range.input_file import printable
from msp_range.yaml_file import ConfigError

EXIT_FILE = 3
"""A file, or what it names, cannot be used."""

EXIT_INTERRUPTED = 130
"""What a shell calls the end by SIGINT: 128 and its number."""

Parameters = ParamSpec("Parameters")


def tell_mistakes(command: Callable[Parameters, None]) -> Callable[Parameters, None]:
    """Print a user's mistake as a line on standard error and leave with exit code 3; no traceback.

    Ctrl-C ends the command in silence; from here on what it has begun is undone (`msp_range.start`).
    """

    @wraps(command)
    def telling(*args: Parameters.args, **kwargs: Parameters.kwargs) -> None:
        # Imported late: --help must not wait for them.
        from msp_range.bus import BusError
        from msp_range.recording.error import RecordingError
        from msp_range.sensors.base import AddressError

        try:
            if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
                signal.signal(signal.SIGINT, signal.default_int_handler)
            command(*args, **kwargs)
        except KeyboardInterrupt:
            raise typer.Exit(EXIT_INTERRUPTED) from None
        except (ConfigError, RecordingError, AddressError, BusError) as error:
            print(printable(str(error)), file=sys.stderr)
            raise typer.Exit(EXIT_FILE) from None
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT):
                raise
            print(f"{error.filename or 'the disk'}: {error.strerror}", file=sys.stderr)
            raise typer.Exit(EXIT_FILE) from None

    return telling
