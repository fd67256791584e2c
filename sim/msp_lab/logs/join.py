"""Readings of a log with their true range and context, in the columns of the CSV form.

For each range finder of a `VehicleLog` it makes a table with the reference, and says how it fits. A height above level
ground is the perpendicular distance that ``true_range_cm`` is, however the vehicle leans; a range along the beam is
multiplied by the cosine of the tilt. From a tilt of 90 deg on there is no true range: the beam does not meet the
ground.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from msp_lab.logs.alignment import LEAST_READINGS, Alignment, Interval, align, reference_std_cm
from msp_lab.logs.log import CLIMB, CONTEXT, TILT, Ranger, TruthSource, VehicleLog
from msp_lab.logs.truth import second
from msp_lab.readings.no_echo import NO_ECHO
from msp_range.arrays import Array, Column, Flags
from msp_range.recording.csv_form import MeasuredData
from msp_sim.effects.base import REFERENCE, REFERENCE_STD, TRUE_RANGE

RATE_STEP_S = 0.1
"""Without a vertical speed, the rate of the range is that of the reference over this long before and after [s].
Shorter: noise of the reference; longer: the ends of a climb are rounded."""
OVERTURNED_DEG = 90.0
"""From this tilt on a sensor that looks down does not see the ground, by geometry. Seen in logs: before the attitude is
known, and of a copter that crashes. It is also the largest ``incidence_deg`` of the CSV form."""
STEEP_DEG = 45.0
"""A line says how many readings with a height as true range are at larger tilts [deg]. There the beam meets the ground
more than 1.4 heights away, so a slope of the ground counts, and no sensor here is specified for it. Larger: fewer
lines, of what is rare in any flight; below 30 deg a quick flight would have the line."""


@dataclass(frozen=True)
class TruthAccuracy:
    """How well a reference is known: standard deviation of its error, and from what."""

    std_cm: Interval
    source: str


@dataclass(frozen=True)
class Joined:
    """A range finder's readings with everything that is known of them."""

    ranger: Ranger
    """The range finder."""
    data: MeasuredData
    """Its readings as a table, with true range and context."""
    alignment: Alignment | None = None
    """How its readings fit the reference; None: no reference, or hardly any reading with one."""
    error: TruthAccuracy | None = None
    """Accuracy of the reference; None: not known."""
    is_shifted: bool = False
    """Whether the lag was taken off."""
    notes: tuple[str, ...] = ()
    """Why readings have no true range, or what is worth knowing of it, a sentence each without a full stop."""


def join(
    log: VehicleLog, reference: TruthSource | None, rng: np.random.Generator, *, shift: bool = False
) -> list[Joined]:
    """Join the readings of every range finder with reference and context.

    Parameters
    ----------
    log
        The log.
    reference
        From `msp_lab.logs.truth.choose`; None: without a true range, or with the one that was recorded.
    rng
        For the bootstraps.
    shift
        Whether the readings' lag behind the reference is taken off. It is the range finder's latency, unless the two
        have different clocks.
    """
    joined = [_join(log, ranger, reference, rng, shift) for ranger in log.rangers]
    _add_neighbours(joined)
    return joined


