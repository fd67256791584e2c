"""A vehicle that rises and sinks over level ground for hours, its emulated sensors, and the autopilot that judges.

A clock and a seed enter. Nothing is kept of what has flown but counts, so that memory that grows is the bridge's.
"""

import math
import random
from collections.abc import Iterator
from typing import Any

from msp_range.bridge import Bridge, Records
from msp_range.clock import Clock
from msp_range.mavlink.dialect import dialect
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import FAULT_KINDS, Fault
from msp_sim.device.mb1242 import NO_ECHO_CM, TIMING, EmulatedMB1242
from msp_sim.flight.autopilot import AutopilotSection, LoopbackAutopilot
from msp_sim.world.vehicle import Pose
from tests.support.bench import CALIBRATED_C, FUSED_ID, airframe

SIGMA_CM, SHORT, MISSED, RANDOM = 1.9445, 0.01, 0.02, 0.01
"""As in configs/sensors/mb1242.yaml."""
WRONG_M, WRONG_S = 0.5, 0.5
"""A distance is wrong that is farther off than this for longer than this, as in the fault campaign."""
FAULT_EVERY_S, FAULT_LASTS_S, LOCKED_S = (60.0, 240.0), (4.0, 40.0), (1.0, 8.0)
"""Time from the beginning of a fault to that of the next one, and how long one lasts; only one sensor has one."""
SETTLES_S = 3.0
"""So long after a fault the time of messages counts again [s]."""
BIN_S = 0.0005


class Delays:
    """Counts of delays in steps of half a millisecond, up to 2 s."""

    def __init__(self) -> None:
        self._counts = [0] * 4001

    def add(self, delay_s: float) -> None:
        """Count one."""
        self._counts[min(max(round(delay_s / BIN_S), 0), 4000)] += 1

    def quantile_ms(self, share: float) -> float:
        """The delay that this share does not exceed [ms]."""
        left = share * sum(self._counts)
        for i, count in enumerate(self._counts):
            left -= count
            if left <= 0:
                return 1e3 * i * BIN_S
        return math.inf


def height_m(time_s: float) -> tuple[float, float]:
    """Height above the ground [m] and how fast it grows [m/s]."""
    slow, fast = 2.0 * math.pi / 120.0, 2.0 * math.pi / 13.0
    return (
        3.0 + 2.0 * math.sin(slow * time_s) + 0.3 * math.sin(fast * time_s),
        2.0 * slow * math.cos(slow * time_s) + 0.3 * fast * math.cos(fast * time_s),
    )


def pose(time_s: float) -> Pose:
    """Level, over one place."""
    above_m, climb_m_s = height_m(time_s)
    return Pose(time_s, (0.0, 0.0, -above_m), 0.0, 0.0, 0.0, (0.0, 0.0, -climb_m_s))


def drawn_faults(draws: random.Random, until_s: float) -> Iterator[tuple[int, Fault]]:
    """Faults of one sensor after the other, each with the sensor's index."""
    time_s = draws.uniform(*FAULT_EVERY_S)
    while time_s < until_s:
        kind = draws.choice(list(FAULT_KINDS))
        lasts_s = draws.uniform(*(LOCKED_S if kind in ("locked_up", "power_cycle") else FAULT_LASTS_S))
        probability = 1.0 if kind in ("locked_up", "power_cycle") else draws.choice([1.0, 0.5, 0.2])
        spread_cm, offset_cm = draws.uniform(30.0, 500.0), draws.choice([-1, 1]) * draws.uniform(30.0, 300.0)
        fault = Fault(kind, time_s, time_s + lasts_s, probability, spread_cm=spread_cm, offset_cm=offset_cm)
        yield draws.randrange(4), fault
        time_s += lasts_s + draws.uniform(*FAULT_EVERY_S)


