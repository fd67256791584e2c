"""Sessions at the bench: a target that is moved, turned, heated or shaken, as a campaign file says it.

The columns to vary make a `Session`. Its points, their order and the time for setting them up are those of `msp-lab
collect`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.plan import SETUP_S, Point, make_plan, reading_interval_s, reading_s, setup_s
from msp_lab.design.session import Columns, PlannedSession, chosen
from msp_lab.gap.labels import unit_of
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData, join_tables
from msp_range.yaml_file import check

LEVELS: Mapping[str, tuple[float, ...]] = {
    "true_range_cm": (60.0, 120.0, 200.0, 300.0, 400.0),
    "incidence_deg": (0.0, 6.0, 12.0),
    "air_temperature_c": (0.0, 20.0, 40.0),
    "target_temperature_c": (0.0, 15.0),
    "humidity_pct": (20.0, 90.0),
    "vibration_hz": (0.0, 50.0, 100.0),
    "range_rate_cm_s": (10.0, 50.0),
    "target_size_cm": (10.0, 30.0, 100.0),
    "external_level_db": (80.0, 95.0, 110.0),
    "neighbour_lag_ms": (0.4, 100.0),
}
"""Values that a bench can set. Ranges at which a wall is always detected; angles inside the beam; a cold room, a room
and a hot box, or a climate chamber; `target_temperature_c` is how much warmer the far end is; two sensors ping together
(0.4 ms apart, the time of a transfer) or in turn. Wider levels need fewer readings and more equipment."""
FIRING = {0.4: "simultaneous", 100.0: "sequential"}
"""How a campaign file says that a sensor's neighbour pinged so many milliseconds before it."""
USUAL = {"true_range_cm": 200.0, "air_temperature_c": 20.0}
"""Values of what is not varied."""
MEANT = {"target_temperature_c": " warmer than at the sensor", "neighbour_lag_ms": " after the other sensor's ping"}
"""What is said of a value behind its unit."""
REFERENCE_CM = 0.2
"""Standard deviation of a placement's true range: a steel tape. Offsets below it need many placements."""
FARTHEST_SHARE = 0.6
"""Farthest wall, as a share of the sensor's longest reading: farther ones are missed too often."""
LEAST_READINGS = 20
"""Readings at a point, at least: setting it up takes longer than reading it."""

INSTEAD = {
    "throttle": "a bench has no rotors, and a vehicle that is tied down blows against the floor and its own stand as "
    "it does not in flight; design a flight (--flight), which takes the throttle from 0.2 to 0.8",
    "uptime_s": "switch the sensor off for half an hour, and log readings of a wall from the moment it is switched on",
}
"""What a bench cannot vary: why not, and what to do."""


