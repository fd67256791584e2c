"""An ArduPilot dataflash log (.BIN) as a `VehicleLog`.

What the messages hold: https://ardupilot.org/copter/docs/logmessages.html. The height above the terrain (XKF5.HAGL) is
not used: it always is the range finder's, since EKF3's estimator of the terrain has no other source.

pymavlink indexes the messages and knows their formats; numpy takes the values of all messages of a type at once, where
pymavlink itself makes an object of each. A log of a gigabyte is read in pieces, each behind the format messages of
those before it, so memory does not grow with the file.
"""

import contextlib
import os
import re
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink import dfindexer
from pymavlink.DFReader import FORMAT_TO_STRUCT, DFFormat

from msp_lab.logs.fused import by_ekf2_of_ardupilot, by_ekf3, is_estimate
from msp_lab.logs.log import (
    CLIMB,
    THROTTLE,
    TILT,
    LoggedFlight,
    LogRequest,
    MessageColumns,
    Ranger,
    Series,
    TruthSource,
    VehicleLog,
    looks_down,
    magnitude,
    make_continuous,
    make_log,
    make_ranger,
    rounded_cm,
    struct_layout,
    truth_source,
)
from msp_range.arrays import Column
from msp_range.input_file import open_input
from msp_range.mavlink.orientation import DOWN
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import LARGEST_FILE_BYTES
from msp_sim.model.derived import tilt_deg

Progress = Callable[[float], None]
Messages = Mapping[str, Mapping[str, Column]]
"""Message -> field -> values, numbers as float64 in the unit of the log's format, texts as bytes."""

MAGIC = b"\xa3\x95"
PIECE_BYTES = 8 * 2**20
"""The log is read in pieces of this size: the index of one takes some 10 MB. Larger ones are not faster."""
MOST_BAD_BYTES = PIECE_BYTES // 8
"""After a piece with more bytes outside of messages nothing more is read: the log was cut there, or is none. One with a
few lost sectors has thousands; a larger number reads on through what has hardly any message."""
_FMT, _FMT_BYTES = 0x80, 89
"""The format message has this type and length in every log; its own type, length, name, format and field names follow
after 3 bytes of header (AP_Logger, LogStructure.h)."""
PLACE = "place"
"""Kept like a field: where in the file each message is. No field of a log has a name in small letters only."""
TEXTS = ("Name", "Message")
"""Fields that are texts, of all that are read; the others are numbers."""


_WEEK_S = 604_800.0
_STAMPS = (("TimeUS", 1e6), ("TimeMS", 1e3))
"""Fields with the time of a message, and how many of their units a second has."""
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


def read_ardupilot(path: Path, asked: LogRequest) -> VehicleLog:
    """Read a log; its fields are named ``MESSAGE.FIELD``."""
    message, _, field = asked.field.partition(".")
    wanted = WANTED | ({message: (*WANTED.get(message, ("TimeUS", "TimeMS")), field)} if field else {})
    found, lost = read_messages(path, wanted, asked.progress)
    flight = flight_of(found)
    clock = make_continuous(flight.values())
    parameters, version = _parameters(found), _version(found)
    context = {
        TILT: flight.combined("ATT", ("Roll", "Pitch"), lambda *angles: tilt_deg(*np.radians(angles))),
        CLIMB: flight.series("XKF1", "VD", -1.0) or flight.series("NKF1", "VD", -1.0),
        # Plane logs per cent.
        THROTTLE: flight.series("CTUN", "ThO", 0.01 if version.startswith("ArduPlane") else 1.0),
        "air_temperature_c": flight.series("ARSP", "Temp"),
        "board_temperature_c": flight.series("BARO", "Temp"),
        "vibration_m_s2": flight.combined("VIBE", ("VibeX", "VibeY", "VibeZ"), magnitude),
    }
    by_ekf = by_ekf2_of_ardupilot if "EK2_ALT_SOURCE" in parameters and "XKF1" not in flight else by_ekf3
    refused = by_ekf(parameters) if is_estimate(asked.field) else ""
    references = [
        *_references(flight, parameters),
        truth_source("column", flight.series(message, field), refused=refused),
    ]
    form = f"ArduPilot dataflash log, {version}"
    notes = (f"{lost}.",) if lost else ()
    return make_log(path, form, _rangers(flight, parameters), context, references, notes, clock)


def flight_of(found: Messages) -> LoggedFlight:
    """Messages with a time; those of several sensors or cores apart: the first one's by their name, others' with their
    number, as in ``BARO[1]``.

    The times of the satellites, which GPS has next to the log's own, are the other clock.
    """
    flight = LoggedFlight()
    for message, fields in found.items():
        stamp = next((fields[name] / per_s for name, per_s in _STAMPS if name in fields), None)
        if stamp is None or len({column.size for column in fields.values()}) > 1:
            continue  # it has no time, or the format of some of its messages is damaged
        other_s = np.full(stamp.size, np.nan)
        if "GMS" in fields and "GWk" in fields:
            other_s = np.where(fields["GWk"] > 0.0, _WEEK_S * fields["GWk"] + fields["GMS"] / 1e3, np.nan)
        of = next((fields[name] for name in ("Instance", "I", "C", "IMU") if name in fields), np.zeros(stamp.size))
        numbers = np.unique(of)
        for number in numbers:
            rows: Any = of == number if numbers.size > 1 else slice(None)
            name = message if number == numbers[0] else f"{message}[{number:g}]"
            values = {field: column[rows] for field, column in fields.items()}
            place = values.get(PLACE, np.arange(stamp[rows].size))
            flight[name] = MessageColumns(name, values, stamp[rows], place, other_s[rows])
    return flight


