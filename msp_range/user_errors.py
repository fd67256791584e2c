"""User errors in all commands: a line on standard error and an exit code, without a traceback."""

import errno
import gc
import signal
import sys
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any, ParamSpec

from typer import Context, Exit, Option
from typer.core import TyperGroup

from msp_range import __version__
from msp_range.errors import UserError
from msp_range.input_file import printable
from msp_range.systemd import notify_systemd

EXIT_COMMAND_LINE = 2
"""Exit code: invalid command line."""

EXIT_FILE = 3
"""Exit code: a file, or something named in it, cannot be used."""

EXIT_INTERRUPTED = 130
"""Exit code after SIGINT, as used by shells: 128 plus its number."""

Parameters = ParamSpec("Parameters")


def report_user_errors(command: Callable[Parameters, None]) -> Callable[Parameters, None]:
    """Decorate a command: print a user error as a line on standard error, and exit with code 3.

    Ctrl-C ends the command without a message, after its context managers have cleaned up (`msp_range.start`).
    """

    @wraps(command)
    def reporting(*args: Parameters.args, **kwargs: Parameters.kwargs) -> None:
        try:
            if signal.getsignal(signal.SIGINT) is signal.SIG_DFL:
                signal.signal(signal.SIGINT, signal.default_int_handler)
            if not gc.isenabled():  # since `msp_range.start`; what was imported stays, and no collection looks at it
                gc.freeze()
                gc.enable()
            command(*args, **kwargs)
        except KeyboardInterrupt:
            raise Exit(EXIT_INTERRUPTED) from None
        except UserError as error:
            print(text := printable(str(error)), file=sys.stderr)
            notify_systemd(f"STATUS={' '.join(text.split())}")
            raise Exit(EXIT_FILE) from None
        except OSError as error:
            if error.errno not in (errno.ENOSPC, errno.EDQUOT, errno.ENAMETOOLONG):
                raise
            print(f"{error.filename or 'the disk'}: {error.strerror}", file=sys.stderr)
            raise Exit(EXIT_FILE) from None

    return reporting


class Commands(TyperGroup):
    """The commands of a program: all of them report user errors."""

    def invoke(self, context: Any) -> Any:
        """Run the command that was named."""
        return report_user_errors(super().invoke)(context)


def _show_version(context: Context, wanted: bool) -> None:
    if wanted:
        print(f"{context.info_name} {__version__} (Python {sys.version.split()[0]})")
        raise Exit


VersionOption = Annotated[
    bool, Option("--version", callback=_show_version, is_eager=True, help="print the version and exit")
]
"""Options of all programs of the project."""
