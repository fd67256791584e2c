"""An ArduPilot dataflash log (.BIN) as a `VehicleLog`.

What the messages hold: https://ardupilot.org/copter/docs/logmessages.html. The height above the terrain (XKF5.HAGL) is
not used: it always is the range finder's, since EKF3's estimator of the terrain has no other source.
"""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from msp_lab.logs.dataflash import PLACE, Messages, Progress, read_messages
from msp_lab.logs.fused import by_ekf2_of_ardupilot, by_ekf3, is_estimate
from msp_lab.logs.log import (
    CLIMB,
    RTK_FIXED,
    THROTTLE,
    TILT,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    make_log,
    make_ranger,
    readings_cm,
    rounded_cm,
    series,
    truth_source,
)
from msp_lab.readings.clock_runs import ClockRun, Stamps, continuous
from msp_range.arrays import Column
from msp_range.mavlink.orientation import DOWN
from msp_sim.model.derived import tilt_deg

_WEEK_S = 604_800.0
_NO_DATA, _TOO_NEAR, _TOO_FAR = 1, 2, 3
"""RangeFinder::Status: nothing was read; nearer than RNGFNDx_MIN; beyond RNGFNDx_MAX (AP_RangeFinder.h)."""

WANTED = {
    "RFND": ("TimeUS", "TimeMS", "Instance", "I", "Dist", "Stat", "Orient", "Dist1", "Orient1", "Dist2", "Orient2"),
    "PARM": ("Name", "Value"),
    "MSG": ("Message",),
    "ATT": ("TimeUS", "TimeMS", "Roll", "Pitch"),
    "XKF1": ("TimeUS", "C", "VD", "PD"),
    "NKF1": ("TimeUS", "C", "VD", "PD"),
    "GPS": ("TimeUS", "I", "Status", "Alt", "GMS", "GWk"),
    "GPA": ("TimeUS", "I", "VAcc"),
    "VISP": ("TimeUS", "PZ"),
    "SIM": ("TimeUS", "Alt"),
    "BARO": ("TimeUS", "TimeMS", "I", "Alt", "Temp"),
    "BAR2": ("TimeUS", "TimeMS", "Alt"),
    "BAR3": ("TimeUS", "TimeMS", "Alt"),
    "ARSP": ("TimeUS", "I", "Temp"),
    "CTUN": ("TimeUS", "ThO"),
    "VIBE": ("TimeUS", "IMU", "VibeX", "VibeY", "VibeZ"),
}
"""Messages and fields that are read; names of old versions next to today's."""


def read_ardupilot(path: Path, progress: Progress, named_field: str = "") -> VehicleLog:
    """Read a log, as `msp_lab.logs.opening.open_log`; its fields are named ``MESSAGE.FIELD``."""
    message, _, field = named_field.partition(".")
    wanted = WANTED | ({message: (*WANTED.get(message, ("TimeUS", "TimeMS")), field)} if field else {})
    found, lost = read_messages(path, {name: (*fields, PLACE) for name, fields in wanted.items()}, progress)
    clock = _make_continuous(found)
    parameters = _parameters(found)
    context = {
        TILT: _attitude(found),
        CLIMB: _up(found, "XKF1", "VD") or _up(found, "NKF1", "VD"),
        THROTTLE: _throttle(found),
        "air_temperature_c": _first(found, "ARSP", "Temp"),
        "board_temperature_c": _first(found, "BARO", "Temp"),
        "vibration_m_s2": _vibration(found),
    }
    by_ekf = by_ekf2_of_ardupilot if "EK2_ALT_SOURCE" in parameters and "XKF1" not in found else by_ekf3
    refused = by_ekf(parameters) if is_estimate(named_field) else ""
    references = [
        *_references(found, parameters),
        truth_source("column", _first(found, message, field), refused=refused),
    ]
    form = f"ArduPilot dataflash log, {_version(found)}"
    notes = (f"{lost}.",) if lost else ()
    return make_log(path, form, _rangers(found, parameters), context, references, notes, clock)


