"""Importing logs of 1 GB: processor time and memory; a dataflash log also against pymavlink's recv_match.

The dataflash log is a flight of ArduCopter's simulator repeated, the telemetry log and the bag a made one. Three
messages of another type follow each of their own, as in a log that is not cut to what an import reads.
"""

import contextlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from pymavlink.DFReader import DFReader_binary
from rosbags.rosbag1 import Writer
from rosbags.typesys import Stores

from evaluation import ROOT
from evaluation.benchmarks.figure import Figures, at_least, figure, under
from msp_lab.logs.ardupilot import WANTED
from msp_lab.logs.opening import open_log
from msp_range.mavlink.dialect import dialect
from tests.support.flight_logs import START_S, START_US, Types, telemetry

LOG = ROOT / "tests" / "data" / "logs" / "arducopter.BIN"
COMPARED_BYTES, IMPORTED_BYTES = 50_000_000, 1_000_000_000
_IMPORT = """
import json, resource, sys
from msp_lab.cli import app
app(["import", sys.argv[1], "--out", sys.argv[2]], standalone_mode=False)
used = resource.getrusage(resource.RUSAGE_SELF)
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM"))
print(json.dumps([used.ru_utime + used.ru_stime, int(peak.split()[1]) / 1e3]), file=sys.stderr)
"""
"""Import one log, and print the processor time [s] and the largest memory [MB] of this process. Its ru_maxrss would
begin with the memory of the process that started it."""
FLIGHT_S = 30
"""Length of the flight of `tests.support.flight_logs`."""
_FORMAT = b"\xa3\x95\x80" + bytes((0x7F, 35)) + b"PADD" + b"QQQQ".ljust(16, b"\0") + b"A,B,C,D".ljust(64, b"\0")
_MESSAGE = b"\xa3\x95\x7f" + bytes(32)


def run() -> Figures:
    """All figures of this file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "compared.bin"
        _write(path, COMPARED_BYTES)
        started_s = time.process_time()
        with contextlib.closing(DFReader_binary(str(path))) as peer:
            while peer.recv_match(type=list(WANTED)) is not None:
                pass
        peer_s = time.process_time() - started_s
        started_s = time.process_time()
        open_log(path)
        faster = peer_s / (time.process_time() - started_s)
    return [
        figure("import_dataflash_over_recv_match", faster, "times as fast", at_least(3)),
        *_imported("dataflash", "log.bin", _write),
        *_imported("telemetry", "log.tlog", _write_telemetry),
        *_imported("bag", "log.bag", _write_bag),
    ]


def _imported(what: str, name: str, write: Callable[[Path, int], None]) -> Figures:
    """Figures of the import of a log of 1 GB, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write(path, IMPORTED_BYTES)
        done = subprocess.run(
            [sys.executable, "-c", _IMPORT, str(path), folder + "/set"], check=True, capture_output=True, text=True
        )
    used_s, peak_mb = json.loads(done.stderr.splitlines()[-1])
    return [
        figure(f"import_{what}_1_gb", used_s, "s of processor time"),
        figure(f"import_{what}_1_gb_memory", peak_mb, "MB", under(1000)),
    ]


def _write(path: Path, size: int) -> None:
    """The log again and again, later each time by a minute; other messages after each of its own."""
    with contextlib.closing(DFReader_binary(str(LOG))) as log:
        content = LOG.read_bytes()
        timed = {kind for kind, each in log.formats.items() if each.columns[:1] == ["TimeUS"]}
        places = sorted((at, kind, log.formats[kind].len) for kind, each in enumerate(log.offsets) for at in each)
    pieces, stamps = [_FORMAT], []
    length = len(_FORMAT)
    for at, kind, size_of_one in places:
        if kind in timed:
            stamps.append(length + 3)
        pieces += [content[at : at + size_of_one], 3 * _MESSAGE]
        length += size_of_one + 3 * len(_MESSAGE)
    flight = bytearray(b"".join(pieces))
    with path.open("wb") as file:
        while file.tell() < size:
            file.write(flight)
            for stamp in stamps:
                time_us = int.from_bytes(flight[stamp : stamp + 8], "little") + 60_000_000
                flight[stamp : stamp + 8] = time_us.to_bytes(8, "little")


def _write_telemetry(path: Path, size: int) -> None:
    """The flight again and again; other messages after each of its own."""
    link = dialect.MAVLink(None, 1, 1)
    other = dialect.MAVLink_servo_output_raw_message(0, 0, *[1500] * 8)
    pieces, sent_us = [], []
    for time_s, component, message in telemetry():
        link.srcComponent = component
        pieces += [message.pack(link), *[other.pack(link)] * 3]
        sent_us += [START_US + round(1e6 * time_s)] * 4
    flight = np.frombuffer(b"".join(bytes(8) + piece for piece in pieces), np.uint8).copy()
    starts = np.cumsum([0, *(8 + len(piece) for piece in pieces[:-1])])
    stamps_us = np.array(sent_us, np.dtype(">u8"))
    with path.open("wb") as file:
        while file.tell() < size:
            flight[starts[:, None] + np.arange(8)] = stamps_us.view(np.uint8).reshape(-1, 8)
            file.write(flight.tobytes())
            stamps_us += FLIGHT_S * 1_000_000


def _write_bag(path: Path, size: int) -> None:
    """The flight again and again in a bag of ROS 1, its stamps too; other messages after each of its own."""
    types = Types(Stores.ROS1_NOETIC)
    flight = [
        (
            round(1e9 * time_s),
            topic,
            message.__msgtype__,
            bytearray(types.store.serialize_ros1(message, message.__msgtype__)),
        )
        for time_s, topic, message in types.messages()
    ]
    other = types.make(
        "std_msgs/msg/UInt8MultiArray",
        layout=types.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0),
        data=np.zeros(200, np.uint8),
    )
    filling = bytes(types.store.serialize_ros1(other, other.__msgtype__))
    flight_bytes = sum(len(content) + 3 * len(filling) for *_, content in flight)
    with Writer(path) as bag:
        kinds = {topic: kind for _, topic, kind, _ in flight} | {"/other": other.__msgtype__}
        topics = {topic: bag.add_connection(topic, kind, typestore=types.store) for topic, kind in kinds.items()}
        for number in range(-(-size // flight_bytes)):
            for time_ns, topic, _, content in flight:
                # After the header's number come the seconds of its stamp.
                stamp_s = START_S + time_ns // 10**9 + FLIGHT_S * number
                content[4:8] = stamp_s.to_bytes(4, "little")
                bag.write(topics[topic], stamp_s * 10**9 + time_ns % 10**9, bytes(content))
                for _ in range(3):
                    bag.write(topics["/other"], stamp_s * 10**9 + time_ns % 10**9, filling)
