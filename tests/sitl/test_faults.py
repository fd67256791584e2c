"""A real autopilot flies up and down while one of four sensors fails, and then all of them.

The faults are those of a scenario's `faults:`, which `msp-sim sitl --ground` flies; its times count from the start of
the program.
"""

import time
from pathlib import Path

import pytest

from tests.sitl.arducopter import ArduCopter
from tests.sitl.autopilot import TOP_M, Autopilot, running
from tests.sitl.figures import measure, note
from tests.sitl.ground_station import CONFIGS
from tests.sitl.kinds import both
from tests.sitl.msp_sim import MspSim, msp_sim

pytestmark = pytest.mark.real_time

LOWER_M = 4.0
FIRST_S, LASTS_S, APART_S = 90.0, 15.0, 20.0
"""The first fault begins this long after the start of `msp-sim sitl`, when every autopilot hovers, also on a busy
computer; how long each lasts, and how long after the one before it begins [s]."""
ONE_SENSOR = {
    "front_left": ("silent", "kind: silent"),
    "front_right": ("stuck at one value", "kind: stuck"),
    "rear_left": ("scatters by 1.5 m", "kind: noisy, spread_cm: 150"),
}
"""Sensor -> what it does, and that as YAML."""
NAMED = {"silent": ["no answer"], "stuck at one value": ["stuck at one value", "impossible answers"]}
"""What the pilot reads of them. A sensor that is stuck at 'no echo', or far beyond the ground, answers when the echo of
the ground comes, which is sooner than sound comes back from so far: impossible."""
ALL_S = FIRST_S + len(ONE_SENSOR) * APART_S
SENSORS = ("front_left", "front_right", "rear_left", "rear_right")


def scenario() -> str:
    faults = [
        f"{{sensor: {sensor}, {fault}, from_s: {start_s}, to_s: {start_s + LASTS_S}}}"
        for start_s, (sensor, (_, fault)) in zip(starts_s(), ONE_SENSOR.items(), strict=True)
    ]
    faults += [f"{{sensor: {sensor}, kind: silent, from_s: {ALL_S}, to_s: 600}}" for sensor in SENSORS]
    flight = "flight: {altitude: [{kind: climb, to_m: 1.0}, {kind: land}]}"
    airframe = f"airframe: {CONFIGS / 'loopback.yaml'}"
    return "\n".join(
        ["name: faults", airframe, "duration_s: 600", flight, "faults:", *(f"  - {each}" for each in faults)]
    )


def starts_s() -> list[float]:
    return [FIRST_S + index * APART_S for index in range(len(ONE_SENSOR))]


def wait_until(autopilot: Autopilot, simulation: MspSim, time_s: float) -> float:
    """Wait until a time of `msp-sim sitl`; that time [s, monotonic]."""
    remaining_s = simulation.start_s + time_s - time.monotonic()
    assert remaining_s > 0, f"{-remaining_s:.1f} s late: the computer is too slow for FIRST_S"
    autopilot.wait(remaining_s)
    return simulation.start_s + time_s


@both
def test_faults_in_flight(kind: type[Autopilot], tmp_path: Path) -> None:
    autopilot = kind(tmp_path)
    ground = tmp_path / "faults.yaml"
    ground.write_text(scenario())
    with running(autopilot):
        autopilot.get_ready()
        with msp_sim(autopilot, "--ground", str(ground)) as simulation:
            autopilot.take_off()
            for start_s, (sensor, (what, _)) in zip(starts_s(), ONE_SENSOR.items(), strict=True):
                begun_s = wait_until(autopilot, simulation, start_s)
                autopilot.wait(1.0)
                autopilot.go_to(LOWER_M)
                autopilot.wait_for_hover(LOWER_M)
                autopilot.go_to(TOP_M)
                wait_until(autopilot, simulation, start_s + LASTS_S)
                flown = measure(autopilot, begun_s, time.monotonic())
                note(autopilot, f"{sensor} {what}, 6 to 4 to 6 m", "flight continues", flown)
                assert autopilot.flies_as_commanded()
                assert flown.median_m < 0.15
                assert flown.p95_m < 0.5
                assert flown.healthy > 0.95
                if what in NAMED:
                    texts = autopilot.texts(begun_s)
                    assert any(f"Range {sensor}: {each}" in text for each in NAMED[what] for text in texts)
            all_silent(autopilot, wait_until(autopilot, simulation, ALL_S))


def all_silent(autopilot: Autopilot, begun_s: float) -> None:
    """No sensor answers any more: the autopilot and the pilot notice, and the vehicle comes down safely."""
    lost_s = autopilot.station.wait(
        "an unhealthy range finder",
        lambda: [time_s for time_s, good in autopilot.healthy() if time_s > begun_s and not good],
    )
    text_s = autopilot.station.wait(
        "a text to the pilot",
        lambda: [
            time_s
            for time_s, message in autopilot.station.received
            if time_s > begun_s and message.get_type() == "STATUSTEXT" and "Range" in message.text
        ],
    )
    height_m = autopilot.height_m()
    autopilot.wait(5.0)
    after = f"notices after {lost_s[0] - begun_s:.1f} s, text to the pilot after {text_s[0] - begun_s:.1f} s"
    assert text_s[0] - begun_s < 3.0
    if isinstance(autopilot, ArduCopter):
        # A take-off or target above the terrain is flown on the range finder alone (mode_guided.cpp).
        assert "Failsafe: Terrain Rangefinder Unhealthy" in autopilot.texts(begun_s)
        assert autopilot.mode() == ArduCopter.RTL
        autopilot.station.wait("disarmed after landing", lambda: not autopilot.station.is_armed())
        result = f"{after}; terrain failsafe, returns and lands"
    else:
        assert autopilot.flies_as_commanded()
        assert abs(autopilot.height_m() - height_m) < 1.5
        autopilot.land()
        result = f"{after}; holds its height by GNSS and barometer, lands on command"
    note(autopilot, "all four silent", result)