def _join(
    log: VehicleLog, ranger: Ranger, reference: TruthSource | None, rng: np.random.Generator, shift: bool
) -> Joined:
    time_s = ranger.series.time_s
    columns: dict[str, Column] = {
        "time_s": time_s,
        "sensor": np.full(time_s.size, ranger.name),
        "reading_cm": ranger.series.values,
        NO_ECHO: np.full(time_s.size, ranger.maximum_cm),
    }
    for name in CONTEXT:
        if name in log.context and name not in (TILT, CLIMB):
            columns[name] = log.context[name].at(time_s)
    is_overturned = np.zeros(time_s.size, dtype=bool)
    tilt_deg = np.full(time_s.size, np.nan)
    if ranger.is_down and TILT in log.context:
        tilt_deg = log.context[TILT].at(time_s)
        is_overturned = tilt_deg >= OVERTURNED_DEG
        columns["incidence_deg"] = np.where(is_overturned, np.nan, tilt_deg)
    columns |= ranger.columns
    alignment = error = None
    is_shifted = False
    notes: list[str] = []
    if (overturned := int((is_overturned & np.isfinite(ranger.series.values)).sum())) > 0:
        notes.append(
            f"no true range and no incidence_deg for {_readings(overturned)} at a tilt of {OVERTURNED_DEG:g} deg or "
            "more: the beam does not meet the ground (a crash, or the attitude was not known yet)"
        )
    if reference is not None and _is_for(log, reference, ranger):
        answered = ranger.echoes_cm
        answered[is_overturned] = np.nan
        alignment = align(time_s, answered, lambda at: _expected_cm(log, reference, at), rng)
        lag_s = alignment.lag_s if shift and alignment is not None else None
        is_shifted, lag_s = lag_s is not None, lag_s or Interval(0.0, 0.0, 0.0)
        at_s = time_s - lag_s.value
        error = _error(log, reference, time_s, answered, alignment, rng)
        columns |= _true(log, reference, at_s, alignment, error, lag_s.std, ~is_overturned)
        if alignment is None and not reference.has_datum:
            there = int(np.isfinite(answered * reference.series.at(time_s)).sum())
            notes.append(
                f"no true range: found {_readings(there)} with an echo and {reference.series.source}, expected at "
                f"least {LEAST_READINGS} to find the constant between the two"
            )
        else:
            lost = np.isfinite(ranger.series.values) & ~np.isfinite(columns[TRUE_RANGE]) & ~is_overturned
            notes += _about_lost(reference, at_s[lost])
            steep = np.isfinite(ranger.series.values * columns[TRUE_RANGE]) & (tilt_deg > STEEP_DEG)
            if steep.any() and not reference.along_beam:
                notes.append(
                    f"the height is the true range of {_readings(int(steep.sum()))} at tilts above {STEEP_DEG:g} deg "
                    f"too, where the beam meets the ground more than {1.0 / np.cos(np.radians(STEEP_DEG)):.1f} heights "
                    "away: right only if the ground is level that far"
                )
    if ranger.is_down and CLIMB in log.context:
        columns["range_rate_cm_s"] = 100.0 * log.context[CLIMB].at(time_s)
    known = {name: column for name, column in columns.items() if column.dtype.kind != "f" or np.isfinite(column).any()}
    known.setdefault("reading_cm", columns["reading_cm"])
    return Joined(ranger, MeasuredData(known), alignment, error, is_shifted, tuple(notes))


def _is_for(log: VehicleLog, reference: TruthSource, ranger: Ranger) -> bool:
    """Whether a reference says something of a range finder: a height only of those that look down, and a sensor nothing
    of itself. A column may be a range along the beam where none of them looks down."""
    if reference.ranger == ranger.name:
        return False
    return ranger.is_down or (reference.kind == "column" and not any(other.is_down for other in log.rangers))


def _about_lost(reference: TruthSource, at_s: Array) -> list[str]:
    """How many readings at these times have no true range, and why; nothing for none."""
    found = reference.series.known()
    if not at_s.size or len(found) < 2:
        return []
    outside = int(((at_s < found.time_s[0]) | (at_s > found.time_s[-1])).sum())
    whose = "the reference or of the attitude" if reference.along_beam else "the reference"
    parts = [
        (outside, "before the reference begins or after it ends"),
        (at_s.size - outside, f"in holes of {whose} of more than {found.longest_hole_s:.3g} s"),
    ]
    listed = ", ".join(f"{count:,} {where}" for count, where in parts if count)
    return [f"no true range for {_readings(at_s.size)}: {listed}"]


