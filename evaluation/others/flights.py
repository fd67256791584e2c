"""Random flights of the pallet with four sensors, one of which may have an effect that the others do not have.

A random generator enters, scenarios and recordings leave. Ground with a slope and roughness, air of any temperature,
hovers, climbs, swings and tracks with any heading.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml
from numpy.random import Generator

from msp_range.clock import VirtualClock
from msp_range.recording.writer import Recorder
from msp_range.yaml_file import config_path
from msp_sim.flight.flight import Simulation
from msp_sim.flight.scenario import load_scenario

SENSORS = ("front_left", "front_right", "rear_left", "rear_right")
DURATION_S = 75
"""Of each flight [s]: the longest of the random profiles takes 70."""


def write_airframe(folder: Path, sensor: str | None, effect: Mapping[str, Any] | None) -> Path:
    """The pallet's airframe, with a further effect in the model of one sensor."""
    content = yaml.safe_load(config_path(Path("quad_pallet"), "").read_text(encoding="utf-8"))
    base = yaml.safe_load(config_path(Path("mb1242"), "sensors").read_text(encoding="utf-8"))
    (folder / "given.yaml").write_text(yaml.safe_dump(base, sort_keys=False), encoding="utf-8")
    if effect is not None:
        changed = base | {"effects": [*base["effects"], dict(effect)]}
        (folder / "changed.yaml").write_text(yaml.safe_dump(changed, sort_keys=False), encoding="utf-8")
    for each in content["sensors"]:
        each["model"] = "changed.yaml" if effect is not None and each["name"] == sensor else "given.yaml"
    path = folder / "airframe.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    return path


def write_scenario(path: Path, airframe: Path, rng: Generator) -> Path:
    """A random flight."""
    altitude: list[dict[str, Any]] = [{"kind": "climb", "to_m": _number(rng, 1.2, 2.5), "speed_m_s": 1.5}]
    for _ in range(4):
        speed = _number(rng, 0.5, 2.0)
        altitude += [
            {"kind": "hold", "duration_s": _number(rng, 2.0, 6.0)},
            {"kind": "sinusoid", "swing_m": _number(rng, 0.4, 1.2), "period_s": _number(rng, 3.0, 8.0), "cycles": 1},
            {"kind": "climb", "to_m": _number(rng, 1.6, 5.0), "speed_m_s": speed, "acceleration_m_s2": 2.0},
        ]
    altitude.append({"kind": "hold", "duration_s": 1})
    legs = [
        {
            "duration_s": _number(rng, 5.0, 12.0),
            "speed_m_s": _number(rng, 0.0, 1.2),
            "heading_deg": _number(rng, 0.0, 360.0),
        }
        for _ in range(4)
    ]
    roughness = _number(rng, 0.0, 0.012)
    ground: dict[str, Any] = {
        "surface": "grass",
        "slope_deg": _number(rng, 0.0, 4.0),
        "uphill_deg": _number(rng, 0.0, 360.0),
    }
    if roughness > 0.002:
        ground["rough"] = {"grass": {"rms_m": roughness, "length_m": 0.3}}
    sway_deg = _number(rng, 0.3, 1.5)
    scenario = {
        "name": path.stem,
        "airframe": str(airframe),
        "duration_s": DURATION_S,
        "flight": {
            "altitude": altitude,
            "track": {"legs": legs},
            "attitude": {
                "yaw_deg": _number(rng, 0.0, 360.0),
                "sway": {"roll_rms_deg": sway_deg, "pitch_rms_deg": sway_deg, "period_s": 2.0},
            },
        },
        "ground": ground,
        "air": {"ground_c": _number(rng, 0.0, 32.0)},
    }
    path.write_text(yaml.safe_dump(scenario, sort_keys=False), encoding="utf-8")
    return path


def fly(scenario_file: Path, seed: int) -> Path:
    """Fly a scenario; the recording."""
    scenario, clock = load_scenario(scenario_file), VirtualClock()
    path = scenario_file.with_suffix(".mcap")
    path.unlink(missing_ok=True)
    recorder = Recorder(path, clock, files=scenario.airframe.files, metadata={"scenario": scenario.name})
    try:
        for _ in Simulation(scenario, clock, seed, recorder=recorder).fly():
            pass
    finally:
        recorder.close()
    return path


def _number(rng: Generator, low: float, high: float) -> float:
    return round(float(rng.uniform(low, high)), 4)
