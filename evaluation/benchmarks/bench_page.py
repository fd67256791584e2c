"""What the service costs while it flies, what its page costs it, and how soon a browser shows an echo.

`msp-range run` with four emulated sensors behind the kernel's I2C interface (umockdev), a recording and an autopilot
that sends what the bridge asks it for, once alone and once with a page that Chromium shows. Processor time and memory
are those of the kernel (/proc). umockdev emulates the bus in the process itself, with some messages to its server for
each transfer: what that costs is measured on the same bus by a program that makes the same transfers and nothing else,
and is taken off. What a real bus costs is not in it.
"""

import os
import shutil
import statistics
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import urlopen

from playwright.sync_api import sync_playwright
from pymavlink.dialects.v20 import ardupilotmega

from evaluation.benchmarks.bench_bridge import AIRFRAME
from evaluation.benchmarks.figure import Figures, at_most, figure
from msp_range.mavlink.inertial import ATTITUDE, WITNESSES
from tests.support.kernel_bus import KernelTestbed, Sonar, kernel_bus
from tests.support.mavlink_ends import Component
from tests.support.service import Autopilot, LinkEnd, running_service

MEASURED_S = 20.0
"""Time over which processor time is taken [s]: 200 readings."""
PORT = 18643
SAMPLES = """() => {
  window.samples = [];
  let last = 0;
  setInterval(() => {
    if (window.drawn.echoS !== last) { last = window.drawn.echoS; window.samples.push([last, window.drawn.atMs]); }
  }, 5);
}"""


def run() -> Figures:
    """Shares of a processor, memory and the delay to the screen."""
    sonars = [Sonar(0x70 + number, [300, 301, 299]) for number in range(4)]
    with kernel_bus(sonars) as testbed, tempfile.TemporaryDirectory() as folder:
        with _flying(testbed, Path(folder)) as (end, pid):
            before, began_s = len(testbed.journal()), time.monotonic()
            alone = _share(end, pid)
            transfers_per_s = (len(testbed.journal()) - before) / (time.monotonic() - began_s)
        emulation = transfers_per_s * _transfer_s(testbed)
        with _flying(testbed, Path(folder), "--web", str(PORT)) as (end, pid):
            page = _page_of(end, pid)
            watched, delays_s = _watched(end, pid)
            memory_mb = {name: _resident_mb(each) for name, each in (("bridge", pid), ("page", page))}
    late_s = statistics.quantiles(delays_s, n=20)[-1]
    return [
        figure(
            "service_processor", 100 * (alone - emulation), "% of one core, four sensors, recording on", at_most(2.0)
        ),
        figure("emulation_processor", 100 * emulation, "% of one core more for umockdev's emulated bus, see above"),
        figure(
            "page_cost_on_bridge",
            100 * (watched - alone),
            "% of one core more while a browser shows the page",
            at_most(3.0),
        ),
        figure("echo_to_pixel_p95", 1e3 * late_s, "ms from the echo to the frame in Chromium, 95 %", at_most(250.0)),
        figure("bridge_resident", memory_mb["bridge"], "MB in memory, watched", at_most(170.0)),
        figure("page_resident", memory_mb["page"], "MB in memory, the page's process", at_most(60.0)),
    ]


class Streaming(Autopilot):
    """It sends what the bridge asks an ArduPilot for, at those rates, without being asked."""

    def __init__(self) -> None:
        super().__init__()
        self._messages = Component(dialect=ardupilotmega)
        self._due_s = dict.fromkeys(WITNESSES["ardupilot"], time.monotonic())

    def due(self, now_s: float) -> list[bytes]:
        """Its heartbeat, and messages of a vehicle that hovers."""
        rates_hz = WITNESSES["ardupilot"]
        frames = super().due(now_s)
        for name in [each for each, due_s in self._due_s.items() if due_s <= now_s]:
            self._due_s[name] += 1.0 / rates_hz[name]
            frames.append(self._messages.frame(self._message(name, round(self.clock_ms(now_s)))))
        return frames

    @staticmethod
    def _message(name: str, boot_ms: int) -> Any:
        if name == ATTITUDE:
            return ardupilotmega.MAVLink_attitude_message(boot_ms, 0.01, 0.02, 0.3, 0.0, 0.0, 0.0)
        if name == "SCALED_PRESSURE":
            return ardupilotmega.MAVLink_scaled_pressure_message(boot_ms, 1013.25, 0.0, 2250)
        return ardupilotmega.MAVLink_raw_imu_message(1000 * boot_ms, 0, 0, -1000, 0, 0, 0, 0, 0, 0)


@contextmanager
def _flying(testbed: KernelTestbed, folder: Path, *options: str) -> Iterator[tuple[LinkEnd, int]]:
    """The service when it has flown for some seconds; the far end of its link, and its process."""
    with LinkEnd(autopilot=Streaming()) as end:
        feed = str(folder / "status.sock")
        arguments = ["--record", str(folder), "--socket", feed, *options]
        with running_service(testbed, end.url, folder, *arguments, airframe=AIRFRAME) as service:
            end.run_for(3.0)
            yield end, service.process.pid
            service.stop()


def _transfer_s(testbed: KernelTestbed) -> float:
    """Processor time of one emulated transfer [s]."""
    program: list[str | Path] = [sys.executable, Path(__file__).with_name("bus_cost.py"), str(MEASURED_S / 2)]
    return float(testbed.run(program).stdout) / 1e6


def _share(end: LinkEnd, pid: int) -> float:
    """Share of a processor that the process uses."""
    began_s, used_s = time.monotonic(), _processor_s(pid)
    end.run_for(MEASURED_S)
    return (_processor_s(pid) - used_s) / (time.monotonic() - began_s)


def _watched(end: LinkEnd, pid: int) -> tuple[float, list[float]]:
    """The share while a browser shows the page, and the delays from echoes to frames [s]."""
    program = shutil.which("chromium")
    if program is None:
        raise SystemExit("bench_page needs Chromium: apt install chromium")
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = chromium.new_page()
        page.goto(f"http://127.0.0.1:{PORT}/")
        page.wait_for_selector("#strips canvas")
        page.evaluate(SAMPLES)
        share = _share(end, pid)
        samples = page.evaluate("window.samples")
        chromium.close()
    # The bridge's clock is this computer's monotonic one, the browser's its UTC.
    ahead_s = time.time() - time.monotonic()
    return share, [at_ms / 1e3 - (echo_s + ahead_s) for echo_s, at_ms in samples]


def _page_of(end: LinkEnd, pid: int) -> int:
    """The page's process, once it serves."""

    def is_served() -> bool:
        try:
            with urlopen(f"http://127.0.0.1:{PORT}/", timeout=1.0):
                return True
        except URLError:
            return False

    end.run_until(is_served)
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def _processor_s(pid: int) -> float:
    """Processor time of a process so far [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(") ")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _resident_mb(pid: int) -> float:
    """Memory of a process that is in use [MB]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    raise RuntimeError(f"process {pid} is gone")
