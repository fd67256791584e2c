"""From the start of the process ``msp-range run`` to the first DISTANCE_SENSOR on its link, again and again by kill -9.

Counted is all of it: starting Python, imports, reading the airframe and its sensor models, opening bus, link and
recording, the first two pings (100 ms apart: the fused stream starts when a second sensor agrees with the first), and
the way of the datagram. The sensors are emulated behind the kernel's I2C interface (umockdev), 3 m above the ground.
Bytecode is there, as after an installation with pip; where the processor and the disk are slower, so is the start.
"""

import itertools
import signal
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from evaluation.benchmarks.bench_bridge import AIRFRAME
from evaluation.benchmarks.figure import Figures, at_most, figure, under
from tests.support.kernel_bus import KernelTestbed, Sonar, kernel_bus
from tests.support.mavlink_ends import read_distance_sensor

STARTS = 9
"""Starts whose median is given: with fewer, one that other work on the computer delays would show."""
RESTART_S = 0.1
"""RestartSec of systemd/msp-range.service [s]: what passes between the death and the start again."""
COMMAND = Path(sys.executable).with_name("msp-range")


def run() -> Figures:
    """Medians of several starts, each ended by SIGKILL while it flies."""
    sonars = [Sonar(0x70 + number, [300]) for number in range(4)]
    with kernel_bus(sonars) as testbed, tempfile.TemporaryDirectory() as folder, _sink() as sink:
        flights = [_fly(testbed, sink, Path(folder)) for _ in range(STARTS + 1)]
    start_s = statistics.median(first_s - started_s for started_s, first_s, _ in flights)
    outages_s = [after[1] - before[2] for before, after in itertools.pairwise(flights)]
    return [
        figure(
            "start_to_first_message",
            start_s,
            "s, process start to the first DISTANCE_SENSOR, recording on",
            at_most(0.5),
        ),
        figure(
            "outage_by_kill",
            statistics.median(outages_s),
            "s, last message before kill -9 to the first after it, 0.1 s of RestartSec",
            under(3),
        ),
    ]


def _sink() -> socket.socket:
    sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sink.bind(("127.0.0.1", 0))
    sink.settimeout(30)
    return sink


def _fly(testbed: KernelTestbed, sink: socket.socket, folder: Path) -> tuple[float, float, float]:
    """Start, fly half a second, kill; times of the start and of the first and the last DISTANCE_SENSOR [s]."""
    url = f"udpout:127.0.0.1:{sink.getsockname()[1]}"
    command: list[str | Path] = [COMMAND, "run", AIRFRAME, "--link", url, "--bus", "1", "--record", folder]
    time.sleep(RESTART_S)
    started_s = time.perf_counter()
    with testbed.popen(command, stderr=subprocess.DEVNULL) as process:
        first_s = last_s = _next_distance_s(sink)
        while last_s < first_s + 0.5:
            last_s = _next_distance_s(sink)
        process.send_signal(signal.SIGKILL)
    return started_s, first_s, last_s


def _next_distance_s(sink: socket.socket) -> float:
    """When the next DISTANCE_SENSOR came [s]."""
    while read_distance_sensor(sink.recv(4096)) is None:
        pass
    return time.perf_counter()