def _rangers(flight: LoggedFlight, parameters: Mapping[str, float]) -> list[Ranger]:
    rangers = []
    for rfnd in [messages for name, messages in flight.items() if name.partition("[")[0] == "RFND"]:
        if "Dist" in rfnd:
            number = int(rfnd.get("Instance", rfnd.get("I", 0.0)[0])[0])
            rangers.append(_ranger(number + 1, rfnd, ("Dist", "Orient"), parameters))
        else:  # before 4.0
            fields = [(n, (f"Dist{n}", f"Orient{n}")) for n in (1, 2) if f"Dist{n}" in rfnd]
            rangers += [_ranger(n, rfnd, each, parameters) for n, each in fields if rfnd[each[0]].any()]
    return rangers


def _ranger(number: int, rfnd: MessageColumns, fields: tuple[str, str], parameters: Mapping[str, float]) -> Ranger:
    """A range finder by the fields of its range and of the way that it looks."""
    maximum_m = _limit_m("MAX", number, parameters, np.inf)
    range_m, no_answer = rfnd[fields[0]], np.array(False)
    is_too_near = rounded_cm(range_m) < rounded_cm(_limit_m("MIN", number, parameters, 0.0))
    if "Stat" in rfnd:
        status = rfnd["Stat"]
        is_too_near, no_answer = status == _TOO_NEAR, status <= _NO_DATA
        if np.isfinite(maximum_m):
            range_m[status == _TOO_FAR] = maximum_m
    is_down = looks_down(rfnd.get(fields[1], DOWN))
    ranges = replace(rfnd.unsorted("Dist", range_m), source="RFND.Dist")
    return make_ranger(f"RNGFND{number}", ranges, is_down, np.array([maximum_m]), is_too_near, no_answer)


def _limit_m(limit: str, number: int, parameters: Mapping[str, float], otherwise_m: float) -> float:
    """MIN or MAX of a range finder [m]: metres from 4.7 on, before 4.0 the first one has no number."""
    value_cm = parameters.get(f"RNGFND_{limit}_CM", 100.0 * otherwise_m) if number == 1 else 100.0 * otherwise_m
    value_cm = parameters.get(f"RNGFND{number}_{limit}_CM", value_cm)
    return parameters.get(f"RNGFND{number}_{limit}", value_cm / 100.0)


def _references(flight: LoggedFlight, parameters: Mapping[str, float]) -> list[TruthSource | None]:
    numbers = [name.removeprefix("GPS") for name in flight if name.partition("[")[0] == "GPS"]
    # Of several receivers the first one that ever has a fixed solution.
    with_fix = [(found, number) for number in numbers if (found := flight.fixed(f"GPS{number}", "Status", "Alt"))]
    fixed, receiver = with_fix[0] if with_fix else (None, "")
    return [
        truth_source("simulator", flight.series("SIM", "Alt")),
        truth_source("rtk", fixed, std=flight.series(f"GPA{receiver}", "VAcc") or flight.series("GPA", "VAcc")),
        truth_source("mocap", flight.series("VISP", "PZ", -1.0)),
        truth_source("ekf", flight.series("XKF1", "PD", -1.0), refused=by_ekf3(parameters)),
        truth_source("ekf", flight.series("NKF1", "PD", -1.0), refused=by_ekf2_of_ardupilot(parameters)),
        truth_source("barometer", _barometer(flight, parameters)),
    ]


def _barometer(flight: LoggedFlight, parameters: Mapping[str, float]) -> Series | None:
    """The height by the barometer that the autopilot uses: of an ArduSub the one in the water, not that in the hull.

    BARO_PRIMARY counts from 0. In old versions it is GND_PRIMARY, and the second and third one have messages of their
    own.
    """
    wanted = parameters.get("BARO_PRIMARY", parameters.get("GND_PRIMARY", 0.0))
    senders = ({1.0: "BAR2", 2.0: "BAR3"}.get(wanted, ""), f"BARO[{wanted:g}]", "BARO")
    return next((found for sender in senders if (found := flight.series(sender, "Alt")) is not None), None)


def _parameters(found: Messages) -> dict[str, float]:
    """The values that parameters had last."""
    parm = found.get("PARM", {})
    names = [name.decode("ascii", "replace") for name in parm.get("Name", np.zeros(0, "S1")).tolist()]
    return dict(zip(names, parm.get("Value", np.zeros(0)).tolist(), strict=False))


