"""The simulated autopilot's barometer: what it reads in air, near the ground and in gusts; and its frames."""

import math
import random
from typing import Any

import numpy as np
import pytest
from pymavlink.dialects.v20 import common as mavlink

from msp_range.clock import VirtualClock
from msp_range.mavlink.dialect import dialect
from msp_sim.flight.autopilot import SEA_LEVEL_HPA, AutopilotSection, BarometerSection, LoopbackAutopilot, _frame
from msp_sim.world.vehicle import HOVER_THROTTLE, IDLE_THROTTLE, Pose


def pressure_heights_m(
    heights_m: list[float],
    errors: BarometerSection,
    throttle: float = HOVER_THROTTLE,
    seed: int | None = None,
    ground_c: float = 15.0,
) -> np.ndarray:
    """Heights of the standard atmosphere by the pressures of one message a second, at these heights of the feet."""
    clock = VirtualClock()

    def pose(time_s: float) -> Pose:
        height_m = heights_m[min(round(time_s), len(heights_m) - 1)]
        return Pose(time_s, (0.0, 0.0, -height_m), 0.0, 0.0, 0.0, (0.0, 0.0, 0.0), throttle, height_m)

    draw = None if seed is None else random.Random(seed)
    autopilot = LoopbackAutopilot(
        clock,
        pose,
        lambda pose: 15.0,
        AutopilotSection(barometer=errors),
        draw=draw,
        ground_c=ground_c,
    )
    received, parser = [], mavlink.MAVLink(None)
    for _ in heights_m:
        for message in parser.parse_buffer(bytearray(autopilot.receive())) or []:
            if message.get_type() == "SCALED_PRESSURE":
                received.append(-8434.0 * math.log(message.press_abs / SEA_LEVEL_HPA))
        clock.sleep_until(clock.now() + 1.0)
    return np.array(received)


def test_in_standard_air_it_reads_the_height() -> None:
    assert pressure_heights_m([0.0, 5.0, 100.0], BarometerSection(), ground_c=-15.0) == pytest.approx(
        [0.0, 5.0, 100.0], abs=0.02
    )


@pytest.mark.parametrize(("air_c", "scale"), [(-15.0, 1.1162), (15.0, 1.0), (40.0, 0.9202)])
def test_in_cold_air_it_reads_too_high(air_c: float, scale: float) -> None:
    """Pressure falls faster with height the colder the air is: by T / 288.15 K in the scale height."""
    read_m = pressure_heights_m([0.0, 50.0, 100.0], BarometerSection(in_air_temperature=True), ground_c=air_c)
    assert read_m == pytest.approx([0.0, 50.0 * scale, 100.0 * scale], abs=0.03)


def test_the_ground_effect_fades_with_the_height_and_grows_with_the_thrust() -> None:
    errors = BarometerSection(ground_effect_m=-2.0, ground_effect_height_m=0.8)
    heights_m = [0.0, 0.2, 0.4, 0.8, 3.0]
    read_m = pressure_heights_m(heights_m, errors)
    assert read_m - heights_m == pytest.approx([-2.0, -1.5, -1.0, 0.0, 0.0], abs=0.02)
    idle_m = pressure_heights_m([0.0], errors, throttle=IDLE_THROTTLE)
    assert idle_m == pytest.approx([-2.0 * IDLE_THROTTLE / HOVER_THROTTLE], abs=0.02)


def test_gusts_have_their_size_and_their_correlation_time() -> None:
    """Gauss-Markov: neighbours a second apart correlate by exp(-1 s / 4 s)."""
    count = 4000
    gusts = BarometerSection(gust_m=3.0, gust_s=4.0)
    # The same draws of noise cannot be had without gusts, but they are a twentieth; the drift's are taken out.
    read_m = pressure_heights_m([0.0] * count, gusts, seed=2)
    read_m -= np.convolve(read_m, np.ones(201) / 201, mode="same")
    assert read_m.std() == pytest.approx(3.0, rel=0.1)
    assert np.corrcoef(read_m[:-1], read_m[1:])[0, 1] == pytest.approx(math.exp(-0.25), abs=0.05)


@pytest.mark.parametrize("name", ["heartbeat", "system_time", "attitude", "scaled_pressure", "raw_imu", "command_ack"])
def test_its_frames_are_those_of_pymavlink(name: str) -> None:
    kind: Any = getattr(dialect, f"MAVLink_{name}_message")
    link = dialect.MAVLink(None, 1, 1)
    for count, sequence in ((len(kind.fieldnames), 0), (len(kind.fieldnames) - 1, 255)):
        for values in (range(3, 3 + count), [0] * count, [5, *[0] * (count - 1)]):
            link.seq = sequence
            padded = [*values, *[0] * (len(kind.fieldnames) - count)]
            assert _frame(kind, tuple(values), sequence) == kind(*padded).pack(link)
