"""The recording of a vehicle: one file after another, for as long as the service runs, whatever the disk does.

It looks like one `Recorder` to the bridge. Beneath it a file is opened in the background; after an hour, at a size, or
when the computer's clock was set, another one follows. When the disk is full, gone or hung the recorder says so and
begins a new file as soon as there is a disk again. Nothing here waits for the disk but `FlightRecorder.close`.
"""

import contextlib
import errno
import itertools
import os
import re
import shutil
from collections.abc import Callable, Mapping
from functools import partial
from io import FileIO
from pathlib import Path
from typing import Any

from msp_range.clock import Clock, stamp_of
from msp_range.input_file import file_stem
from msp_range.recording.background_file import BackgroundFile
from msp_range.recording.writer import Recorder

FILE_LASTS_S = 3600.0
"""After an hour a new file begins. While a file is written its index grows in memory, by 2 MB an hour, and when it is
cut it has none; a longer time makes both worse, a shorter one makes many files."""
FILE_BYTES = 32 * 2**20
"""At this size a new file begins: four times what four sensors record in an hour, and still quickly copied."""
CLOCK_SET_S = 60.0
"""When the computer's UTC has moved this far against its monotonic clock, it was set, and a new file begins under the
right date. Corrections of a clock that is right are far below, the years of a computer without a clock far above."""
RETRY_S = 5.0
"""Time between a fault of the disk and the next new file, and between tries; a shorter one finds the disk earlier, and
makes more changes to report where it comes and goes."""
START_FREE_BYTES = 16 * 2**20
"""Free space that a new file needs: an hour of four sensors fits twice. Without it a disk that is nearly full would be
found full again every few seconds."""
EARLIEST_UTC_S = 1_767_225_600.0
"""2026-01-01, before this program was written: a clock that is earlier has not been set, and names get no date."""


class FlightRecorder:
    """Records into new files of a folder.

    Parameters
    ----------
    folder
        Where the files go; made where it is not there.
    vehicle
        What the files' names begin with.
    clock
        The bridge's.
    files
        Texts to be kept in every file, see `Recorder`.
    on_file
        Called with the path of every new file that the disk has taken.
    on_failure
        Called with a sentence when the recording stops.

    Attributes
    ----------
    fault : str or None
        What is wrong, in a few words for the pilot; None while the disk takes what is recorded.
    path : pathlib.Path or None
        The newest file that the disk has taken; None while it takes none.
    """

    def __init__(
        self,
        folder: Path,
        vehicle: str,
        clock: Clock,
        *,
        files: Mapping[str, str] | None = None,
        on_file: Callable[[Path], None] = lambda path: None,
        on_failure: Callable[[str], None] = lambda text: None,
    ) -> None:
        self.fault: str | None = None
        self.path: Path | None = None
        self._open = partial(new_recording, folder, file_stem(vehicle))
        self._clock = clock
        self._files = files
        self._on_file = on_file
        self._on_failure = on_failure
        self._ending: list[Recorder] = []
        self._retry_s = float("-inf")
        self._is_reported = False
        self._recorder: Recorder | None = self._begin()

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        """Record one message, see `Recorder.write`."""
        if self._recorder is not None:
            self._recorder.write(topic, time_s, message)

    def flush_if_due(self, now_s: float) -> None:
        """Hand over to the disk what is due, begin a new file where it is time, and check `fault`."""
        for ending in self._ending:
            if ending.file.has_ended and ending.fault is None and ending.file.error is not None:
                self._on_failure(ending.failure())
        self._ending = [ending for ending in self._ending if not ending.file.has_ended]
        if self._recorder is None:
            # A disk that hangs has ended nothing: its last file has to end before there is another.
            if now_s >= self._retry_s and not self._ending:
                self._recorder = self._begin()
            return
        recorder = self._recorder
        recorder.flush_if_due(now_s)
        if recorder.fault is not None:
            if recorder.fault != self.fault:
                self._on_failure(recorder.failure())
            self.fault, self.path, self._retry_s = recorder.fault, None, now_s + RETRY_S
            self._end(recorder)
            self._recorder = None
            return
        if not self._is_reported and recorder.file.kept_bytes and recorder.file.path is not None:
            self._is_reported, self.fault, self.path = True, None, recorder.file.path
            self._on_file(self.path)
        lasts_s = now_s - recorder.start_s
        utc_moved_s = abs(self._clock.utc() - recorder.start_utc_s - lasts_s)
        if lasts_s >= FILE_LASTS_S or recorder.file.tell() >= FILE_BYTES or utc_moved_s >= CLOCK_SET_S:
            self._end(recorder)
            self._recorder = self._begin()

    def finish(self) -> None:
        """Record nothing more; what was recorded is completed in the background."""
        if self._recorder is not None:
            self._recorder.finish()
        self._recorder, self._ending, self._retry_s = None, [], float("inf")

    def close(self) -> None:
        """Finish the file, and wait until the disk has it; raises RecordingError where it does not."""
        recorder, self._recorder = self._recorder, None
        for unfinished in self._ending if recorder is None else [*self._ending, recorder]:
            unfinished.close()

    def _begin(self) -> Recorder:
        self._is_reported = False
        file = BackgroundFile(partial(self._open, self._clock.utc()))
        return Recorder(file, self._clock, files=self._files)

    def _end(self, recorder: Recorder) -> None:
        recorder.finish()
        self._ending.append(recorder)


def new_recording(folder: Path, name: str, utc_s: float) -> FileIO:
    """Make a new file in ``folder``, which is made where it is not there.

    It is called ``name-20261005T143000Z.mcap``; on a computer whose clock has not been set ``name-undated-0001.mcap``,
    with a number greater than all that are there, so that the files' order stays that of the flights.

    Raises
    ------
    OSError
        The folder or file cannot be made, or less than `START_FREE_BYTES` are free.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if shutil.disk_usage(folder).free < START_FREE_BYTES:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(folder))
    if utc_s >= EARLIEST_UTC_S:
        stem, first = f"{name}-{stamp_of(utc_s)}", 0
    else:
        stem = f"{name}-undated"
        pattern = re.compile(re.escape(stem) + r"-(\d+)\.mcap")
        matches = [pattern.fullmatch(path.name) for path in folder.iterdir()]
        first = max((int(match[1]) for match in matches if match), default=0) + 1
    for number in itertools.count(first):
        with contextlib.suppress(FileExistsError):
            return FileIO(folder / (f"{stem}-{number:04d}.mcap" if number else f"{stem}.mcap"), "x")
    raise AssertionError("numbers do not end")