def _version(found: Messages) -> str:
    texts = found.get("MSG", {}).get("Message", np.zeros(0, "S1")).tolist()
    named = (text.decode("ascii", "replace") for text in texts)
    return next((text for text in named if re.match(r"[\w:]+ V\d", text)), "unknown version")


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """Nothing on standard error: pymavlink's indexer, which is compiled, prints a line for each byte of no message."""
    kept, nowhere = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def read_messages(path: Path, wanted: Mapping[str, Sequence[str]], progress: Progress) -> tuple[Messages, str]:
    """Some messages of a log, and what was lost.

    Parameters
    ----------
    path
        The file.
    wanted
        Message -> fields; those that the log does not have are left out.
    progress
        Called with the share of the file that is read.

    Raises
    ------
    RecordingError
        It is no dataflash log, or is damaged throughout.
    OSError
        It cannot be read.
    """
    if not dfindexer.available:
        raise RecordingError(f"{path}: this pymavlink has no indexer for dataflash logs; install one from a wheel")
    found: dict[str, dict[str, list[Column]]] = {}
    formats, rest, bad = b"", b"", 0
    with open_input(path, LARGEST_FILE_BYTES) as file:
        size = file.seek(0, 2)
        file.seek(0)
        while new := file.read(PIECE_BYTES):
            begins, piece = len(formats), formats + rest + new
            offsets = _index(path, piece)
            # The last message may go on in the next piece, and is read with that one.
            end, in_messages = begins, 0
            for kind, form in _formats(piece, offsets[_FMT]).items():
                first, last = bisect_left(offsets[kind], begins), bisect_right(offsets[kind], len(piece) - form.len)
                places = offsets[kind][first:last]
                if places:
                    end = max(end, places[-1] + form.len)
                    in_messages += len(places) * form.len
                    if form.name in wanted:
                        columns = found.setdefault(form.name, {})
                        columns.setdefault(PLACE, []).append(np.array(places) + (file.tell() - len(piece)))
                        for name, values in _values(piece, places, form, wanted[form.name]):
                            columns.setdefault(name, []).append(values)
            bad += end - begins - in_messages
            rest = piece[end:]
            if len(piece) - begins - in_messages > MOST_BAD_BYTES:
                if not formats:
                    raise RecordingError(f"{path}: no dataflash log, or damaged at its beginning")
                bad += size - file.tell()
                break
            newest = {piece[at + 3]: piece[at : at + _FMT_BYTES] for at in offsets[_FMT]}
            formats = b"".join(message for message in newest.values() if len(message) == _FMT_BYTES)
            progress(file.tell() / size)
    joined = {name: {field: np.concatenate(parts) for field, parts in fields.items()} for name, fields in found.items()}
    bad += len(rest)
    return joined, f"{bad} bytes that belong to no message are left out" if bad else ""


def _index(path: Path, piece: bytes) -> list[list[int]]:
    """Places of the messages of each type in a piece that begins with the log's formats."""
    found: list[list[int]] = []
    if len(piece) >= _FMT_BYTES and MAGIC in piece:
        with _silent():
            found = dfindexer.build_offsets(memoryview(piece), _FMT, _FMT_BYTES, 3, 4, *MAGIC, progress_callback=None)
    if not found or not found[_FMT]:
        raise RecordingError(f"{path}: no dataflash log: it begins with {piece[:8]!r}")
    return found


def _formats(piece: bytes, places: Sequence[int]) -> dict[int, Any]:
    """Formats by the type of their messages, the last one of each."""
    found = {}
    for at in {piece[at + 3]: at for at in places if at + _FMT_BYTES <= len(piece)}.values():
        kind, length = piece[at + 3], piece[at + 4]
        name, form, fields = (
            piece[at + a : at + b].split(b"\0")[0].decode("ascii", "replace") for a, b in ((5, 9), (9, 25), (25, 89))
        )
        if not set(form) <= FORMAT_TO_STRUCT.keys():
            continue
        made = DFFormat(kind, name, length, form, fields)
        if 3 + struct_layout(made.msg_struct).itemsize <= length and len(made.columns) == len(made.msg_mults):
            found[kind] = made
    return found


def _values(piece: bytes, places: Sequence[int], form: Any, fields: Sequence[str]) -> Iterator[tuple[str, Column]]:
    """Some fields of all messages of one type in a piece."""
    layout = struct_layout(form.msg_struct)
    at = np.array(places, dtype=np.int64)
    content = np.frombuffer(piece, dtype=np.uint8)
    rows = content[at[:, None] + np.arange(3, 3 + layout.itemsize)].view(layout).reshape(-1)
    for name, column, factor in zip(form.columns, layout.names or (), form.msg_mults, strict=True):
        is_text = name in TEXTS
        if name not in fields or (layout[column].kind == "S") != is_text:
            continue  # not asked for, or the letter of its format is damaged
        with np.errstate(invalid="ignore"):  # bytes that are not a number
            yield name, rows[column] if is_text else rows[column].astype(float) * (factor or 1.0)
