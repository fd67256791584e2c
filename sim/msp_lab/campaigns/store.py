"""The folder of a campaign: recordings, which are never changed, and the table that is made from them.

Every session writes one more recording (``session-001.mcap``, safe against power loss). Which points are done is read
back from all of them, so an interruption costs at most a second of readings. ``readings.csv`` is written again from the
recordings, in the order of the plan: for each point its last complete attempt, or the last one where none is complete.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import orjson

from msp_lab.campaigns.bench import KnownRanging
from msp_lab.campaigns.plan import Point
from msp_range.clock import Clock
from msp_range.reading import Status
from msp_range.recording.columns import CONTEXT_COLUMNS
from msp_range.recording.csv_form import MeasuredData, join_tables, write_csv
from msp_range.recording.error import RecordingError
from msp_range.recording.export import measured_data
from msp_range.recording.reader import Recording
from msp_range.recording.stages import answer_of
from msp_range.recording.topics import CAMPAIGN_TOPIC, RANGE_PREFIX, TRUTH_PREFIX
from msp_range.recording.writer import Recorder
from msp_sim.terminal import make_folder

READINGS_NAME = "readings.csv"
BENCH_KEY = "bench"
MOST_ATTEMPTS = 10_000
"""Refuse a recording with a higher number of an attempt: it is damaged, and every attempt up to it would be created.
No person repeats a point so often."""
_FAULTS = frozenset(status.value for status in Status if status.is_fault)


@dataclass
class Attempt:
    """One attempt at reading a point."""

    number: int
    """Number of the attempt, from 1."""
    runs: list[str] = field(default_factory=list)
    """Names of its sessions."""
    rangings: int = 0
    """Number of rangings, unanswered ones included."""
    readings: Counter[str] = field(default_factory=Counter)
    """Number of answers by sensor."""
    done: bool = False
    """Whether it was read to its end."""


def check_no_table(folder: Path, recording: str) -> None:
    """Refuse a ``readings.csv`` where there is no such recording; RecordingError with what to do."""
    table = folder / READINGS_NAME
    if table.exists():
        raise RecordingError(
            f"{table}: not collected here, since there is no {recording}, and it would be overwritten; name another "
            "folder with --out"
        )


class Store:
    """The folder of one campaign at one bench.

    Parameters
    ----------
    folder
        Created with the first reading if it does not exist.
    points
        The plan.
    bench
        Description of the bench; recordings of another one are refused.
    clock
        Clock of the bench.
    files
        The campaign file and the sensor model files, kept in each recording.

    Raises
    ------
    RecordingError
        The folder has recordings of another campaign or bench, or cannot be written.
    """

    def __init__(
        self, folder: Path, points: Sequence[Point], bench: str, clock: Clock, files: Mapping[str, str]
    ) -> None:
        self.folder = folder
        self._points = {point.name: point for point in points}
        self._bench = bench
        self._clock = clock
        self._files = dict(files)
        self._recorder: Recorder | None = None
        self._attempts: defaultdict[str, list[Attempt]] = defaultdict(list)
        recordings = self.recordings
        if not recordings:
            check_no_table(folder, "session-*.mcap next to it")
        for path in recordings:
            self._restore(Recording(path))

    @property
    def recordings(self) -> list[Path]:
        """The recordings of all sessions, in their order."""
        return sorted(self.folder.glob("session-*.mcap"))

    def attempts(self, point: Point) -> list[Attempt]:
        """Attempts at a point."""
        return self._attempts[point.name]

    def is_done(self, point: Point) -> bool:
        """Whether a point has been read to its end."""
        return any(attempt.done for attempt in self.attempts(point))

    def next_attempt(self, point: Point, *, again: bool) -> Attempt:
        """Return the attempt to read now: the one that was interrupted, or a new one.

        A movement cannot be resumed in its middle, so it starts again.
        """
        attempts = self.attempts(point)
        if attempts and not attempts[-1].done and not again and point.setup.movement is None:
            return attempts[-1]
        return Attempt(len(attempts) + 1)

    def begin(self, point: Point, attempt: Attempt, *, resumed: bool) -> None:
        """Start an attempt; with ``resumed`` its readings are in the same run as those before the interruption."""
        attempts = self.attempts(point)
        if attempt not in attempts:
            attempts.append(attempt)
        if not (resumed and attempt.runs):
            again = f".{attempt.number}" if attempt.number > 1 else ""
            part = f"+{len(attempt.runs)}" if attempt.runs else ""
            attempt.runs.append(f"{point.name}{again}{part}")
        self._write_event("begin", point, attempt)

    def keep(self, attempt: Attempt, known: KnownRanging) -> None:
        """Record a ranging of an attempt; raises RecordingError if the disk has failed."""
        ranging, columns = known
        reading = ranging.reading
        recorder = self._recording()
        recorder.write(TRUTH_PREFIX + reading.sensor, ranging.ping_s, {"run": attempt.runs[-1], **columns})
        recorder.write(RANGE_PREFIX + reading.sensor, ranging.answered_s, answer_of(ranging))
        recorder.flush_if_due(ranging.answered_s)
        if recorder.fault is not None:
            self.close()
        attempt.rangings += 1
        if not reading.status.is_fault:
            attempt.readings[reading.sensor] += 1

    def done(self, point: Point, attempt: Attempt) -> None:
        """Record that an attempt is complete."""
        attempt.done = True
        self._write_event("done", point, attempt)

    def close(self) -> None:
        """End the recording of this session; raises RecordingError if the disk did not accept it."""
        if self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            recorder.close()

    def readings(self) -> MeasuredData:
        """Return the readings of the attempts that count, in the order of the plan; empty where there was no answer."""
        rank: dict[str, int] = {}
        for name in self._points:
            attempts = self._attempts[name]
            complete = [attempt for attempt in attempts if attempt.done]
            for chosen in (complete or attempts)[-1:]:
                rank |= {run: len(rank) + number for number, run in enumerate(chosen.runs)}
        data = join_tables([measured_data(Recording(path), faults=False) for path in self.recordings])
        place = np.array([rank.get(run, -1) for run in data["run"].tolist()])
        data = data.select(np.argsort(place, kind="stable")[np.count_nonzero(place < 0) :])
        # A number that is not known is not equal to itself.
        return data.without(*(name for name in CONTEXT_COLUMNS if name in data and (data[name] != data[name]).all()))

    def write_table(self) -> tuple[Path, int]:
        """Write ``readings.csv`` if anything was read; return its path and its number of rows."""
        path = self.folder / READINGS_NAME
        if not self.recordings:
            return path, 0
        data = self.readings()
        write_csv(path, data, replacing=True)
        return path, len(data)

    def _recording(self) -> Recorder:
        if self._recorder is None:
            make_folder(self.folder)
            numbers = [int(path.stem.removeprefix("session-")) for path in self.recordings]
            path = self.folder / f"session-{max(numbers, default=0) + 1:03d}.mcap"
            self._recorder = Recorder(path, self._clock, files=self._files, metadata={BENCH_KEY: self._bench})
        return self._recorder

    def _write_event(self, event: str, point: Point, attempt: Attempt) -> None:
        message = {
            "event": event,
            "point": point.name,
            "attempt": attempt.number,
            "run": attempt.runs[-1],
            "readings": point.readings,
            "planned": _planned(point),
        }
        self._recording().write(CAMPAIGN_TOPIC, self._clock.now(), message)

    def _restore(self, recording: Recording) -> None:
        """Restore the attempts of an earlier session."""
        if BENCH_KEY not in recording.metadata and not recording.cut:
            raise RecordingError(f"{recording.path}: not a recording of a campaign; name another folder with --out")
        found = recording.metadata.get(BENCH_KEY, self._bench)
        if found != self._bench:
            raise RecordingError(
                f"{recording.path}: collected from {found}, and this is {self._bench}; name another folder with --out"
            )
        attempt: Attempt | None = None
        for topic, _, message in recording:
            if topic == CAMPAIGN_TOPIC:
                attempt = self._restore_event(recording.path, message)
            elif topic.startswith(RANGE_PREFIX) and attempt is not None:
                attempt.rangings += 1
                if message["status"] not in _FAULTS:
                    attempt.readings[topic.removeprefix(RANGE_PREFIX)] += 1

    def _restore_event(self, path: Path, message: dict[str, Any]) -> Attempt:
        name = message["point"]
        point = self._points.get(name)
        if point is None or _planned(point) != message["planned"]:
            how = "is not in it now" if point is None else _changed(message["planned"], point)
            raise RecordingError(
                f"{path}: the campaign has changed since: point {name} {how}; continue with the campaign file of that "
                "time (msp-lab collect keeps it in the recording), or name another folder with --out"
            )
        attempts = self._attempts[name]
        if not 1 <= message["attempt"] <= MOST_ATTEMPTS:
            raise RecordingError(
                f"{path}: point {name}: found attempt {message['attempt']}, expected 1 to {MOST_ATTEMPTS}"
            )
        while len(attempts) < message["attempt"]:
            attempts.append(Attempt(len(attempts) + 1))
        attempt: Attempt = attempts[message["attempt"] - 1]
        if message["run"] not in attempt.runs:
            attempt.runs.append(message["run"])
        attempt.done |= message["event"] == "done"
        return attempt


def _changed(planned: str, point: Point) -> str:
    try:
        before = orjson.loads(planned)
    except ValueError:
        before = None
    if not isinstance(before, dict):
        return "was changed (what it was cannot be read)"
    now = json.loads(_planned(point))
    names = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    changes = [f"{name} {before.get(name, 'none')}, now {now.get(name, 'none')}" for name in names]
    return f"was changed ({'; '.join(changes)})"


def _planned(point: Point) -> str:
    return json.dumps({**point.columns, "sensors": point.setup.sensors, "readings": point.readings}, sort_keys=True)
