"""Where a log's clock was set: from there on its times do not compare with those before, so a new run begins.

They are found in the times in the order in which they were written, whatever the format. A clock that goes back is seen
by itself; one that is set forward looks like a pause, so it takes a second clock that disagrees.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from msp_range.arrays import Array, Flags, Indices, numbered
from msp_range.recording.csv_form import MeasuredData

LEAST_BACK_S = 0.1
"""A clock that goes back by less is no step [s]: stamps of one sender may be written a little out of order, and NTP
steps only what is off by 0.128 s or more. Smaller: such stamps begin runs; larger: so long a time is interleaved."""
LEAST_FORWARD_S = 1.0
"""A clock that goes forward by this much more than another one, and stays there, was set [s]. Values are interpolated
over no longer pause, so smaller steps join nothing that is apart; radio links delay messages by as much."""
STAYS = 200
"""Messages before and after a step forward whose least differences of the clocks are compared: delays only add to them,
and a burst of messages that a radio link had kept is over by then, of 10 Hz after 20 s of silence. Fewer: such bursts
begin runs; more: two steps that follow each other are one."""
MESSAGES_A_STEP = 50
"""A sender with fewer messages for each step does not write in the order of time (a sorted table, two publishers of one
topic), and shows no steps. Fewer: such tables become runs of a few rows; more: short runs become one."""
ROUNDED_S = (1.0, 10.0, 100.0, 1000.0, 10_000.0)
"""Steps to which a clock may be rounded, as 12,345 s to four digits is [s]: two clocks differ by half of the step of
each. Without the larger ones the last readings of a slow table become a run."""
APART_S = 600.0
"""Pause between two runs on the continuous clock [s]: nothing is interpolated or aligned across it. Any value does that
is longer than the longest interval of a series."""


@dataclass(frozen=True)
class Stamps:
    """Times of one sender's messages in the order of the log."""

    place: NDArray[np.int64]
    """Position of each message in the log, increasing, in any unit that all senders share."""
    time_s: Array
    """Time of each message by the clock of the log [s]."""
    other_s: Array
    """Time of each message by another clock [s]; NaN where it is not known."""


@dataclass(frozen=True)
class ClockRun:
    """A part of a log without a step: where it begins on the continuous clock, by how much that is later, and the step
    before it [s]."""

    start_s: float
    later_s: float
    step_s: float = 0.0

    @property
    def note(self) -> str:
        """What happened at its beginning."""
        if self.step_s < 0.0:
            return f"The log's clock steps back by {-self.step_s:.3g} s: a new run begins."
        return f"The log's clock goes forward by {self.step_s:.3g} s where another clock does not: a new run begins."


def continuous(senders: Iterable[Stamps]) -> tuple[list[Array], tuple[ClockRun, ...]]:
    """Times on a clock that never steps, sender by sender, and the runs between the steps; no runs without a step.

    Examples
    --------
    >>> time_s = np.concatenate([np.arange(0.0, 40.0), np.arange(10.0, 50.0)])
    >>> (found_s,), runs = continuous([Stamps(np.arange(80), time_s, np.full(80, np.nan))])
    >>> print(found_s[38:42], [run.step_s for run in runs])
    [ 38.  39. 639. 640.] [0.0, -29.0]
    """
    senders = list(senders)
    steps = sorted((step for sender in senders for step in _steps(sender)), key=lambda step: step[1])
    cuts: list[tuple[int, float]] = []
    for before, after, step_s in steps:
        # One step is seen by each sender at its own next message.
        if not cuts or cuts[-1][0] <= before:
            cuts.append((after, step_s))
    if not cuts:
        return [sender.time_s for sender in senders], ()
    parts = [np.searchsorted([place for place, _ in cuts], sender.place, side="right") for sender in senders]
    all_parts = np.concatenate(parts)
    all_s = np.concatenate([sender.time_s for sender in senders])
    runs: list[ClockRun] = []
    end_s = -np.inf
    for number in range(len(cuts) + 1):
        times_s = all_s[(all_parts == number) & np.isfinite(all_s)]
        start_s = float(times_s.min()) if runs else float(times_s.min(initial=np.inf))
        later_s = end_s + APART_S - start_s if runs else 0.0
        runs.append(ClockRun(start_s + later_s, later_s, cuts[number - 1][1] if runs else 0.0))
        end_s = float(times_s.max(initial=-np.inf)) + later_s
    later = np.array([run.later_s for run in runs])
    return [sender.time_s + later[part] for sender, part in zip(senders, parts, strict=True)], tuple(runs)


