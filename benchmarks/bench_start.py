"""From the start of the process ``msp-range run`` to its first message on the link."""

import socket
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.bench_bridge import AIRFRAME

STARTS = 5


def run() -> list[dict[str, Any]]:
    """Median of several starts; there is no I2C bus, which the bridge reports and flies on with."""
    seconds = statistics.median(_start_s() for _ in range(STARTS))
    return [
        {
            "key": "start_to_first_message",
            "value": round(seconds, 2),
            "unit": "s",
            "goal": "under 4",
            "met": seconds < 4,
        }
    ]


def _start_s() -> float:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sink:
        sink.bind(("127.0.0.1", 0))
        sink.settimeout(30)
        url = f"udpout:127.0.0.1:{sink.getsockname()[1]}"
        command = [str(Path(sys.executable).with_name("msp-range")), "run", str(AIRFRAME)]
        options = ["--link", url, "--bus", "/nonexistent/i2c", "--no-record"]
        started_s = time.perf_counter()
        process = subprocess.Popen([*command, *options], stderr=subprocess.DEVNULL)
        try:
            sink.recv(4096)
            return time.perf_counter() - started_s
        finally:
            process.terminate()
            process.wait(10)
