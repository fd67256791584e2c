"""Sessions in flight: heights, climbs, tilts and times of day, as scenario files say them.

The columns to vary make a `Session`. The contexts are those of the vehicle's pings over flat ground; each flight is a
run.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from msp_lab.design.session import Columns, PlannedSession, chosen
from msp_range.config import Airframe
from msp_range.yaml_file import check
from msp_sim.flight.scenario import Scenario
from msp_sim.monte_carlo.outcome import pings_in_flight

HEIGHTS_M = (1.0, 2.2, 3.6)
"""Heights above ground at which the vehicle hovers if the range is varied."""
USUAL_HEIGHT_M = 1.8
"""Height above ground where it is not."""
TEMPERATURES_C = (2.0, 17.0, 32.0)
"""Air temperatures of flights in the early morning, before noon and on a hot afternoon, or in different weeks."""
SWING_M = 2.0
BRISK_S, GENTLE_S = 2.6, 6.0
"""Period of climbs and descents by `SWING_M` [s]: the brisk one takes the throttle from 0.2 to 0.8, the gentle one
changes the range by up to 1 m/s at nearly constant throttle."""
DASH_S = 3.0
"""Time of each dash forwards or back [s]; with `DASH_M_S2` it tilts the vehicle by up to 14 degrees."""
DASH_M_S, DASH_M_S2 = 3.0, 2.5
SETUP_MIN = 3.0
"""Time for each flight on the ground [min]: battery, reference, recording."""
WEATHER_MIN = 30.0
"""Time to wait for another air temperature [min]; it counts as much as ten flights."""
FLIGHTS = 6
"""Flights of a visit: the gap workflow splits runs into five parts, and six give each at least one. Fewer: what differs
between runs is not known; more: longer sessions."""
LONGEST_S = 600.0
"""A flight lasts at most so long [s]: a battery."""
FACTORS = ("true_range_cm", "range_rate_cm_s", "throttle", "incidence_deg", "air_temperature_c")
"""Context columns that a pilot can vary."""
REFERENCE_CM = 1.0
"""Standard deviation of an error of the true range that all readings of a flight share: another range finder. Larger:
what differs between flights counts less, and sessions become longer."""
TRUTH = (*FACTORS, "time_s", "sensor", "slant_range_cm", "uptime_s", "target")
"""Columns of a simulated ping."""
RECORDED = frozenset(
    {*FACTORS, "sensor", "run", "target", "slant_range_cm", "previous_reading_cm", "uptime_s", "time_in_run_s"}
)
"""Columns of a simulated flight. Of a real one the reference and the autopilot's log have to give them."""

INSTEAD = {
    "vibration_hz": "rotors shake the vehicle at frequencies that nobody sets, and stronger with more throttle, which "
    "looks the same; hold the sensor on a shaker with the rotors off (--bench), or fly with a hard and with a soft "
    "mount, one recording each, and compare the two",
    "neighbour_lag_ms": "the bridge lets the sensors ping in turn, always in the same order; let two sensors ping "
    "together and in turn (--bench), or unplug the neighbour for a flight and compare the two recordings",
    "humidity_pct": "no pilot sets it; use wet cloths in a closed room (--bench)",
    "target_temperature_c": "the ground's temperature is not recorded; warm the far end (--bench)",
    "target_size_cm": "the ground is wider than any beam; use boards of several sizes (--bench)",
    "external_level_db": "no pilot sets it; place a transmitter (--bench)",
}
"""What a pilot cannot vary: why not, and what to do."""


