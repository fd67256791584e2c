"""Reading a dataflash log: how much faster than by pymavlink's recv_match, and the memory that an import takes.

The log is a flight of ArduCopter's simulator repeated, with three messages of another type after each of its own, as a
log has that is not cut to what an import reads.
"""

import contextlib
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from pymavlink.DFReader import DFReader_binary

from msp_lab.logs.ardupilot import WANTED, read_ardupilot

LOG = Path(__file__).parents[1] / "tests" / "data" / "logs" / "arducopter.BIN"
COMPARED_BYTES, IMPORTED_BYTES = 50_000_000, 1_000_000_000
_FORMAT = b"\xa3\x95\x80" + bytes((0x7F, 35)) + b"PADD" + b"QQQQ".ljust(16, b"\0") + b"A,B,C,D".ljust(64, b"\0")
_MESSAGE = b"\xa3\x95\x7f" + bytes(32)


def run() -> list[dict[str, Any]]:
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
        read_ardupilot(path, lambda share: None)
        faster = peer_s / (time.process_time() - started_s)
        path = Path(folder) / "imported.bin"
        _write(path, IMPORTED_BYTES)
        before_s = _children_s()
        command = [
            sys.executable,
            "-c",
            "from msp_lab.cli import main; main()",
            "import",
            str(path),
            "--out",
            folder + "/set",
        ]
        subprocess.run(command, check=True, capture_output=True)
        import_s = _children_s() - before_s
        peak_mb = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1e3
    return [
        _figure("import_dataflash_over_recv_match", faster, "times as fast", "at least 3", faster >= 3),
        _figure("import_dataflash_1_gb", import_s, "s of processor time", None, None),
        _figure("import_dataflash_1_gb_memory", peak_mb, "MB", "under 1000", peak_mb < 1000),
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


def _children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def _figure(key: str, value: float, unit: str, goal: str | None, met: bool | None) -> dict[str, Any]:
    return {"key": key, "value": round(value, 3), "unit": unit, "goal": goal, "met": met}


if __name__ == "__main__":
    for figure in run():
        print(figure)
