"""What the bridge costs on this computer: start time, processor time, delays and memory, without sensors or a link.

The airframe's bridge runs for some seconds in real time on sensors that answer at once with 3 m, and sends to nowhere.
Everything else is real: the schedule, the fusion, the messages and a recording in a temporary folder.
"""

import resource
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from statistics import quantiles
from tempfile import TemporaryDirectory

from msp_range.bridge import Bridge
from msp_range.clock import Clock, SystemClock
from msp_range.config import Airframe, load_airframe
from msp_range.doctor.finding import UNKNOWN, Finding, first_of, right
from msp_range.recording.flight_recorder import FlightRecorder
from msp_range.recording.replay_bus import ReplayBus
from msp_range.replay import Nowhere
from msp_range.sensors.base import RecordedPing

BENCH_S = 10.0
"""How long the bridge runs [s]: a hundred pings of four sensors. Longer gives steadier shares of the processor."""
RANGE_CM = 300
STARTS = 3
"""Starts, of which the shortest counts: the first may read the programs from the disk."""
START = (
    "import sys; from msp_range import service; from msp_range.config import load_airframe; load_airframe(sys.argv[1])"
)
LATE_S, BUSY_SHARE, SLOW_START_S = 0.02, 0.5, 2.5
"""From here on it is worth a look [s, share of a processor, s]: a fifth of the time between pings; half of what there
is; a start after which an autopilot that lands by range has given up (docs/sitl.md)."""


class _TimedNowhere(Nowhere):
    """Notes when each frame is sent."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock
        self.sent_s: list[float] = []

    def send(self, frame: bytes) -> bool:
        self.sent_s.append(self._clock.now())
        return super().send(frame)


def measure(path: Path, clock: Clock | None = None) -> Iterator[Finding]:
    """Each figure as a finding; unknown: worth a look."""
    clock = clock or SystemClock()
    airframe = load_airframe(path)
    start_s = min(_start_s(path, clock) for _ in range(STARTS))
    yield _judged("start", start_s > SLOW_START_S, f"{start_s:.2f} s from the command to the first ping")
    yield from _flown(airframe, clock)


def _start_s(path: Path, clock: Clock) -> float:
    """Python, the bridge's imports and the airframe file."""
    began_s = clock.now()
    subprocess.run([sys.executable, "-c", START, str(path)], check=True)
    return clock.now() - began_s


def _flown(airframe: Airframe, clock: Clock) -> Iterator[Finding]:
    # More than are used: at most one ping for each sensor in each interval.
    count = round(2 * BENCH_S / airframe.polling_interval_s) + 2
    pings = {
        # Not always the same: the bridge would take the sensors for stuck.
        sensor.address: [
            RecordedPing(0.0, RANGE_CM + i % 3, sensor.sensor_model.timing.answer_s(RANGE_CM)) for i in range(count)
        ]
        for sensor in airframe.sensors
    }
    bus = ReplayBus(pings, clock, {sensor.address: sensor.driver.playback for sensor in airframe.sensors})
    transport = _TimedNowhere(clock)
    pinged_s: list[float] = []
    with TemporaryDirectory() as folder:
        recorder = FlightRecorder(Path(folder), airframe.vehicle, clock, files=airframe.files)
        bridge = Bridge(airframe.without_thermometers, bus, clock, transport, recorder=recorder)
        began_s, used_s = clock.now(), _processor_s()
        delays_s = []
        while clock.now() < began_s + BENCH_S:
            sent_before = len(transport.sent_s)
            for step in bridge.step():
                pinged_s.append(step.ranging.ping_s)
                delays_s += [sent_s - step.ranging.answered_s for sent_s in transport.sent_s[sent_before:]]
        share = (_processor_s() - used_s) / (clock.now() - began_s)
        recorder.close()
    readings_per_s = len(pinged_s) / BENCH_S
    yield _judged(
        "processor", share > BUSY_SHARE, f"{100 * share:.1f} % of one, at {readings_per_s:.1f} readings a second"
    )
    if len(delays_s) > 1:
        late_s = quantiles(delays_s, n=100)[98]
        yield _judged("delay", late_s > LATE_S, f"99 % of messages go out within {1e3 * late_s:.1f} ms of the answer")
    interval_s = airframe.polling_interval_s
    # Sensors of one group ping together.
    gaps_s = [late - early for early, late in pairwise(pinged_s) if late - early > interval_s / 2]
    worst_s = max((abs(gap_s - interval_s) for gap_s in gaps_s), default=0.0)
    yield _judged("schedule", worst_s > LATE_S, f"no ping more than {1e3 * worst_s:.1f} ms away from its time")
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    yield right("memory", f"{memory_mb:.0f} MB")


def _processor_s() -> float:
    """Processor time of this process so far [s]."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _judged(step: str, is_odd: bool, text: str) -> Finding:
    return first_of(step, (is_odd, text, "is the computer busy with something else?", UNKNOWN), (True, text))