def _make_continuous(found: Messages) -> tuple[ClockRun, ...]:
    """Put the times of all messages on a clock that never steps; the runs between the steps.

    The times of the satellites, which GPS has next to the log's own, are the other clock.
    """
    senders = []
    for fields in found.values():
        if not _has_time(fields) or PLACE not in fields or len({each.size for each in fields.values()}) > 1:
            continue  # the format of some of its messages is damaged
        instance = _instance(fields, np.zeros(fields[PLACE].size))
        other_s = np.full(fields[PLACE].size, np.nan)
        if "GMS" in fields and "GWk" in fields:
            other_s = np.where(fields["GWk"] > 0.0, _WEEK_S * fields["GWk"] + fields["GMS"] / 1e3, np.nan)
        senders += [(fields, np.flatnonzero(instance == each), other_s) for each in np.unique(instance)]
    stamps = [Stamps(each[PLACE][rows], _time_s(each)[rows], other_s[rows]) for each, rows, other_s in senders]
    times_s, runs = continuous(stamps)
    for (fields, rows, _), time_s in zip(senders, times_s, strict=True) if runs else ():
        name, factor = ("TimeUS", 1e6) if "TimeUS" in fields else ("TimeMS", 1e3)
        fields[name][rows] = factor * time_s
    return runs


def _rangers(found: Messages, parameters: Mapping[str, float]) -> list[Ranger]:
    rfnd = found.get("RFND", {})
    if not _has_time(rfnd):
        return []
    if "Dist1" in rfnd:  # before 4.0
        pairs = [(rfnd[f"Dist{n}"], rfnd.get(f"Orient{n}"), n) for n in (1, 2) if f"Dist{n}" in rfnd]
        return [
            _ranger(n, _time_s(rfnd), range_m, None, DOWN if facing is None else int(np.median(facing)), parameters)
            for range_m, facing, n in pairs
            if range_m.any()
        ]
    if "Dist" not in rfnd:
        return []
    instance = _instance(rfnd, np.zeros(rfnd["Dist"].size))
    rangers = []
    for each in np.unique(instance).tolist():
        rows = instance == each
        status = rfnd["Stat"][rows] if "Stat" in rfnd else None
        facing = int(np.median(rfnd["Orient"][rows])) if "Orient" in rfnd else DOWN
        rangers.append(_ranger(int(each) + 1, _time_s(rfnd)[rows], rfnd["Dist"][rows], status, facing, parameters))
    return rangers


def _ranger(
    number: int,
    time_s: Column,
    range_m: Column,
    status: Column | None,
    facing: int,
    parameters: Mapping[str, float],
) -> Ranger:
    maximum_m = _limit_m("MAX", number, parameters, np.inf)
    reading_cm = readings_cm(range_m, maximum_m)
    if status is None:
        is_too_near = rounded_cm(range_m) < rounded_cm(_limit_m("MIN", number, parameters, 0.0))
    else:
        is_too_near = status == _TOO_NEAR
        if np.isfinite(maximum_m):
            reading_cm[status == _TOO_FAR] = rounded_cm(maximum_m)
        reading_cm[status <= _NO_DATA] = np.nan
    found = Series("RFND.Dist", time_s, reading_cm)
    return make_ranger(f"RNGFND{number}", found, facing == DOWN, maximum_m, is_too_near)


def _limit_m(limit: str, number: int, parameters: Mapping[str, float], otherwise_m: float) -> float:
    """MIN or MAX of a range finder [m]: metres from 4.7 on, before 4.0 the first one has no number."""
    value_cm = parameters.get(f"RNGFND_{limit}_CM", 100.0 * otherwise_m) if number == 1 else 100.0 * otherwise_m
    value_cm = parameters.get(f"RNGFND{number}_{limit}_CM", value_cm)
    return parameters.get(f"RNGFND{number}_{limit}", value_cm / 100.0)


