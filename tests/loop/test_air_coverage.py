"""Flights in air of -20 to 45 C with each kind of temperature source: does the stated variance hold the truth?

The air is dry to saturated, with a dew point of at most 30 C: the simulated air has the temperature of dry air with the
same speed of sound, and the thermometers show the true one. What the sources are wrong by is drawn here from data
sheets and measurements, and not from the constants of `msp_range.correction.temperature`. Draws are stratified, so that
few flights cover what varies.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from msp_range.acoustics.air import sonic_temperature_c, vapour_fraction
from msp_range.clock import Clock, VirtualClock
from msp_range.correction.temperature import TemperatureParameters
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import TransportStats
from msp_sim.flight.autopilot import Tee
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import Scenario, Thermometer
from msp_sim.world.world import AirSection, WarmLayer
from tests.support.shipped import CONFIGS
from tests.support.slow import slow_but

FUSED_ID = 10
COLDEST_C, HOTTEST_C = -20.0, 45.0
FLIGHTS = 20
SCENARIO = Scenario.model_validate(
    {
        "name": "coverage",
        "airframe": "loopback.yaml",
        "duration_s": 11.0,
        "flight": {
            "altitude": [
                {"kind": "climb", "to_m": 6.0, "speed_m_s": 3.0, "acceleration_m_s2": 3.0},
                {"kind": "hold", "duration_s": 2.0},
                {"kind": "climb", "to_m": 3.0, "speed_m_s": 2.0, "acceleration_m_s2": 2.0},
                {"kind": "hold", "duration_s": 2.0},
            ]
        },
    },
    context={"folder": CONFIGS},
)

OfShare = Callable[[np.ndarray], np.ndarray]
"""Quantiles of a distribution."""


class Sensor:
    """The far end of a link at which an autopilot's further messages come in: one each second.

    A `msp_range.mavlink.transport.Transport`.
    """

    description, last_error, connected = "sensor", None, True
    quiet_until_s = float("-inf")
    files = ()

    def __init__(self, clock: Clock, message: Any) -> None:
        self.stats = TransportStats()
        self._clock, self._message = clock, message
        self._next_s = clock.now()
        self._mav = dialect.MAVLink(None, srcSystem=1, srcComponent=1)

    def send(self, frame: bytes) -> bool:
        return True

    def receive(self) -> bytes:
        if self._message is None or self._clock.now() < self._next_s:
            return b""
        self._next_s += 1.0
        return bytes(self._message.pack(self._mav))

    def close(self) -> None:
        """Nothing to release."""


def normal(mean_c: float, std_c: float) -> OfShare:
    return lambda share: norm.ppf(share, mean_c, std_c)


def uniform(low_c: float, high_c: float) -> OfShare:
    return lambda share: low_c + share * (high_c - low_c)


def mavlink(message: str, **keys: Any) -> dict[str, Any]:
    return {"sources": [{"source": "mavlink", "message": message, **keys}]}


def pressure(die_c: float = 60.0, airspeed_c: float = 0.0) -> Any:
    return dialect.MAVLink_scaled_pressure2_message(0, 1000.0, 0.0, round(100 * die_c), round(100 * airspeed_c))


ANYWHERE = uniform(COLDEST_C, HOTTEST_C)
THERMOMETER = normal(0.6, 0.9)
"""A third of a degree by the data sheets, and what sun and warm parts add: 0.6 on average, twice that and none too."""
IN_FLIGHT: dict[str, tuple[dict[str, Any], OfShare, OfShare, Callable[[float, float], Any] | None]] = {
    # A pilot's guess of the season, and the days and nights about it.
    "fixed": (
        {"fixed_c": 12.5},
        lambda share: normal(12.5, 12.0)(share).clip(COLDEST_C, HOTTEST_C),
        normal(0, 1),
        None,
    ),
    "file": ({"sources": [{"source": "file", "path": "temp1_input"}]}, ANYWHERE, THERMOMETER, None),
    "file, 4 C too warm, stated": (
        {"sources": [{"source": "file", "path": "temp1_input", "bias_c": 4.0}]},
        ANYWHERE,
        normal(4.0, 1.5),
        None,
    ),
    "airspeed": (
        mavlink("SCALED_PRESSURE2", field="temperature_press_diff"),
        ANYWHERE,
        normal(0.5, 2.0),
        lambda shown_c, percent: pressure(airspeed_c=shown_c),
    ),
    "hygrometer": (
        mavlink("HYGROMETER_SENSOR"),
        ANYWHERE,
        THERMOMETER,
        lambda shown_c, percent: dialect.MAVLink_hygrometer_sensor_message(
            0, round(100 * shown_c), round(100 * min(max(percent, 2.0), 100.0))
        ),
    ),
    "barometer": (
        mavlink("SCALED_PRESSURE2"),
        uniform(COLDEST_C, 30.0),  # and up to 60 C on the die: more is no air to the bridge
        uniform(3.0, 30.0),
        lambda shown_c, percent: pressure(die_c=shown_c),
    ),
    "barometer, 15 C too warm, stated": (
        mavlink("SCALED_PRESSURE2", bias_c=15.0),
        ANYWHERE,
        normal(15.0, 4.0),
        lambda shown_c, percent: pressure(die_c=shown_c),
    ),
}
"""Of each kind of source: the airframe's section, the air, how much warmer the source is, and its message of what it
shows [deg C, % of humidity]."""


def stratified(draw: np.random.Generator) -> np.ndarray:
    """Shares, one from each part of 0 to 1."""
    return (draw.permutation(FLIGHTS) + draw.random(FLIGHTS)) / FLIGHTS


def held(
    temperature: dict[str, Any],
    air_c: float,
    humidity_percent: float,
    over_ground_c: float,
    warmer_c: float,
    make: Callable[[float, float], Any] | None,
) -> list[bool]:
    """Of each distance sent in a flight, whether the truth is within 1.96 of its standard deviations."""
    shown_c = air_c + warmer_c
    # A hygrometer that is warmer than the air shows less of it, and is 2 % off.
    shown_percent = humidity_percent * vapour_fraction(air_c, 100.0) / vapour_fraction(shown_c, 100.0) + 2.0
    message = None if make is None else make(shown_c, shown_percent)
    sonic_c = sonic_temperature_c(air_c, humidity_percent)
    # Half a metre of warmer or colder air over the ground, which the vehicle's thermometer does not see.
    layer = WarmLayer(bottom_m=-1.0, top_m=0.5, warmer_by_c=over_ground_c)
    parameters = TemperatureParameters.model_validate(temperature)
    airframe = SCENARIO.airframe.model_copy(update={"temperature": parameters, "filters": ()})
    clock = VirtualClock()
    simulation = Simulation(
        SCENARIO.model_copy(
            update={
                "airframe": airframe,
                "air": AirSection(ground_c=sonic_c, warm_layer=layer),
                "thermometer": Thermometer(warmer_by_c=shown_c - sonic_c),
            }
        ),
        clock,
        seed=round(1e3 * (air_c + 100.0)),
        link=lambda autopilot: Tee(Sensor(clock, message), autopilot),
    )
    fused = simulation.flight.fused
    inside: list[bool] = []
    received = estimates = 0
    for _ in simulation.fly():
        new, received = simulation.received[received:], len(simulation.received)
        if len(fused.time_s) == estimates:
            continue
        estimates = len(fused.time_s)
        truth_m = fused.truth_m[-1]
        for _, sent in new:
            # Before its first second in flight no message of a source may have come.
            if sent.get_type() == "DISTANCE_SENSOR" and sent.id == FUSED_ID and truth_m and fused.time_s[-1] > 1.5:
                inside.append(abs(sent.current_distance - 100 * truth_m) <= 1.96 * math.sqrt(sent.covariance))
    return inside


@pytest.mark.parametrize("kind", slow_but({"file"}, IN_FLIGHT))
def test_the_stated_95_percent_hold_the_truth_90_to_99_percent_of_the_time(kind: str) -> None:
    temperature, of_air, of_error, message = IN_FLIGHT[kind]
    draw = np.random.default_rng(3)
    airs_c, warmer_c = of_air(stratified(draw)), of_error(stratified(draw))
    # 0.5 to 1.5 C on average between the vehicle and the ground, by its height.
    over_ground_c = uniform(-10.0, 14.0)(stratified(draw))
    saturated = vapour_fraction(airs_c, np.full(FLIGHTS, 100.0))
    moistest_percent = 100.0 * np.minimum(vapour_fraction(30.0, 100.0) / saturated, 1.0)
    humid_percent = moistest_percent * stratified(draw)
    draws = np.column_stack((airs_c, humid_percent, over_ground_c, warmer_c)).tolist()
    inside = [
        held(temperature, air_c, percent, layer_c, error_c, message) for air_c, percent, layer_c, error_c in draws
    ]
    assert all(len(each) > 70 for each in inside)
    share = np.mean([sum(each) / len(each) for each in inside])
    assert 0.90 <= share <= 0.99, f"{kind}: {100 * share:.1f} %"