@dataclass(frozen=True)
class BenchSessions:
    """What all sessions at a bench have in common."""

    instead: ClassVar[Mapping[str, str]] = INSTEAD
    model: Path
    """Sensor model file."""
    sensor: SensorModel
    """Its content."""
    sensors: tuple[str, ...]
    """Names of the sensors to read."""

    def factors(self, columns: frozenset[str]) -> tuple[str, ...]:
        """Those of these columns that a bench can vary."""
        asked = set(columns)
        if "external_duty" in asked:
            asked.add("external_level_db")
        if len(self.sensors) < 2:
            asked.discard("neighbour_lag_ms")
        return tuple(name for name in LEVELS if name in asked)

    def can_record(self, columns: frozenset[str]) -> bool:
        """Whether the table of a campaign has these columns."""
        here = {"sensor", "run", "target", "slant_range_cm", "previous_reading_cm", "neighbour_range_cm"}
        of_source = {"external_duty", "external_distance_cm", "external_frequency_khz"}
        return columns <= {*LEVELS, *here, *of_source}

    def session(
        self, varied: Sequence[str], ends_only: bool, record: frozenset[str], readings: int, visits: int = 1
    ) -> PlannedSession:
        """As `SessionPlace.session`: at each point so many readings, and the target is placed there so often.

        Raises
        ------
        ConfigError
            No campaign can be made of it: the sensor has no driver.
        """
        levels = {name: self._levels(name, ends_only) for name in varied}
        content = self._campaign(levels, max(readings, LEAST_READINGS), record, visits)
        campaign = check("campaign", Campaign, content, {"folder": self.model.parent})
        points = make_plan(campaign)
        seconds = sum(reading_s(campaign, point) for point in points)
        setups_s = [setup_s(before, point) for before, point in zip([None, *points], points, strict=False)]
        # A point that follows itself is placed anew too.
        seconds += sum(needed_s or SETUP_S["range_cm"] for needed_s in setups_s)
        words = {
            name: f"{', '.join(f'{level:g}' for level in levels[name])} {unit_of(name)}{MEANT.get(name, '')}"
            for name in varied
        }
        contexts = _contexts(campaign, points)
        return PlannedSession(
            "bench", words, contexts, campaign.readings, visits, seconds / 60.0, content, offset_cm=REFERENCE_CM
        )

    def _levels(self, name: str, ends_only: bool) -> tuple[float, ...]:
        levels = LEVELS[name]
        if name == "true_range_cm":
            levels = tuple(level for level in levels if level <= FARTHEST_SHARE * self.sensor.maximum_cm)
        return chosen(levels, ends_only)

    def _campaign(
        self, levels: Mapping[str, tuple[float, ...]], readings: int, record: frozenset[str], visits: int
    ) -> dict[str, Any]:
        def of(name: str) -> tuple[float, ...]:
            return levels.get(name, (USUAL.get(name, 0.0),))

        condition: dict[str, Any] = {
            "condition": "decide",
            "setup": "Clear the bench of everything that could reflect; level the sensor at the middle of the target.",
            "ranges_cm": list(of("true_range_cm")),
            "angles_deg": list(of("incidence_deg")),
            "vibrations_hz": list(of("vibration_hz")),
            "targets": [{"material": "wall"}],
            "sensors": list(self.sensors),
        }
        if "target_size_cm" in levels or "target_size_cm" in record:
            sizes = levels.get("target_size_cm", (100.0,))
            condition["targets"] = [{"material": "plywood", "size_cm": [size, size]} for size in sizes]
        if "neighbour_lag_ms" in levels:
            condition["firing"] = [FIRING[lag_ms] for lag_ms in levels["neighbour_lag_ms"]]
        if "external_level_db" in levels:
            condition["external"] = {
                "levels_db": list(levels["external_level_db"]),
                "duties": [0.5],
                "distances_cm": [100.0],
                "frequencies_khz": [42.0],
            }
        air = []
        for near_c, warmer_c, humid in product(
            of("air_temperature_c"), of("target_temperature_c"), levels.get("humidity_pct", (50.0,))
        ):
            one = {"air_temperature_c": near_c}
            if "target_temperature_c" in levels:
                one["target_temperature_c"] = near_c + warmer_c
            if "humidity_pct" in record or "humidity_pct" in levels:
                one["humidity_pct"] = humid
            air.append(one)
        condition["air"] = air
        if "range_rate_cm_s" in levels:
            near, far = min(LEVELS["true_range_cm"]), self._levels("true_range_cm", True)[-1]
            ends = [near, far] if "true_range_cm" in levels else [near, 2.0 * USUAL["true_range_cm"] - near]
            condition["ranges_cm"] = ends
            condition["moving"] = {"to_cm": sum(ends) / 2.0, "rates_cm_s": list(levels["range_rate_cm_s"])}
        if visits > 1:
            condition["setup"] += " Place the target anew before each point, also where the range stays."
        # What is slow to change, the air, stays until all visits are done.
        conditions = [condition | {"air": [one]} for one in air for _ in range(visits)] if visits > 1 else [condition]
        sensors = [
            {"name": name, "address": 0x70 + number, "model": str(self.model)}
            for number, name in enumerate(self.sensors)
        ]
        return {
            "campaign": "decide",
            "purpose": "Made by msp-lab design",
            "reference": {"method": "steel tape from sensor to target", "uncertainty_cm": REFERENCE_CM},
            "sensors": sensors,
            "readings": readings,
            "conditions": conditions,
        }


def _contexts(campaign: Campaign, points: Sequence[Point]) -> Columns:
    """The columns of the table that `msp-lab collect` makes, without readings."""
    parts = []
    for point in points:
        columns = point.columns
        spacing_s = reading_interval_s(campaign, point.setup.sensors, point.firing)
        rate_cm_s = 0.0 if point.setup.movement is None else point.setup.movement.rate_cm_s
        together = point.firing == "simultaneous"
        for number, name in enumerate(point.setup.sensors):
            time_s = np.arange(point.readings) * spacing_s
            part = {key: np.full(point.readings, value) for key, value in columns.items()}
            part |= {"time_s": time_s, "sensor": np.full(point.readings, name)}
            part["run"] = np.full(point.readings, point.name)
            part["true_range_cm"] = point.setup.range_cm + rate_cm_s * time_s
            if len(point.setup.sensors) > 1:
                first, last = LEVELS["neighbour_lag_ms"]
                part["neighbour_lag_ms"] = np.full(point.readings, first if together and number else last)
                part["neighbour_range_cm"] = part["true_range_cm"]
            parts.append(part)
    return join_tables([MeasuredData(part) for part in parts]).columns
