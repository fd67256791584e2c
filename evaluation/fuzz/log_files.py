"""Flight logs of ArduPilot, PX4, ground stations and ROS, changed in their bytes."""

import tempfile
from pathlib import Path
from random import Random

import numpy as np

from evaluation.fuzz import base, mutate
from msp_lab.logs.join import join
from msp_lab.logs.opening import open_log
from msp_lab.logs.truth import Truth, choose
from msp_range.input_file import CONTROL
from msp_range.recording.error import RecordingError
from tests.support.flight_logs import telemetry, write_bag, write_telemetry

LOGS = Path("tests/data/logs").absolute()
LONGEST = 60_000
"""Bytes of a log that are changed and read: its formats and some seconds of flight."""
ENDINGS = (".bin", ".ulg", ".tlog", ".bag", ".db3", ".mcap")


def fuzz(seconds: float, seed: int) -> base.FuzzResult:
    """Read changed logs for so long [s]."""
    with tempfile.TemporaryDirectory() as folder:
        whole = _logs(Path(folder))
    return base.run("logs", seconds, seed, lambda rng: _case(whole, rng), prepare)


def prepare(folder: Path) -> base.Check:
    """The check: read and join a log; only an error of the project in a plain line may come of it."""

    def check(data: bytes) -> None:
        path = folder / f"log{ENDINGS[data[0] % len(ENDINGS)]}" if data else folder / "log"
        path.write_bytes(data[1:])
        said = ""
        try:
            log = open_log(path)
            join(log, choose(log, Truth()), np.random.default_rng(1))
        except RecordingError as error:
            said = str(error).strip()
        assert not CONTROL.search(said)
        assert "\n" not in said

    check(bytes([0]) + (LOGS / "arducopter.BIN").read_bytes())
    check(bytes([1]) + (LOGS / "px4.ulg").read_bytes()[:LONGEST])
    check(bytes([3]) + b"#ROSBAG V2.0\n")
    return check


def _logs(folder: Path) -> list[bytes]:
    """A whole log of each kind, behind the number of its ending."""
    contents = [
        (LOGS / "arducopter.BIN").read_bytes(),
        (LOGS / "px4.ulg").read_bytes(),
        write_telemetry(folder / "a.tlog", telemetry()).read_bytes(),
    ]
    for form in ("ros1", "sqlite3", "mcap"):
        (folder / form).mkdir()
        path = write_bag(folder / form, form)
        files = [path] if path.is_file() else [each for each in path.iterdir() if each.suffix != ".yaml"]
        contents.append(files[0].read_bytes())
    return [bytes([number]) + content for number, content in enumerate(contents)]


def _case(whole: list[bytes], rng: Random) -> bytes:
    chosen = rng.choice(whole)
    # Logs of the autopilots are read from anywhere on; bags have an index at their end.
    if chosen[0] < 3:
        chosen = chosen[: rng.randrange(1, LONGEST)]
    return chosen[:1] + mutate.of_bytes(chosen[1:], rng)
