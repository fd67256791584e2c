"""`msp-range run` below a vehicle that its autopilot simulates, and killed and started anew as systemd would.

The sensors stand behind an emulated kernel's I2C interface (tests/support/kernel_bus.py) and read the simulator's true
height; the service knows nothing of it. So what is killed is what flies.
"""

import contextlib
import random
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from tests.sitl import documented
from tests.sitl.autopilot import STANDING_RANGE_M, Autopilot
from tests.sitl.documented import ROOT
from tests.sitl.ground_station import BRIDGE, CONFIGS
from tests.support.kernel_bus import KernelTestbed, Sonar, kernel_bus
from tests.support.service import COMMAND

ADDRESSES = (0x70, 0x71, 0x72, 0x73)
"""Of configs/loopback.yaml."""
FEED_S = 0.03
"""Between two updates of what the sensors read [s]: 8 cm in a climb at 2.5 m/s."""
STD_CM = 1.9
"""Of the readings, as configs/sensors/mb1242.yaml has it."""


class Service:
    """The service; use `running_service`."""

    def __init__(self, testbed: KernelTestbed, command: list[str], folder: Path) -> None:
        self._testbed = testbed
        self._command = command
        self._folder = folder
        self._process: subprocess.Popen[bytes]

    def start(self) -> None:
        """Start it."""
        with (self._folder / "msp-range.log").open("ab") as log:
            self._process = self._testbed.popen(self._command, stderr=log)

    def kill(self) -> float:
        """End it by SIGKILL; when that was [s, monotonic]."""
        self._process.kill()
        killed_s = time.monotonic()
        self._process.wait()
        return killed_s

    def kill_and_restart(self) -> float:
        """Kill it, and start it anew after the time that the systemd unit states; when it was killed."""
        killed_s = self.kill()
        time.sleep(documented.restart_s())
        self.start()
        return killed_s

    def pause(self, duration_s: float) -> float:
        """Stop it for a while; when it was stopped."""
        self._process.send_signal(signal.SIGSTOP)
        stopped_s = time.monotonic()
        time.sleep(duration_s)
        self._process.send_signal(signal.SIGCONT)
        return stopped_s

    @property
    def is_running(self) -> bool:
        return self._process.poll() is None


@contextlib.contextmanager
def running_service(autopilot: Autopilot) -> Iterator[Service]:
    """The service on the autopilot's link, with its recording; it starts on entering."""
    folder = autopilot.folder
    airframe = folder / "airframe.yaml"
    text = (CONFIGS / "loopback.yaml").read_text().replace("sensors/mb1242", f"{CONFIGS}/sensors/mb1242")
    text = text.replace("autopilot: ardupilot", f"autopilot: {autopilot.kind}")
    # At 22.5 C the sensor's own distances are right.
    airframe.write_text(text + "temperature: {fixed_c: 22.5}\n")
    command = [str(COMMAND), "run", str(airframe), "--link", autopilot.link, "--record", str(folder / "recordings")]
    # As an installation has it: without bytecode each start takes longer, and so does the outage of a restart.
    subprocess.run([sys.executable, "-m", "compileall", "-q", ROOT / "msp_range"], check=True)
    noise = random.Random(1)
    ended = threading.Event()

    with kernel_bus([Sonar(address, [20]) for address in ADDRESSES]) as testbed:

        def feed() -> None:
            while not ended.wait(FEED_S):
                range_cm = 100 * (autopilot.height_m() + STANDING_RANGE_M)
                readings_cm = [round(noise.gauss(range_cm, STD_CM)) for _ in ADDRESSES]
                testbed.set_readings([min(max(each, 20), 765) for each in readings_cm])

        thread = threading.Thread(target=feed, daemon=True)
        thread.start()
        service = Service(testbed, command, folder)
        service.start()
        try:
            yield service
        finally:
            ended.set()
            thread.join()


def outage_s(autopilot: Autopilot, event_s: float) -> float:
    """Time without a distance around an event, once it is over [s]: from the last message before to the first after."""

    def arrivals() -> list[float]:
        return [time_s for time_s, _ in autopilot.station.all("DISTANCE_SENSOR", BRIDGE)]

    after_s = autopilot.station.wait(
        "a distance after the outage", lambda: [each for each in arrivals() if each > event_s + 0.05]
    )
    return after_s[0] - max(each for each in arrivals() if each <= event_s + 0.05)