def _readings(count: int) -> str:
    return f"{count:,} reading{'s' if count != 1 else ''}"


def _expected_cm(log: VehicleLog, reference: TruthSource, time_s: Array) -> Array:
    """Perpendicular distance by the reference, apart from a constant where it does not know the ground [cm]."""
    found_cm = 100.0 * reference.series.at(time_s)
    if reference.along_beam and TILT in log.context:
        found_cm = found_cm * np.cos(np.radians(log.context[TILT].at(time_s)))
    return found_cm


def _error(
    log: VehicleLog,
    reference: TruthSource,
    time_s: Array,
    answered_cm: Array,
    alignment: Alignment | None,
    rng: np.random.Generator,
) -> TruthAccuracy | None:
    """How well the reference is known, by another one next to it, or by its own word."""
    other = second(log, reference)
    if other is not None and alignment is not None:
        at = time_s - (0.0 if alignment.lag_s is None else alignment.lag_s.value)
        found = reference_std_cm(answered_cm, _expected_cm(log, reference, at), _expected_cm(log, other, at), rng)
        if found is not None:
            return TruthAccuracy(found, f"its differences to {other.series.source} and to the readings")
    if reference.std is not None and len(reference.std):
        std_cm = 100.0 * float(np.nanmedian(reference.std.values))
        return TruthAccuracy(Interval(std_cm, std_cm, std_cm), f"the receiver's own word ({reference.std.source})")
    return None


def _true(
    log: VehicleLog,
    reference: TruthSource,
    at_s: Array,
    alignment: Alignment | None,
    error: TruthAccuracy | None,
    lag_std_s: float,
    has_ground: Flags,
) -> Mapping[str, Column]:
    """Columns of the true range at these times; empty where the beam does not meet the ground."""
    true_cm = np.where(has_ground, _expected_cm(log, reference, at_s), np.nan)
    if not reference.has_datum:  # with too few readings to align it nothing is known of the range
        true_cm = true_cm + (alignment.offset_cm if alignment is not None else np.nan)
    rate_cm_s = (
        _expected_cm(log, reference, at_s + RATE_STEP_S) - _expected_cm(log, reference, at_s - RATE_STEP_S)
    ) / (2.0 * RATE_STEP_S)
    std_cm = np.hypot(0.0 if error is None else error.std_cm.value, np.nan_to_num(rate_cm_s) * lag_std_s)
    known = np.isfinite(true_cm)
    return {
        # To a hundredth of a millimetre, like the readings.
        TRUE_RANGE: np.round(true_cm, 3),
        REFERENCE_STD: np.where(known & (std_cm > 0.0), np.round(std_cm, 3), np.nan),
        "range_rate_cm_s": rate_cm_s,
        REFERENCE: np.where(known, reference.kind, ""),
    }


def _add_neighbours(joined: list[Joined]) -> None:
    """Time since the reading of another range finder and its true range, unless the log itself has them."""
    tables = [each.data for each in joined]
    for index, each in enumerate(joined):
        others = [table for table in tables if table is not each.data]
        if not others or "neighbour_lag_ms" in each.data or "run" in each.data:  # times of runs do not compare
            continue
        others_s = np.concatenate([other["time_s"] for other in others])
        order = np.argsort(others_s, kind="stable")
        last = np.searchsorted(others_s[order], each.data["time_s"], side="left") - 1
        row = order[np.maximum(last, 0)]
        lag_ms = np.where(last >= 0, 1e3 * (each.data["time_s"] - others_s[row]), np.nan)
        columns = {**each.data.columns, "neighbour_lag_ms": np.round(lag_ms, 3)}
        if all(TRUE_RANGE in other for other in others):
            range_cm = np.concatenate([other[TRUE_RANGE] for other in others])
            columns["neighbour_range_cm"] = np.where(last >= 0, range_cm[row], np.nan)
        joined[index] = replace(each, data=MeasuredData(columns))
