"""Log lines on standard error: an event with its values, as text or as JSON.

``text`` writes time, level, event and ``key=value``; ``json`` writes one object per line. systemd's journal has a time
and a level of its own for each line, so it gets the level in its own form (sd-daemon(3)) and no time.
"""

import json
import os
import sys
from contextlib import suppress
from datetime import UTC, datetime
from functools import partialmethod
from typing import TextIO

from msp_range.clock import Clock, SystemClock

PRIORITIES = {"error": 3, "warning": 4, "info": 6}
"""syslog's number of each level, by which `journalctl --priority` selects and colours lines."""


class Log:
    """Writes events; if the stream accepts no more they are lost, and the flight continues.

    Parameters
    ----------
    form
        ``text`` or ``json``.
    stream
        Output stream; None: standard error.
    clock
        Gives the UTC time of every line.

    Examples
    --------
    >>> from msp_range.clock import VirtualClock
    >>> Log("text", sys.stdout, VirtualClock(1.7e9)).warning("link", connected=False, error="no such device")
    2023-11-14T22:13:20.000000Z warning  link  connected=false error="no such device"
    """

    def __init__(self, form: str, stream: TextIO | None = None, clock: Clock | None = None) -> None:
        self.form = form
        self._stream = stream or sys.stderr
        self._clock = clock or SystemClock()
        self._in_journal = _is_journal(self._stream)

    def write(self, level: str, event: str, **values: object) -> None:
        """Log at a level: info, warning or error."""
        utc = datetime.fromtimestamp(self._clock.utc(), UTC).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
        if self.form == "json":
            stamp = {} if self._in_journal else {"timestamp": utc}
            line = json.dumps({**stamp, "level": level, "event": event, **values})
        else:
            words = " ".join(f"{key}={_word(value)}" for key, value in values.items())
            line = f"{'' if self._in_journal else utc + ' '}{level:<8} {event}  {words}".rstrip()
        if self._in_journal:
            line = f"<{PRIORITIES[level]}>{line}"
        # A full disk, or no reader at the other end of the pipe.
        with suppress(OSError):
            print(line, file=self._stream, flush=True)

    info = partialmethod(write, "info")
    """Log normal operation."""
    warning = partialmethod(write, "warning")
    """Log something that does not work and may recover."""
    error = partialmethod(write, "error")
    """Log an error."""


def _is_journal(stream: TextIO) -> bool:
    """Whether systemd's journal reads a stream: JOURNAL_STREAM names its file, see systemd.exec(5)."""
    try:
        file = os.fstat(stream.fileno())
    except (OSError, ValueError):  # no file, or a closed one
        return False
    return os.environ.get("JOURNAL_STREAM") == f"{file.st_dev}:{file.st_ino}"


def _word(value: object) -> str:
    if isinstance(value, str) and value.isprintable() and " " not in value:
        return value
    return json.dumps(value)