@dataclass(frozen=True)
class Pilot:
    """What all sessions in flight have in common."""

    instead: ClassVar[Mapping[str, str]] = INSTEAD
    airframe_file: Path
    airframe: Airframe
    """The vehicle."""
    flown: dict[str, Columns] = field(default_factory=dict, compare=False, repr=False)
    """Contexts of flights that were simulated, by what they do: flights of a session differ only in their air."""

    def factors(self, columns: frozenset[str]) -> tuple[str, ...]:
        """Those of these columns that a pilot can vary."""
        return tuple(name for name in FACTORS if name in columns)

    def can_record(self, columns: frozenset[str]) -> bool:
        """Whether the recording of a flight has these columns."""
        return columns <= RECORDED

    def session(
        self, varied: Sequence[str], ends_only: bool, record: frozenset[str], readings: int, visits: int = 1
    ) -> PlannedSession:
        """As `SessionPlace.session`: in each of `FLIGHTS` so many readings, flown so often.

        A flight records what it can, whatever `record` asks for.
        """
        del record
        turn_s = self.airframe.polling_interval_s * len(self.airframe.polling_groups)
        seconds = min(max(readings * turn_s, 20.0), LONGEST_S)
        air_c = chosen(TEMPERATURES_C, ends_only) if "air_temperature_c" in varied else (20.0,)
        scenarios, parts = {}, []
        flights = visits * FLIGHTS
        for number in range(flights):
            name = f"decide_{number + 1}"
            scenarios[name] = self._scenario(name, varied, ends_only, seconds, air_c[number * len(air_c) // flights])
            parts.append(self._contexts(scenarios[name]))
        contexts = {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
        flown_s = sum(float(scenario["duration_s"]) for scenario in scenarios.values())
        minutes = flown_s / 60.0 + flights * SETUP_MIN + (len(air_c) - 1) * WEATHER_MIN
        words, campaign = _words(varied, ends_only, air_c), self._campaign(scenarios)
        per_flight = round(seconds / turn_s)
        return PlannedSession("flight", words, contexts, per_flight, visits, minutes, campaign, scenarios, REFERENCE_CM)

    def _contexts(self, content: dict[str, Any]) -> Columns:
        """The contexts of a flight, in its air and with its name as run."""
        does = json.dumps([content["flight"], content["duration_s"]])
        if does not in self.flown:
            scenario = check(content["name"], Scenario, content, {"folder": self.airframe_file.parent})
            pinged = pings_in_flight(scenario, None, np.random.default_rng(1))
            rows = [ping | {"time_s": ping["uptime_s"]} for ping in pinged if ping["has_echo"]]
            self.flown[does] = {key: np.array([row[key] for row in rows]) for key in TRUTH}
        pings = self.flown[does]
        size = np.size(pings["time_s"])
        air_c = np.full(size, float(content["air"]["ground_c"]))
        return {**pings, "air_temperature_c": air_c, "run": np.full(size, content["name"])}

    def _scenario(
        self, name: str, varied: Sequence[str], ends_only: bool, seconds: float, air_c: float
    ) -> dict[str, Any]:
        climb = {"kind": "climb", "speed_m_s": 2.0, "acceleration_m_s2": 2.0}
        heights = chosen(HEIGHTS_M, ends_only) if "true_range_cm" in varied else (USUAL_HEIGHT_M,)
        periods_s = [
            *([GENTLE_S] if "range_rate_cm_s" in varied else []),
            *([BRISK_S] if "throttle" in varied else []),
        ]
        # What is strongest at the ends of its range is seen best without hovering between them.
        hovers = not (ends_only and periods_s)
        share_s = seconds / (len(heights) * (hovers + len(periods_s)))
        segments: list[dict[str, Any]] = []
        for height_m in heights:
            segments.append(climb | {"to_m": height_m})
            if hovers:
                segments.append({"kind": "hold", "duration_s": round(share_s, 1)})
            for period_s in periods_s:
                cycles = max(round(share_s / period_s), 1)
                segments.append({"kind": "sinusoid", "swing_m": SWING_M, "period_s": period_s, "cycles": cycles})
        # The time for climbs from height to height, of 2 s each at most.
        duration_s = round(seconds + 3.0 * len(heights) + sum(periods_s) * len(heights))
        dashes = int(duration_s / (2.0 * DASH_S)) if "incidence_deg" in varied else 0
        legs = [
            {"duration_s": DASH_S, "speed_m_s": DASH_M_S, "heading_deg": heading}
            for _ in range(dashes)
            for heading in (0.0, 180.0)
        ]
        return {
            "name": name,
            "airframe": str(self.airframe_file),
            "duration_s": duration_s,
            "flight": {"altitude": segments, "track": {"acceleration_m_s2": DASH_M_S2, "legs": legs}},
            "ground": {"surface": "concrete"},
            "air": {"ground_c": air_c, "lapse_c_per_m": 0.0},
        }

    def _campaign(self, scenarios: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
        flights = [
            {
                "flight": name,
                "how": f"Fly what {name}.yaml describes, in air of {content['air']['ground_c']:g} deg C.",
                "target": "concrete",
                "scenario": f"{name}.yaml",
            }
            for name, content in scenarios.items()
        ]
        return {
            "campaign": "decide",
            "purpose": "Made by msp-lab design",
            "reference": {
                "method": "another range finder next to the sensors, logged with UTC",
                "uncertainty_cm": REFERENCE_CM,
            },
            "airframe": str(self.airframe_file),
            "flights": flights,
        }


def _words(varied: Sequence[str], ends_only: bool, air_c: Sequence[float]) -> dict[str, str]:
    words = {
        "true_range_cm": f"hover at {', '.join(f'{height_m:g}' for height_m in chosen(HEIGHTS_M, ends_only))} m",
        "range_rate_cm_s": f"climb and descend by {SWING_M:g} m every {GENTLE_S:g} s",
        "throttle": f"climb and descend by {SWING_M:g} m every {BRISK_S:g} s",
        "incidence_deg": f"dash forwards and back, {DASH_S:g} s each, with {DASH_M_S2:g} m/s^2",
        "air_temperature_c": f"flights in air of {', '.join(f'{temperature_c:g}' for temperature_c in air_c)} C",
    }
    return {name: words[name] for name in varied}