class Judge(LoopbackAutopilot):
    """An autopilot that compares each fused distance with the truth, and keeps counts only."""

    def __init__(self, clock: Clock, draws: random.Random, faults: list[Fault]) -> None:
        super().__init__(clock, pose, lambda _: CALIBRATED_C, AutopilotSection(), draw=draws)
        self.messages = self.wrong = 0
        self.worst_m = 0.0
        self.longest_gap_s = 0.0
        self.delays = Delays()
        self.answered_s = math.inf
        self._faults = sorted(faults, key=lambda fault: fault.start_s)
        self._next = 0
        self._calm_s = 0.0
        self._off_s: float | None = None
        self._usable_s = 0.0

    def send(self, frame: bytes) -> bool:
        """Judge a frame and forget it."""
        taken = super().send(frame)
        now_s = self._flight_s()
        for _, message in self.received:
            if message.get_msgId() == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR and message.id == FUSED_ID:
                self._on_distance(now_s, message)
        self._frames.clear()
        self._decoded.clear()
        return taken

    def _on_distance(self, now_s: float, message: Any) -> None:
        self.messages += 1
        while self._next < len(self._faults) and self._faults[self._next].start_s <= now_s:
            self._calm_s = self._faults[self._next].end_s + SETTLES_S
            self._next += 1
        if now_s >= self._calm_s:
            self.delays.add(now_s - self.answered_s)
            self.longest_gap_s = max(self.longest_gap_s, now_s - max(self._usable_s, self._calm_s))
        self._usable_s = now_s
        off_m = abs(message.current_distance / 100 - height_m(now_s)[0])
        if off_m <= WRONG_M:
            self._off_s = None
            return
        self.worst_m = max(self.worst_m, off_m)
        self._off_s = now_s if self._off_s is None else self._off_s
        if now_s - self._off_s > WRONG_S:
            self.wrong += 1
            self._off_s = now_s


class Vehicle:
    """Bridge, emulated sensors and autopilot.

    Parameters
    ----------
    clock
        Virtual, or the system's.
    seed
        Random seed of readings and faults.
    until_s
        How long it will fly [s]: for so long faults are drawn.
    recorder
        Keeps what the bridge records; may be None.

    Attributes
    ----------
    faults
        How many faults there will be.
    intervals
        Times between pings.
    """

    def __init__(self, clock: Clock, seed: int, until_s: float, recorder: Records | None) -> None:
        draws = random.Random(seed)
        faults = list(drawn_faults(draws, until_s))
        self.faults = len(faults)
        self.intervals = Delays()
        self._clock, self._start_s, self._draws = clock, clock.now(), draws
        self._pinged_s: float | None = None
        sensors = [
            EmulatedMB1242(
                0x70 + index,
                self.now_s,
                self._echo,
                faults=[fault for of, fault in faults if of == index],
                chance=random.Random(f"{seed} {index}"),
            )
            for index in range(4)
        ]
        self.judge = Judge(clock, random.Random(seed + 1), [fault for _, fault in faults])
        bus = EmulatedBus(sensors, self.now_s)
        self.bridge = Bridge(airframe(), bus, clock, self.judge, recorder=recorder)

    def now_s(self) -> float:
        """Time of the flight [s]."""
        return self._clock.now() - self._start_s

    def fly(self, until_s: float) -> None:
        """Step the bridge until a time of the flight [s]."""
        while self.now_s() < until_s:
            self.bridge.step()

    def _echo(self, ping_s: float) -> int:
        if self._pinged_s is not None:
            self.intervals.add(ping_s - self._pinged_s)
        self._pinged_s = ping_s
        reading_cm = self._reading_cm(height_m(ping_s)[0])
        self.judge.answered_s = ping_s + TIMING.ranging_s(reading_cm, NO_ECHO_CM)
        return reading_cm

    def _reading_cm(self, true_m: float) -> int:
        kind = self._draws.random()
        if kind < MISSED:
            return NO_ECHO_CM
        if kind < MISSED + SHORT:
            return self._draws.randint(20, round(100 * true_m))
        if kind < MISSED + SHORT + RANDOM:
            return self._draws.randint(20, NO_ECHO_CM - 1)
        return min(max(round(self._draws.gauss(100 * true_m, SIGMA_CM)), 20), NO_ECHO_CM)
