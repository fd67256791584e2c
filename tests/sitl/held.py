"""ArduCopter in somebody's hands: its own program, whose simulated sensors feel how a `HandHeld` vehicle is moved.

ArduPilot's interface for physics of other programs (libraries/SITL/SIM_JSON.cpp): it sends its outputs to a UDP port,
and takes a step of its simulation with each answer, a line of JSON with the time, angular rates, specific force,
attitude, position and velocity.
"""

import json
import math
import signal
import socket
import threading
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_range.clock import SystemClock
from msp_range.config import Airframe
from tests.sitl.arducopter import ArduCopter
from tests.support.hand_held import RESTS_M, HandHeld, Held

STEP_S = 0.0025
"""ArduCopter's own loop."""
SMOOTH_S = 0.25
"""Time constant with which hands follow what they mean to do [s], so that nothing jumps."""
GRAVITY_M_S2 = 9.80665
YAW_RAD = 0.3

Vector = NDArray[Any]


class SmoothlyHeld(HandHeld):
    """A vehicle in real time that follows the person's hands smoothly: what a filter of second order makes of them."""

    def __init__(self, mounted: Airframe, seed: int = 1) -> None:
        super().__init__(mounted, seed, clock=SystemClock())
        # Time [s]; height of the reference point [m], roll and pitch [deg]; how fast they change, and that.
        self._now = 0.0, np.array([RESTS_M, 0.0, 0.0]), np.zeros(3), np.zeros(3)

    def advance(self, now_s: float) -> tuple[Vector, Vector, Vector]:
        """Move on to a time of the clock; where it is, its rates and its accelerations."""
        flight_s = now_s - self._start_s
        before_s, at, rates, accelerations = self._now
        while before_s < flight_s:
            before_s += STEP_S
            meant = super().held(before_s)
            goal = np.array([meant.height_m, meant.roll_deg, meant.pitch_deg])
            accelerations = (goal - at) / SMOOTH_S**2 - 2.0 * rates / SMOOTH_S
            rates = rates + accelerations * STEP_S
            at = at + rates * STEP_S
        self._now = before_s, at, rates, accelerations
        return at, rates, accelerations

    def held(self, flight_s: float) -> Held:
        """How it is held at about the present [s]."""
        at_s, at, rates, _ = self._now
        return Held(*(at + rates * (flight_s - at_s)).tolist())


class HeldCopter(ArduCopter):
    """ArduCopter in hands.

    Parameters
    ----------
    folder
        For its files.

    Attributes
    ----------
    vehicle : SmoothlyHeld or None
        What is held; None: it stands on the floor.
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.vehicle: SmoothlyHeld | None = None
        self._physics = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._physics.bind(("127.0.0.1", 0))
        self._physics.settimeout(0.5)
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Start the program, and move it."""
        self._thread.start()
        super().start()

    def end(self, signum: signal.Signals = signal.SIGTERM) -> None:
        """End the program, then its physics."""
        super().end(signum)
        self._ended = True
        self._thread.join()
        self._physics.close()

    def _command(self) -> tuple[list[str], dict[str, str]]:
        words, environment = super()._command()
        words[words.index("--model") + 1] = "JSON:127.0.0.1"
        return [*words, "--sim-port-out", str(self._physics.getsockname()[1])], environment

    def _run(self) -> None:
        """Answer each of its outputs, at the pace of the clock.

        A step that comes late is as long as it took: a simulation that fell behind would feel the vehicle where its
        sensors saw it before.
        """
        clock = SystemClock()
        start_s = now_s = clock.now()
        while not self._ended:
            try:
                _, program = self._physics.recvfrom(256)
            except TimeoutError:
                continue
            clock.sleep_until(now_s + STEP_S)
            now_s = max(now_s + STEP_S, clock.now())
            self._physics.sendto(self._felt(now_s, now_s - start_s).encode(), program)

    def _felt(self, now_s: float, time_s: float) -> str:
        """What its sensors feel at a time of the clock, and of its simulation."""
        at, rates, accelerations = np.array([RESTS_M, 0.0, 0.0]), np.zeros(3), np.zeros(3)
        if self.vehicle is not None:
            at, rates, accelerations = self.vehicle.advance(now_s)
        roll, pitch = np.radians(at[1:]).tolist()
        roll_rate, pitch_rate = np.radians(rates[1:]).tolist()
        # Body rates of a vehicle whose heading stays, and the force that holds it up.
        gyro = (roll_rate, pitch_rate * math.cos(roll), -pitch_rate * math.sin(roll))
        up_m_s2 = GRAVITY_M_S2 + float(accelerations[0])
        force = (
            up_m_s2 * math.sin(pitch),
            -up_m_s2 * math.sin(roll) * math.cos(pitch),
            -up_m_s2 * math.cos(roll) * math.cos(pitch),
        )
        felt = {
            "timestamp": time_s,
            "imu": {"gyro": gyro, "accel_body": force},
            "position": (0.0, 0.0, RESTS_M - float(at[0])),
            "attitude": (roll, pitch, YAW_RAD),
            "velocity": (0.0, 0.0, -float(rates[0])),
        }
        return "\n" + json.dumps(felt) + "\n"
