"""The web page's process: started and kept running by the bridge, and never waited for."""

import subprocess
import sys
from pathlib import Path

from msp_range.log import Log

START_S = 1.0
"""The page is started this long after the bridge [s]: the first distances matter more."""
RESTART_S = 5.0
"""Time between two starts of a page that ends, such as on a port that is in use [s]. Starting takes 0.3 s of a
processor, so a shorter time would take it from the polling."""


class PageProcess:
    """The page of one bridge.

    Parameters
    ----------
    listen
        [HOST:]PORT of the page.
    socket
        The bridge's socket, see `msp_range.watch.feed`.
    now_s
        Now [s].
    log
        The bridge's; the page writes lines of the same form.
    """

    def __init__(self, listen: str, socket: Path, now_s: float, log: Log) -> None:
        program = [sys.executable, "-m", "msp_range.web", listen]
        self._command = [*program, "--socket", str(socket), "--log", log.form]
        self._log = log
        self._process: subprocess.Popen[bytes] | None = None
        self._start_s = now_s + START_S

    def service(self, now_s: float) -> None:
        """Start the page where it does not run."""
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return
            self._log.warning("web page ended", exit_code=code, starts_again_in_s=RESTART_S)
            self._process, self._start_s = None, now_s + RESTART_S
        if now_s >= self._start_s:
            try:
                # It ends with its standard input, so also when this process is killed.
                self._process = subprocess.Popen(self._command, stdin=subprocess.PIPE)
            except OSError as error:  # no memory, no free descriptor
                self._log.warning("web page not started", error=str(error), tries_again_in_s=RESTART_S)
                self._start_s = now_s + RESTART_S

    def close(self) -> None:
        """Tell the page to end, and do not wait for it: the next airframe is to fly at once."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
            self._process.terminate()