def _references(found: Messages, parameters: Mapping[str, float]) -> list[TruthSource | None]:
    gps = found.get("GPS", {})
    with_fix = gps.get("Status", np.zeros(0)) == RTK_FIXED
    # Of several receivers the first one that ever has a fixed solution.
    receiver = float(gps["I"][with_fix].min()) if with_fix.any() and "I" in gps else 0.0
    altitude, status = (_first(found, "GPS", each, receiver) for each in ("Alt", "Status"))
    fixed = None
    if with_fix.any() and altitude is not None and status is not None:
        fixed = replace(altitude, values=np.where(status.values == RTK_FIXED, altitude.values, np.nan))
    return [
        truth_source("simulator", _first(found, "SIM", "Alt")),
        truth_source("rtk", fixed, std=_first(found, "GPA", "VAcc", receiver)),
        truth_source("mocap", _up(found, "VISP", "PZ")),
        truth_source("ekf", _up(found, "XKF1", "PD"), refused=by_ekf3(parameters)),
        truth_source("ekf", _up(found, "NKF1", "PD"), refused=by_ekf2_of_ardupilot(parameters)),
        truth_source("barometer", _barometer(found, parameters)),
    ]


def _barometer(found: Messages, parameters: Mapping[str, float]) -> Series | None:
    """The height by the barometer that the autopilot uses: of an ArduSub the one in the water, not that in the hull.

    BARO_PRIMARY counts from 0. In old versions it is GND_PRIMARY, and the second and third one have messages of their
    own.
    """
    wanted = parameters.get("BARO_PRIMARY", parameters.get("GND_PRIMARY", 0.0))
    own_message = {1.0: "BAR2", 2.0: "BAR3"}.get(wanted, "")
    return _first(found, own_message, "Alt") or _first(found, "BARO", "Alt", wanted)


def _attitude(found: Messages) -> Series | None:
    roll, pitch = _first(found, "ATT", "Roll"), _first(found, "ATT", "Pitch")
    if roll is None or pitch is None:
        return None
    return Series("ATT", roll.time_s, tilt_deg(np.radians(roll.values), np.radians(pitch.values)))


def _throttle(found: Messages) -> Series | None:
    throttle = _first(found, "CTUN", "ThO")
    if throttle is None or not _version(found).startswith("ArduPlane"):
        return throttle
    return replace(throttle, values=throttle.values / 100.0)  # Plane logs per cent


def _vibration(found: Messages) -> Series | None:
    axes = [_first(found, "VIBE", f"Vibe{axis}") for axis in "XYZ"]
    known = [each for each in axes if each is not None]
    if len(known) < 3:
        return None
    return Series("VIBE", known[0].time_s, np.sqrt(sum(each.values**2 for each in known)))


def _first(found: Messages, message: str, field: str, wanted: float = 0.0) -> Series | None:
    """A field of a message; where there are several instances or cores that of the wanted one, or else the first."""
    fields = found.get(message, {})
    if field not in fields or not _has_time(fields):
        return None
    time_s, values = _time_s(fields), fields[field]
    instance = _instance(fields, np.zeros(0))
    name = message
    if instance.size:
        first = instance.min()
        taken = wanted if (instance == wanted).any() else first
        time_s, values = time_s[instance == taken], values[instance == taken]
        name = message if taken == first else f"{message}[{taken:g}]"
    return series(f"{name}.{field}", time_s, values)


def _instance(fields: Mapping[str, Column], otherwise: Column) -> Column:
    """Which of several sensors or cores each message is of."""
    return next((fields[name] for name in ("Instance", "I", "C", "IMU") if name in fields), otherwise)


def _up(found: Messages, message: str, field: str) -> Series | None:
    """A field that counts downwards, upwards."""
    down = _first(found, message, field)
    return None if down is None else replace(down, values=-down.values)


def _has_time(fields: Mapping[str, Column]) -> bool:
    return "TimeUS" in fields or "TimeMS" in fields


def _time_s(fields: Mapping[str, Column]) -> Column:
    return fields["TimeUS"] / 1e6 if "TimeUS" in fields else fields["TimeMS"] / 1e3


def _parameters(found: Messages) -> dict[str, float]:
    """The values that parameters had last."""
    parm = found.get("PARM", {})
    names = [name.decode("ascii", "replace") for name in parm.get("Name", np.zeros(0, "S1")).tolist()]
    return dict(zip(names, parm.get("Value", np.zeros(0)).tolist(), strict=False))


def _version(found: Messages) -> str:
    texts = found.get("MSG", {}).get("Message", np.zeros(0, "S1")).tolist()
    named = (each.decode("ascii", "replace") for each in texts)
    return next((each for each in named if re.match(r"[\w:]+ V\d", each)), "unknown version")
