"""A new file that never makes its user wait: it takes bytes at once, and a thread of its own talks to the disk.

The thread opens the file, writes what it was given, and asks the disk to keep it (fdatasync) after every write. On an
SD card each of these can take hundreds of milliseconds, and on a disk that hangs they do not come back at all; how far
the disk is behind can always be asked.
"""

import contextlib
import errno
import os
import threading
from collections import deque
from collections.abc import Callable
from io import FileIO
from pathlib import Path
from queue import SimpleQueue

from msp_range.clock import SystemClock

REST_S = 0.1
"""After each write that the disk has confirmed, the thread rests for this long [s]. On a vehicle a block comes every
0.5 s, so none waits for this; in a virtual flight one comes every few milliseconds, and to wake the thread for each of
them took a tenth of the flight's time. Longer than a disk leaves of the 0.5 s would add to what a power cut costs."""


class BackgroundFile:
    """A file that is being written in the background, to the end or until the disk fails.

    Parameters
    ----------
    open_file
        Makes and opens the file. It is called in the thread, and may raise OSError.

    Attributes
    ----------
    path : Path or None
        The file; None until it is open.
    error : OSError or None
        Why the file ended before its end.
    kept_bytes : int
        What the disk has promised to keep.
    """

    def __init__(self, open_file: Callable[[], FileIO]) -> None:
        self.path: Path | None = None
        self.error: OSError | None = None
        self.kept_bytes = 0
        # Real time: a disk is no quicker in a simulated flight.
        self._clock = SystemClock()
        self._given_bytes = 0
        self._block: list[bytes | bytearray] = []
        self._blocks: SimpleQueue[list[bytes | bytearray] | Callable[[], object]] = SimpleQueue()
        self._given_s: deque[float] = deque()
        self._opened, self._finishing = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, args=(open_file,), name="recording", daemon=True)
        self._thread.start()

    @property
    def behind_s(self) -> float:
        """For how long the oldest block that was handed over has been waiting [s]; 0 where none is."""
        try:
            return self._clock.now() - self._given_s[0]
        except IndexError:
            return 0.0

    def wait_while_behind(self, least_s: float, most_s: float) -> None:
        """Wait while the oldest block has been waiting for more than ``least_s``, but not for ``most_s``."""
        while least_s < self.behind_s <= most_s and not self.has_ended:
            self._clock.sleep_until(self._clock.now() + REST_S)

    @property
    def has_ended(self) -> bool:
        """Whether the thread has ended: the file is complete, or `error` says why it is not."""
        return not self._thread.is_alive()

    def wait_until_open(self) -> None:
        """Wait for the disk to open the file; raises OSError where it cannot be opened."""
        self._opened.wait()
        if self.path is None and self.error is not None:
            raise self.error

    def tell(self) -> int:
        """Bytes that were written so far, as their writer counts them."""
        return self._given_bytes

    def write(self, data: bytes | bytearray) -> None:
        """Take ``data``, which does not change any more, for the next `flush`."""
        self._block.append(data)
        self._given_bytes += len(data)

    def flush(self) -> None:
        """Hand over to the thread what was written."""
        if self._block:
            self._given_s.append(self._clock.now())
            self._blocks.put(self._block)
            self._block = []

    def finish(self, write_end: Callable[[], object]) -> None:
        """Complete the file in the background; ``write_end`` writes its last part, and is called in the thread."""
        self._given_s.append(self._clock.now())
        self._blocks.put(write_end)
        self._finishing.set()

    def join(self, timeout_s: float) -> None:
        """Wait for the end, but not longer than this."""
        self._thread.join(timeout_s)

    def _run(self, open_file: Callable[[], FileIO]) -> None:
        try:
            with open_file() as file:
                self.path = Path(os.fsdecode(file.name)).absolute()
                self._opened.set()
                _keep_name(self.path.parent)
                self._write_all(file, self.path)
        except OSError as error:
            self.error = error
        finally:
            self._opened.set()

    def _write_all(self, file: FileIO, path: Path) -> None:
        at_end = False
        written = written_bytes = 0  # whole blocks
        try:
            while not at_end:
                # All that has come while the disk was busy is kept together.
                waiting = max(1, self._blocks.qsize())
                for _ in range(waiting):
                    block = self._blocks.get()
                    if not isinstance(block, list):
                        at_end = True
                        block()
                        block = self._block
                    for part in block:
                        rest = memoryview(part)
                        while rest:
                            rest = rest[file.write(rest) :]
                    written += 1
                    written_bytes += sum(map(len, block))
                _keep(file, path)
                self.kept_bytes = written_bytes
                for _ in range(waiting):
                    self._given_s.popleft()
                self._finishing.wait(REST_S)
        except OSError:
            with contextlib.suppress(OSError):
                if written > 1:
                    _keep(file, path)
                    self.kept_bytes = written_bytes
                elif _is_at(file, path):
                    # One block is the file's head. A file without contents would only be in the way.
                    path.unlink()
                    self.kept_bytes = 0
            raise


def _keep(file: FileIO, path: Path) -> None:
    """Ask the disk to keep what was written."""
    os.fdatasync(file.fileno())
    # A file that was deleted or moved away, or whose disk was taken out, can be written without an error.
    if not _is_at(file, path):
        raise FileNotFoundError(errno.ENOENT, "another file has taken its place", str(path))


def _is_at(file: FileIO, path: Path) -> bool:
    return os.path.samestat(path.stat(), os.fstat(file.fileno()))


def _keep_name(folder: Path) -> None:
    """Ask the disk to keep the new file's name; file systems without such a thing refuse."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