def _steps(sender: Stamps) -> Iterator[tuple[int, int, float]]:
    """Steps that a sender shows: the places of its messages before and after, and by how much."""
    known = np.isfinite(sender.time_s)
    place, time_s = sender.place[known], sender.time_s[known]
    change_s = np.diff(time_s)
    found = np.flatnonzero(change_s < -LEAST_BACK_S).tolist()
    other_s = sender.other_s[known]
    ahead_s = time_s - other_s
    for at in np.flatnonzero((change_s > LEAST_FORWARD_S) & (np.diff(ahead_s) > LEAST_FORWARD_S)).tolist():
        sides = slice(max(0, at + 1 - STAYS), at + 1), slice(at + 1, at + 1 + STAYS)
        before_s, after_s = (np.nanmin(ahead_s[side]) for side in sides)
        rounded_s = sum(_step_of(clock_s[side]) for clock_s in (time_s, other_s) for side in sides) / 2.0
        if min(ahead_s[at + 1] - ahead_s[at], after_s - before_s) > LEAST_FORWARD_S + rounded_s:
            found.append(at)
    if len(found) * MESSAGES_A_STEP <= time_s.size:
        for at in found:
            yield int(place[at]), int(place[at + 1]), float(change_s[at])


def _step_of(time_s: Array) -> float:
    """The power of ten to which all of these times are rounded [s]; 0 where that is less than a second."""
    known = time_s[np.isfinite(time_s)]
    return max((step_s for step_s in ROUNDED_S if not np.any(known % step_s)), default=0.0)


def with_clock_runs(path: Path, table: MeasuredData, run_column: str = "run") -> tuple[MeasuredData, list[str]]:
    """A table in which each step of the clock begins a run, and a note for each of these.

    Parameters
    ----------
    path
        The file; runs without a name are called after it.
    table
        Its rows in the order of the file.
    run_column
        What distinguishes its runs; where there is no such column, it is one.
    """
    runs = table[run_column] if run_column in table else np.full(len(table), "")
    found, notes = runs.astype(object), []
    time_s = table["time_s"]
    for run in np.unique(runs).tolist():
        rows = np.flatnonzero(runs == run)
        senders = [rows[table["sensor"][rows] == name] for name in np.unique(table["sensor"][rows])]
        times_s, parts = continuous(_stamps(table, senders, time_s))
        if parts:
            # Rows that are there twice go back in time too.
            time_s = np.where(_is_repeated(table), np.nan, time_s)
            times_s, parts = continuous(_stamps(table, senders, time_s))
        for number, part in enumerate(parts[1:], start=2):
            name = f"{run or path.name.split('.')[0]}/{number}"
            notes.append(f"{part.note[:-1]}, {name}.")
            for sender, continuous_s in zip(senders, times_s, strict=True):
                found[sender[continuous_s >= part.start_s]] = name
    return (MeasuredData({**table.columns, run_column: found.astype(str)}) if notes else table), notes


def _stamps(table: MeasuredData, senders: list[Indices], time_s: Array) -> list[Stamps]:
    return [Stamps(rows, time_s[rows], table.column("uptime_s")[rows]) for rows in senders]


def _is_repeated(table: MeasuredData) -> Flags:
    """Rows that are equal to an earlier one in all columns."""
    codes = np.stack([numbered(column) for column in table.columns.values()], axis=1)
    repeated = np.ones(len(table), dtype=bool)
    repeated[np.unique(codes, axis=0, return_index=True)[1]] = False
    return repeated
