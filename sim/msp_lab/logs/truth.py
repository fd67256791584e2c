"""Which reference a log is to be compared with, as ``--truth`` names it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from msp_lab.logs.fused import is_range
from msp_lab.logs.log import Series, TruthSource, VehicleLog
from msp_range.recording.csv_form import to_number
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError

RECORDED, OTHERS, NONE = "recorded", "others", "none"
KINDS = {
    RECORDED: "the log's own true_range_cm (our recordings, CSV)",
    "rtk": "altitude of a GNSS receiver with an RTK fix, over level ground",
    "mocap": "height by motion capture or an external pose",
    "ekf": "the autopilot's height, refused while the range is fused into it",
    "simulator": "what the autopilot's simulator knows",
    "barometer": "height by the barometer, which drifts by a metre",
    OTHERS: "for each sensor the other ones; three at least",
    NONE: "no true range",
}
"""Words of ``--truth`` that stand alone."""
BEST = ("simulator", "rtk", "mocap", "ekf")
"""Without ``--truth`` the first of these that a log has is used; a barometer only where it is asked for."""
INDEPENDENT = {"simulator", "rtk", "mocap", "barometer", "sensor", "column"}
"""References that are independent of each other; an EKF has the others fused into it."""


@dataclass(frozen=True)
class Truth:
    """What ``--truth`` asks for."""

    kind: str = ""
    """A key of `KINDS`, ``sensor``, ``column``, or empty: the best that the log has."""
    name: str = ""
    """Name of the sensor, or MESSAGE.FIELD of the column."""
    factor: float = 1.0
    """Factor from the column's unit to metres."""
    file: Path | None = None
    """Another log that has the reference, on a clock of its own; None: the log itself."""

    @property
    def field(self) -> str:
        """MESSAGE.FIELD that has to be read from the log; empty unless a column is asked for."""
        return self.name if self.kind == "column" else ""


def parse_truth(text: str) -> Truth:
    """What an option asks for.

    Raises
    ------
    ConfigError
        It is no source of a true range.

    Examples
    --------
    >>> parse_truth("column:LIDR.Dist*0.01")
    Truth(kind='column', name='LIDR.Dist', factor=0.01, file=None)
    >>> parse_truth("mocap@room.bag").file
    PosixPath('room.bag')
    >>> parse_truth("mocap@flights/x@y/room.bag").file
    PosixPath('flights/x@y/room.bag')
    """
    source, at, file = text.partition("@")
    if at:
        found = parse_truth(source)
        if found.kind in (RECORDED, OTHERS, NONE) or not file:
            raise ConfigError(f"--truth {text}: expected a reference that another file has, such as mocap@FILE")
        return replace(found, file=Path(file))
    kind, colon, name = text.partition(":")
    if text in KINDS:
        return Truth(text)
    if colon and name and kind == "sensor":
        return Truth(kind, name)
    if colon and name and kind == "column":
        column, star, factor = name.partition("*")
        try:
            return Truth(kind, column.strip(), to_number(factor) if star else 1.0)
        except ValueError:
            raise ConfigError(f"--truth {text}: found the factor {factor!r}, expected a number") from None
    known = "; ".join(f"{word}: {meaning}" for word, meaning in KINDS.items())
    raise ConfigError(
        f"--truth {text}: expected {known}; sensor:NAME: another range finder of the log; column:MESSAGE.FIELD*FACTOR: "
        "any field, in metres after the factor; SOURCE@FILE: the reference is in another file, on its own clock"
    )


def choose(log: VehicleLog, truth: Truth) -> TruthSource | None:
    """The reference that is asked for; None for what needs none.

    Raises
    ------
    RecordingError
        The log does not have it, or it is not independent of the range finder.
    """
    usable = {reference.kind: reference for reference in reversed(log.references) if not reference.refused}
    if truth.kind == "":
        if any("true_range_cm" in ranger.columns for ranger in log.rangers):
            return None
        return next((usable[kind] for kind in BEST if kind in usable), None)
    if truth.kind in (RECORDED, OTHERS, NONE):
        return None
    if truth.kind == "sensor":
        return _other_sensor(log, truth.name)
    if truth.kind == "column" and is_range(truth.name):
        raise RecordingError(
            f"{log.path}: --truth column:{truth.name}: that is what a range finder of this vehicle reads, and it would "
            f"be compared with itself; sensor:NAME compares with another one, and the log has {_names(log)}"
        )
    if truth.kind not in usable:
        refused = next((reference.refused for reference in log.references if reference.kind == truth.kind), "")
        there = ", ".join(sorted(usable)) or "none"
        if refused:
            raise RecordingError(
                f"{log.path}: --truth {truth.kind}: {refused}, and it would be compared with itself. Independent "
                f"references in the log: {there}"
            )
        named = f"column:{truth.name}" if truth.kind == "column" else truth.kind
        raise RecordingError(f"{log.path}: no {named} in this log. References that it has: {there}")
    found = usable[truth.kind]
    if truth.factor != 1.0:
        found = replace(found, series=replace(found.series, values=truth.factor * found.series.values))
    return found


def second(log: VehicleLog, first: TruthSource) -> TruthSource | None:
    """Another reference whose errors are independent of the first one's; None where there is none.

    A column counts as what it is: ``column:BARO.Alt`` is the barometer, and an EKF's height has the others fused in.
    """
    same = {reference.kind for reference in log.references if is_same(reference.series, first.series)}
    if not same | {first.kind} <= INDEPENDENT:
        return None
    independent = INDEPENDENT - same - {first.kind}
    return next(
        (reference for reference in log.references if reference.kind in independent and not reference.refused), None
    )


def is_same(one: Series, other: Series) -> bool:
    """Whether two series are the same field of a log, as ``column:`` may name a reference that is known anyway; their
    units may differ."""
    return one.source == other.source and np.array_equal(one.time_s, other.time_s)


def _other_sensor(log: VehicleLog, name: str) -> TruthSource:
    ranger = next((candidate for candidate in log.rangers if candidate.name == name), None)
    if ranger is None:
        raise RecordingError(f"{log.path}: no range finder {name!r} in this log; it has {_names(log)}")
    series = ranger.series
    range_m = Series(f"{name}: {series.source}", series.time_s, ranger.echoes_cm / 100.0)
    return TruthSource("sensor", range_m, True, True, ranger=name)


def _names(log: VehicleLog) -> str:
    return ", ".join(ranger.name for ranger in log.rangers) or "none"
