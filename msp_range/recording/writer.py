"""The recording of a flight: every stage of every reading, as JSON in an MCAP file that survives a power cut.

Messages enter with the bridge's time, a file leaves that Foxglove, Lichtblick and the mcap tools open. Each second the
chunk in progress is finished, compressed and handed to a thread that writes it and asks the disk to keep it
(fdatasync). On an SD card that can take hundreds of milliseconds, also in the write itself while the file system's
journal is busy; the polling never waits for it. A power cut costs what was recorded in the last second or two, never
an earlier chunk.
"""

import contextlib
import os
import threading
from collections.abc import Mapping
from pathlib import Path
from queue import SimpleQueue
from typing import IO, Any, cast

import orjson
from mcap.writer import CompressionType, Writer

from msp_range.clock import Clock
from msp_range.recording.error import RecordingError
from msp_range.recording.topics import schema_of

FLUSH_INTERVAL_S = 1.0
"""A power cut loses about this much."""
BACKLOG_BYTES = 64 * 2**20
"""A disk that is further behind than this has stopped taking data."""
CLOSE_TIMEOUT_S = 5.0
"""How long `Recorder.close` waits for the disk."""
METADATA_NAME = "msp_range"
LIBRARY = "msp-range"


class Recorder:
    """Records messages on topics; see `msp_range.recording.topics` for what may be recorded.

    Parameters
    ----------
    path
        The file to make; an existing one is never overwritten.
    clock
        Its ``utc()`` is asked once, so that the file's times cannot jump when the computer's clock is set: a message
        at ``time_s`` gets the start's UTC plus the time on this clock since then.
    files
        The airframe file as ``airframe.yaml`` and the files that it names, by their relative paths, to be kept.
    metadata
        Whatever else names the flight.

    Raises
    ------
    RecordingError
        The file is there already or cannot be made.

    Notes
    -----
    A disk that fails raises RecordingError once, from `flush_if_due` or `close`; afterwards every call does nothing,
    so that the bridge can report it and fly on.
    """

    def __init__(
        self,
        path: Path | str,
        clock: Clock,
        *,
        files: Mapping[str, str] | None = None,
        metadata: dict[str, str] | None = None,
    ) -> None:
        self.path = Path(path)
        self._clock_start_s = clock.now()
        self._utc_start_ns = max(0, round(clock.utc() * 1e9))
        try:
            self._disk = _Disk(self.path)
        except FileExistsError:
            raise RecordingError(f"{path}: there is a file already, and a recording never overwrites one") from None
        except OSError as error:
            raise RecordingError(f"{path}: cannot be made: {error.strerror}") from None
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._mcap: Writer | None = Writer(cast(IO[bytes], self._disk), compression=CompressionType.ZSTD)
        self._mcap.start(library=LIBRARY)
        times = {"clock_start_s": repr(self._clock_start_s), "utc_start_ns": str(self._utc_start_ns)}
        self._mcap.add_metadata(METADATA_NAME, times | (metadata or {}))
        for name, text in (files or {}).items():
            self._mcap.add_attachment(self._utc_start_ns, self._utc_start_ns, name, "application/yaml", text.encode())
        self._mcap.flush()
        self._flush_due_s = self._clock_start_s + FLUSH_INTERVAL_S

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Record ``message`` at ``time_s`` on the bridge's clock.

        Values of None, NaN and infinity are unknown; they are recorded as null.

        Raises
        ------
        ValueError
            No such topic.
        TypeError
            A value that JSON does not have, or an integer of more than 64 bits.
        """
        if self._mcap is None:
            return
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._add_channel(self._mcap, topic)
        log_time_ns = self._utc_start_ns + round((time_s - self._clock_start_s) * 1e9)
        if log_time_ns < 0:  # the format has no times before its epoch
            log_time_ns = 0
        # Not a number and infinity become null as None does: a reader takes null and absent alike for unknown.
        self._mcap.add_message(channel, log_time_ns, orjson.dumps(message), log_time_ns)

    def flush_if_due(self, now_s: float) -> None:
        """Each second, hand over to the disk what was recorded; call it as often as you like.

        Raises
        ------
        RecordingError
            The disk is full, broken or has stopped; raised once.
        """
        if self._mcap is None or now_s < self._flush_due_s:
            return
        self._flush_due_s = now_s + FLUSH_INTERVAL_S
        self._mcap.flush()
        if self._disk.error is not None or self._disk.backlog_bytes > BACKLOG_BYTES:
            self._mcap = None
            self._disk.give_up()
            raise self._failure()

    def close(self) -> None:
        """Finish the file, and wait until the disk has it; raises RecordingError where it does not."""
        if self._mcap is None:
            return
        mcap, self._mcap = self._mcap, None
        mcap.finish()
        self._disk.flush()
        if not self._disk.close(CLOSE_TIMEOUT_S):
            raise self._failure()

    def _add_channel(self, mcap: Writer, topic: str) -> int:
        name, schema = schema_of(topic)
        if name not in self._schemas:
            self._schemas[name] = mcap.register_schema(name, "jsonschema", schema)
        self._channels[topic] = mcap.register_channel(topic, "json", self._schemas[name])
        return self._channels[topic]

    def _failure(self) -> RecordingError:
        error = self._disk.error
        why = error.strerror if error is not None else f"the disk is {self._disk.backlog_bytes} bytes behind"
        return RecordingError(
            f"{self.path}: recording stopped: {why}; the first {self._disk.written_bytes} bytes are there, "
            "and msp-range recover closes them"
        )


class _Disk:
    """The file that the MCAP writer writes to: it takes bytes at once, and a thread brings them to the disk."""

    def __init__(self, path: Path) -> None:
        self.error: OSError | None = None
        self.written_bytes = 0
        self._given_bytes = 0
        self._buffer: list[bytes] = []
        self._blocks: SimpleQueue[bytes | None] = SimpleQueue()
        self._gave_up = False
        self._file = path.open("xb", buffering=0)
        self._thread = threading.Thread(target=self._run, args=(path.absolute().parent,), name="recording", daemon=True)
        self._thread.start()

    @property
    def backlog_bytes(self) -> int:
        """What was handed over and is not written."""
        return self._given_bytes - self.written_bytes

    def tell(self) -> int:
        """Bytes written so far, as the writer counts them."""
        return self._given_bytes

    def write(self, data: bytes) -> None:
        """Keep ``data`` for the next `flush`."""
        self._buffer.append(data)
        self._given_bytes += len(data)

    def flush(self) -> None:
        """Hand over what was written."""
        if self._buffer:
            self._blocks.put(b"".join(self._buffer))
            self._buffer.clear()

    def give_up(self) -> None:
        """Write nothing more."""
        self._gave_up = True
        self._blocks.put(None)

    def close(self, timeout_s: float) -> bool:
        """Wait for the disk; True where it has everything."""
        self._blocks.put(None)
        self._thread.join(timeout_s)
        return self.error is None and not self._thread.is_alive()

    def _run(self, folder: Path) -> None:
        try:
            _keep_name(folder)
            while (block := self._blocks.get()) is not None and not self._gave_up:
                rest = memoryview(block)
                while rest:
                    rest = rest[self._file.write(rest) :]
                self.written_bytes += len(block)
                # A virtual flight makes many seconds in one; then the disk is asked less often.
                if self._blocks.empty():
                    os.fdatasync(self._file.fileno())
            os.fdatasync(self._file.fileno())
        except OSError as error:
            self.error = error
        finally:
            self._file.close()


def _keep_name(folder: Path) -> None:
    """Ask the disk to keep the new file's name; file systems without such a thing refuse."""
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
