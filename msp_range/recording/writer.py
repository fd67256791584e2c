"""One recording: every stage of every reading, as JSON in an MCAP file that survives a power cut.

Messages with the bridge's time are written to a file that Foxglove, Lichtblick and the mcap tools open. Twice a second
the chunk in progress is finished, compressed and handed to a thread that writes it and asks the disk to keep it; the
polling never waits for the disk. The chunk in progress and the last one are lost with the power, never an earlier one.
"""

from collections.abc import Mapping
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any

import orjson

from msp_range.clock import Clock
from msp_range.pilot_texts import DISK_FAULTS, Text
from msp_range.recording.background_file import BackgroundFile
from msp_range.recording.error import RecordingError, written
from msp_range.recording.mcap_writer import McapWriter
from msp_range.recording.topics import schema_of

FLUSH_INTERVAL_S = 0.4
"""Time after which a chunk is finished and handed to the disk, which is asked to keep it at once. The bridge asks every
0.25 s, which makes it 0.5 to 0.65 s; with a disk that needs up to 0.35 s the sum is at most the 1 s that a power cut or
SIGKILL may cost. A shorter time loses less, wears an SD card more, and makes the index larger."""
HUNG_AFTER_S = 10.0
"""A disk that has not kept a block for this long counts as hung. An SD card that is tidying up may take some seconds;
a larger value holds more in memory and reports later."""
BEHIND_S = 1.0
"""A recorder that waits does so for a disk that is farther behind [s]. Longer holds more in memory; shorter than some
0.3 s, which a disk takes to keep a block, slows down flights on quick disks."""
CLOSE_TIMEOUT_S = 5.0
"""How long `Recorder.close` waits for the disk; below the time after which systemd kills a service that is to stop."""
METADATA_NAME = "msp_range"
LIBRARY = "msp-range"


class Recorder:
    """Records messages on topics; see `msp_range.recording.topics` for what may be recorded.

    Parameters
    ----------
    file
        The path of the file to make; an existing one is never overwritten. Or a file that is being opened already, for
        those who must not wait for the disk.
    clock
        Its ``utc()`` is asked once, so that the file's times cannot jump when the computer's clock is set: a message
        at ``time_s`` gets the start's UTC plus the time on this clock since then.
    files
        The airframe file as ``airframe.yaml`` and the files that it names, by their relative paths, to be kept.
    metadata
        Whatever else names the flight.
    waits
        Whether `flush_if_due` waits for a slow disk, as a flight in simulated time has to: it records some hundred
        times as much in a second as a vehicle does.

    Attributes
    ----------
    file
        Its path, and what the disk has kept of it.
    start_s, start_utc_s
        When it was made: the clock's time, and its UTC [s].
    fault : str or None
        What is wrong with the disk, in a few words for the pilot; checked by `flush_if_due`. Nothing is recorded any
        more then, and `close` raises an error with the details.

    Raises
    ------
    RecordingError
        There is such a file already, or it cannot be made.
    """

    def __init__(
        self,
        file: Path | str | BackgroundFile,
        clock: Clock,
        *,
        files: Mapping[str, str] | None = None,
        metadata: dict[str, str] | None = None,
        waits: bool = False,
    ) -> None:
        self.fault: str | None = None
        self.start_s, self.start_utc_s = clock.now(), clock.utc()
        self._utc_start_ns = max(0, round(self.start_utc_s * 1e9))
        self.file = file if isinstance(file, BackgroundFile) else _make(Path(file))
        self._channels: dict[str, int] = {}
        self._mcap: McapWriter | None = McapWriter(self.file, LIBRARY)
        times = {"clock_start_s": repr(self.start_s), "utc_start_ns": str(self._utc_start_ns)}
        self._mcap.add_metadata(METADATA_NAME, times | (metadata or {}))
        for name, text in (files or {}).items():
            self._mcap.add_attachment(self._utc_start_ns, name, "application/yaml", text.encode())
        self._mcap.flush()
        self._flush_due_s = self.start_s + FLUSH_INTERVAL_S
        self._waits = waits

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
            channel = self._channels[topic] = self._mcap.add_channel(topic, *schema_of(topic))
        log_time_ns = self._utc_start_ns + round((time_s - self.start_s) * 1e9)
        if log_time_ns < 0:  # the format has no times before its epoch
            log_time_ns = 0
        # Not a number and infinity become null as None does: a reader takes null and absent alike for unknown.
        self._mcap.add_message(channel, log_time_ns, orjson.dumps(message))

    def flush_if_due(self, now_s: float) -> None:
        """Hand over to the disk what was recorded, where it is time, and check `fault`."""
        if self._mcap is None or now_s < self._flush_due_s:
            return
        self._flush_due_s = now_s + FLUSH_INTERVAL_S
        self._mcap.flush()
        if self._waits:
            self.file.wait_while_behind(BEHIND_S, HUNG_AFTER_S)
        error = self.file.error
        if error is not None:
            self.fault = DISK_FAULTS.get(error.errno or 0, Text.DISK_ERROR.format(errno=error.errno))
        elif self.file.behind_s > HUNG_AFTER_S:
            self.fault = Text.DISK_HANGS
        if self.fault is not None:
            self.finish()

    def finish(self) -> None:
        """Record nothing more; the file is completed in the background."""
        if self._mcap is not None:
            mcap, self._mcap = self._mcap, None
            self.file.finish(mcap.finish)

    def close(self) -> None:
        """Finish the file, and wait until the disk has it; raises RecordingError where it does not."""
        self.finish()
        self.file.join(CLOSE_TIMEOUT_S)
        if not self.file.has_ended or self.file.error is not None or self.fault is not None:
            raise RecordingError(self.failure())

    def failure(self) -> str:
        """What went wrong with the disk, in a sentence for the log."""
        error = self.file.error
        why = error.strerror if error is not None else "the disk does not answer"
        kept = self.file.kept_bytes
        there = f"the first {kept} bytes are kept, and msp-range recover closes them" if kept else "nothing is kept"
        path = self.file.path or getattr(error, "filename", None) or "the file"
        return f"{path}: recording stopped: {why}; {there}"


def _make(path: Path) -> BackgroundFile:
    file = BackgroundFile(partial(FileIO, path, "x"))
    with written(path):
        file.wait_until_open()
    return file
