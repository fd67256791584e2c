"""Readings of a whole campaign by plain sampling, and what is found in them, for tests of the report.

The sampling shares no code with the simulator. Its numbers are those of the characterization report where it has some.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from msp_lab.characterise.analysis import characterise
from msp_lab.characterise.findings import Findings
from msp_lab.readings.intake import LoadedReadings, SourceFile
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData

BASELINE_CM = tuple(range(40, 261, 20))
ANGLES_DEG = tuple(round(1.8 * step, 1) for step in range(-13, 14))
BREAKAWAY_DEG = {50.0: 23.4, 100.0: 18.0, 150.0: 14.4, 200.0: 12.6}
NAN = math.nan


def measured(seed: int = 1, most: int = 20000) -> MeasuredData:
    """The report's campaign: all its conditions, 100 readings a point and `most` at the maximum range."""
    rng = np.random.default_rng(seed)
    parts = list(_campaign(rng, most))
    names = parts[0].keys()
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    columns["time_s"] = np.arange(len(columns["reading_cm"])) * 0.1
    return MeasuredData(columns)


def _campaign(rng: np.random.Generator, most: int) -> Iterator[dict[str, Any]]:
    setup = {range_cm: rng.normal(0.0, 0.15) for range_cm in BASELINE_CM}
    for range_cm in BASELINE_CM:
        yield _point(rng, "baseline", range_cm, setup[range_cm])
    yield _point(rng, "maximum_range", 500, 1.6, n=most, missed=0.03, sigma=1.4, short=0.004, random=0.003)
    for z, angle in BREAKAWAY_DEG.items():
        for theta in ANGLES_DEG:
            beyond = abs(theta) > angle + 0.1
            slant = z / math.cos(math.radians(theta)) - z
            yield _point(
                rng,
                "field_of_view",
                z,
                0.3 * slant,
                n=50,
                missed=0.85 if beyond else 0.01,
                incidence=theta,
                target="wall",
                sigma=0.4 + (3.0 if beyond else 0.0),
            )
    for material in ("plywood", "asphalt", "concrete"):
        for z in BASELINE_CM:
            yield _point(rng, "material", z, rng.normal(0.0, 0.15), target=material, missed=0.004)
    for air_c in (21.1, 46.1, 8.3):
        for z in BASELINE_CM:
            shift = -0.5 * 30.0 * (air_c - 21.1) / 294.0
            yield _point(rng, "temperature", z, shift + rng.normal(0, 0.1), air=air_c, far=21.1)
    for z in (305, 335, 366, 396, 427):
        air_c = 15.5 + rng.normal(0, 0.2)
        yield _point(
            rng, "temperature_compensation", z, z * (math.sqrt(295.65 / (air_c + 273.15)) - 1.0), air=air_c, sigma=0.6
        )
    for z in BASELINE_CM:
        yield _point(rng, "vibration", z, setup[z], vibration=60.0)
    for condition in ("crosstalk_simultaneous", "crosstalk_sequential"):
        for sensor in ("left", "right"):
            for z in BASELINE_CM:
                part = _point(rng, condition, z, 0.0, sensor=sensor)
                if condition.endswith("simultaneous") and sensor == "right":
                    hit = rng.random(len(part["reading_cm"])) < 0.4
                    part["reading_cm"][hit] = np.maximum(np.rint(z * 0.6 - rng.gamma(2.0, 6.0, hit.sum())), 20)
                yield part
    for level in (NAN, 80.0, 110.0):
        for z in BASELINE_CM[::4]:
            yield _point(rng, "external_interference", z, 0.0, missed=0.0 if level < 100 else 0.1, level=level)


def _point(
    rng: np.random.Generator,
    condition: str,
    z: float,
    bias: float,
    n: int = 100,
    missed: float = 0.002,
    sigma: float = 0.45,
    short: float = 0.0,
    random: float = 0.0,
    incidence: float = 0.0,
    target: str = "plywood",
    air: float = 20.5,
    far: float = NAN,
    vibration: float = 0.0,
    sensor: str = "left",
    level: float = NAN,
) -> dict[str, Any]:
    readings = np.rint(rng.normal(z + bias, sigma, n))
    kind = rng.random(n)
    shorts = kind < short
    readings[shorts] = np.rint(rng.uniform(20, z, shorts.sum()))
    spread = (kind >= short) & (kind < short + random)
    readings[spread] = rng.integers(20, 766, spread.sum())
    gone = kind > 1.0 - missed
    readings[gone] = np.where(rng.random(gone.sum()) < 0.25, 255, 765)
    words = {"sensor": sensor, "run": condition, "condition": condition, "target": target}
    numbers = {
        "reading_cm": readings,
        "true_range_cm": z,
        "incidence_deg": incidence,
        "air_temperature_c": air,
        "target_temperature_c": far,
        "vibration_hz": vibration,
        "external_level_db": level,
    }
    columns = {name: np.full(n, word, dtype="<U32") for name, word in words.items()}
    columns |= {name: np.broadcast_to(np.asarray(value, float), n).copy() for name, value in numbers.items()}
    return columns


def found_in(data: MeasuredData) -> Findings:
    """Findings of `measured` readings."""
    loaded = LoadedReadings(data, (SourceFile("campaign.csv", "0" * 64, len(data)),))
    sensor = load_sensor_model("configs/sensors/mb1242.yaml")
    return characterise(loaded, sensor, date="2026-10-05", rng=np.random.default_rng(1)).findings
