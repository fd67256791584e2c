"""Read the files of thermometers without making the polling loop wait.

It gives the newest value of a file source with its time, if there is a new one. On a vehicle a thread reads the files
(`ThreadReader`), because a DS18B20 takes 0.75 s per value. With a virtual clock they are read in the loop
(`LoopReader`), so that a flight can be repeated exactly.
"""

import glob
import math
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple

from msp_range.clock import Clock
from msp_range.correction.temperature import FileSource
from msp_range.input_file import open_input

LONGEST_NUMBER_BYTES = 64
"""Largest size of a number [bytes]: those in hwmon and iio files have at most 12."""
LARGEST_FILE_BYTES = 2**16
"""Largest size of a file, by its folder [bytes]: those in /sys claim 4096, or a page of the computer."""
HANGS_S = 5.0
"""A read that takes longer is reported as hanging [s]: seven times the time of a DS18B20."""


class Sample(NamedTuple):
    """A value of a source [deg C], and the time at which the read started [s]."""

    time_s: float
    reported_c: float


def read_thermometer(source: FileSource) -> float:
    """Read the number in a source's file, in the file's unit.

    Raises
    ------
    OSError, ValueError
        There is no such file, it is a pipe, a device or a folder, or it does not contain a number.
    """
    paths = sorted(glob.glob(source.path))
    path = paths[0] if paths else source.path
    with open_input(path, LARGEST_FILE_BYTES) as file:
        content = os.read(file.fileno(), LONGEST_NUMBER_BYTES + 1)
    number = math.nan
    if len(content) <= LONGEST_NUMBER_BYTES:
        with suppress(ValueError):
            number = float(content)
    if not math.isfinite(number):
        raise ValueError(f"{path}: found {content[:20]!r}, expected a number")
    return number


class LoopReader:
    """Reads a file in the loop when it is due; for virtual clocks.

    Parameters
    ----------
    read
        The number in a source's file, in the file's unit; raises OSError or ValueError.
    on_error
        Called with an error message when what is wrong with a file changes, for the log.
    """

    def __init__(
        self,
        read: Callable[[FileSource], float] = read_thermometer,
        on_error: Callable[[str], object] = lambda text: None,
    ) -> None:
        self._read = read
        self._on_error = on_error
        self._errors: dict[FileSource, str] = {}
        self.next_s: dict[FileSource, float] = {}
        """Time at which the file of each source is read again [s]."""

    def newest(self, source: FileSource, now_s: float) -> Sample | None:
        """A new value, or None: reads the file if that is due."""
        if now_s < self.next_s.get(source, now_s):
            return None
        self.next_s[source] = now_s + source.period_s
        error_text, sample = "", None
        try:
            sample = Sample(now_s, self._read(source) * source.scale)
        except OSError as error:
            error_text = f"{error.filename or source.path}: {error.strerror or error}"
        except ValueError as error:
            error_text = str(error)
        if error_text and error_text != self._errors.get(source):
            self._on_error(error_text)
        self._errors[source] = error_text
        return sample

    def hangs(self, now_s: float) -> bool:
        """Whether a read started long ago and has not ended: never here, where the loop itself would hang."""
        return False


class ThreadReader(LoopReader):
    """A `LoopReader` in a thread of its own; the loop gets the newest values, and never waits.

    The thread starts with the first source. It is a daemon thread, so a hanging read does not keep the program from
    ending.

    Parameters
    ----------
    clock
        Time of the values.
    read, on_error
        As for `LoopReader`; called in the thread.
    """

    def __init__(
        self,
        clock: Clock,
        read: Callable[[FileSource], float] = read_thermometer,
        on_error: Callable[[str], object] = lambda text: None,
    ) -> None:
        super().__init__(read, on_error)
        self._clock = clock
        self._sources: list[FileSource] = []
        self._newest: dict[FileSource, Sample] = {}
        self._reading_since_s: float | None = None
        self._is_closed = False
        self._has_changed = threading.Event()
        self._thread = threading.Thread(target=self._run, name="thermometers", daemon=True)

    def newest(self, source: FileSource, now_s: float) -> Sample | None:
        """The newest value since the last call; the first call for a source starts reading it."""
        if source not in self._sources:
            self._sources.append(source)
            self._has_changed.set()
            if len(self._sources) == 1:
                self._thread.start()
        return self._newest.pop(source, None)

    def hangs(self, now_s: float) -> bool:
        """True if the thread has waited for a file for longer than `HANGS_S`."""
        since_s = self._reading_since_s
        return since_s is not None and now_s - since_s > HANGS_S

    def close(self) -> None:
        """End the thread; if it hangs in a read, it ends with the program."""
        self._is_closed = True
        self._has_changed.set()

    def _run(self) -> None:
        while not self._is_closed:
            for source in self._sources:
                self._reading_since_s = now_s = self._clock.now()
                if (sample := super().newest(source, now_s)) is not None:
                    self._newest[source] = sample
                self._reading_since_s = None
            wait_s = min(self.next_s.values()) - self._clock.now()
            self._has_changed.wait(max(wait_s, 0.0))
            self._has_changed.clear()
