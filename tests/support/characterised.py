"""Readings of a whole campaign by plain sampling, and what is found in them, for tests of the report.

The sampling shares no code with the simulator. Its numbers are those of the characterization report where it has some.
"""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from msp_lab.characterise.analysis import Characterisation, characterise
from msp_lab.characterise.findings import Findings
from msp_lab.readings.intake import LoadedReadings, SourceFile
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from tests.support.plain_bench import point, table

BASELINE_CM = tuple(range(40, 261, 20))
ANGLES_DEG = tuple(round(1.8 * step, 1) for step in range(-13, 14))
BREAKAWAY_DEG = {50.0: 23.4, 100.0: 18.0, 150.0: 14.4, 200.0: 12.6}


def measured(seed: int = 2, most: int = 20000) -> MeasuredData:
    """The report's campaign: all its conditions, 100 readings a point and `most` at the maximum range."""
    return table(*_campaign(np.random.default_rng(seed), most))


def _campaign(rng: np.random.Generator, most: int) -> Iterator[dict[str, Any]]:
    def at(condition: str, z: float, error_cm: float = 0.0, **more: Any) -> dict[str, Any]:
        usual = {"missed": 0.0015, "saturated": 0.0005, "sigma_cm": 0.45, "sensor": "left", "target": "plywood"}
        numbers = {"air_temperature_c": 20.5, "incidence_deg": 0.0, "vibration_hz": 0.0}
        given: dict[str, Any] = (
            usual | numbers | {"condition": condition, "run": condition, "error_cm": error_cm} | more
        )
        return point(rng, z, **given)

    setup = {range_cm: rng.normal(0.0, 0.15) for range_cm in BASELINE_CM}
    for z in BASELINE_CM:
        yield at("baseline", z, setup[z])
    yield at("maximum_range", 500, 1.6, n=most, missed=0.0225, saturated=0.0075, sigma_cm=1.4, stray=0.007)
    for far, angle in BREAKAWAY_DEG.items():
        for theta in ANGLES_DEG:
            beyond = abs(theta) > angle + 0.1
            slant = far / math.cos(math.radians(theta)) - far
            seen = {"missed": 0.64, "saturated": 0.21, "sigma_cm": 3.4} if beyond else {"missed": 0.01, "sigma_cm": 0.4}
            yield at("field_of_view", far, 0.3 * slant, n=50, incidence_deg=theta, target="wall", **seen)
    for material in ("plywood", "asphalt", "concrete"):
        for z in BASELINE_CM:
            yield at("material", z, rng.normal(0.0, 0.15), target=material, missed=0.004)
    for air_c in (21.1, 46.1, 8.3):
        for z in BASELINE_CM:
            shift = -0.5 * 30.0 * (air_c - 21.1) / 294.0
            air = {"air_temperature_c": air_c, "target_temperature_c": 21.1}
            yield at("temperature", z, shift + rng.normal(0, 0.1), **air)
    for z in (305, 335, 366, 396, 427):
        air_c = 15.5 + rng.normal(0, 0.2)
        error_cm = z * (math.sqrt(295.65 / (air_c + 273.15)) - 1.0)
        yield at("temperature_compensation", z, error_cm, air_temperature_c=air_c, sigma_cm=0.6)
    for z in BASELINE_CM:
        yield at("vibration", z, setup[z], vibration_hz=60.0)
    for condition in ("crosstalk_simultaneous", "crosstalk_sequential"):
        for sensor in ("left", "right"):
            for z in BASELINE_CM:
                part = at(condition, z, sensor=sensor)
                if condition.endswith("simultaneous") and sensor == "right":
                    hit = rng.random(len(part["reading_cm"])) < 0.4
                    part["reading_cm"][hit] = np.maximum(np.rint(z * 0.6 - rng.gamma(2.0, 6.0, hit.sum())), 20)
                yield part
    for level in (math.nan, 80.0, 110.0):
        for z in BASELINE_CM[::4]:
            yield at("external_interference", z, missed=0.03 if level > 100 else 0.0, external_level_db=level)


def found_in(data: MeasuredData) -> Findings:
    """Findings of `measured` readings."""
    loaded = LoadedReadings(data, (SourceFile("campaign.csv", "0" * 64, len(data)),))
    sensor = load_sensor_model("configs/sensors/mb1242.yaml")
    return characterise(loaded, sensor, Characterisation((), Path(), (), "recorded", "2026-10-05", 1)).findings
