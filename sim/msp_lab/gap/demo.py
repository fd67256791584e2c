"""The command ``msp-lab demo``: flights in which five effects are hidden, and the gap workflow that finds them.

Sensor models, scenarios, flights and the workflow's folder are written, so that every step can be repeated by hand; a
table shows what was hidden and what was found.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from msp_lab.gap.findings import FittedValue, GapFindings, Settings
from msp_lab.gap.findings_file import MODEL
from msp_lab.gap.steps import Steps
from msp_range.yaml_file import ConfigError, config_path
from msp_sim.flight.scenario import load_scenario
from msp_sim.flight.simulate import fly_through
from msp_sim.model.model import load_model

HIDDEN: tuple[dict[str, Any], ...] = (
    {"name": "air_temperature", "parameters": {"share": 1.0}},
    {"name": "rotor_noise", "parameters": {"growth": 3.0, "exponent": 1.5}},
    {"name": "prop_wash", "parameters": {"log_odds": 4.0}},
    {"name": "mounting_offset", "of": "front_left", "parameters": {"offset_cm": 1.5}},
    {"name": "multipath", "parameters": {"share": 0.03}},
)
"""What the vehicle's sensors do and the given model does not know. Sizes of some ten standard errors in these flights;
smaller ones need more flights."""
AIR_C = (7.0, 22.0, 2.0, 17.0, 32.0, 12.0, 27.0, 0.0)
"""Air temperature of each flight: spread, so that what changes with temperature shows."""
PERIODS_S = (2.4, 2.7, 3.0)
"""Periods of the climbs and descents, in turn. Over 2 m these take the throttle from a tenth to nine tenths of its
range; in gentle flights rotor noise would look like a larger spread, and prop wash like more short readings."""


@dataclass(frozen=True)
class HiddenNumber:
    """One number of a hidden effect, and what was found of it."""

    effect: str
    parameter: str
    """Names of the effect and of its parameter."""
    hidden: float
    """The true value."""
    found: FittedValue | None
    """None: the effect was not named."""

    @property
    def holds(self) -> bool:
        """Whether the interval holds the true value."""
        return self.found is not None and self.found.may_be(self.hidden)


def clear(folder: Path, force: bool) -> None:
    """Remove the recordings of an earlier demonstration.

    Raises
    ------
    ConfigError
        There are some, and `force` is not given.
    """
    recordings = list(folder.glob("flight-*.mcap"))
    if recordings and not force:
        raise ConfigError(f"{folder}: found an earlier demonstration; give --force to replace it, or another --out")
    for path in recordings:
        path.unlink()


def write_models(folder: Path) -> tuple[Path, Path]:
    """The model of the vehicle's sensors, and the model that is given to the workflow, which lacks `HIDDEN`."""
    content = yaml.safe_load(config_path(Path("mb1242"), "sensors").read_text(encoding="utf-8"))
    names = {hidden["name"] for hidden in HIDDEN}
    given = [effect for effect in content["effects"] if effect["name"] not in names]
    paths = folder / "vehicle.yaml", folder / "given.yaml"
    for path, effects in zip(paths, ([*given, *HIDDEN], given), strict=True):
        path.write_text(yaml.safe_dump(content | {"effects": effects}, sort_keys=False), encoding="utf-8")
    return paths


def write_scenario(folder: Path, number: int) -> Path:
    """The scenario of one flight."""
    path = folder / f"flight-{number}.yaml"
    period_s = PERIODS_S[number % len(PERIODS_S)]
    climb = {"kind": "climb", "speed_m_s": 3.0, "acceleration_m_s2": 3.0}
    scenario = {
        "name": f"gap_demo_{number}",
        "airframe": str(config_path(Path("quad_pallet"), "").resolve()),
        "duration_s": 42,
        "flight": {
            "altitude": [
                climb | {"to_m": 1.5},
                {"kind": "sinusoid", "swing_m": 2.0, "period_s": period_s, "cycles": 10},
                {"kind": "hold", "duration_s": 2},
                climb | {"to_m": 5.0},
                {"kind": "hold", "duration_s": 2},
            ]
        },
        "ground": {"surface": "grass"},
        "air": {"ground_c": AIR_C[number % len(AIR_C)], "lapse_c_per_m": 0.0},
    }
    path.write_text(yaml.safe_dump(scenario, sort_keys=False), encoding="utf-8")
    return path


def fly(folder: Path, scenario_file: Path, model: Path, seed: int) -> Path:
    """Fly a scenario with a sensor model; the recording."""
    path = folder / f"{scenario_file.stem}.mcap"
    fly_through(load_scenario(scenario_file), seed, load_model(model).sensor, path)
    return path


def comparisons(findings: GapFindings) -> Iterator[HiddenNumber]:
    """What was hidden, each number with what was found of it."""
    for hidden in HIDDEN:
        name = hidden["name"]
        fitted = next((effect.parameters for effect in findings.effects if effect.name == name), {})
        for parameter, value in hidden["parameters"].items():
            yield HiddenNumber(name, parameter, value, fitted.get(parameter))


def run(folder: Path, seed: int, steps: Steps) -> GapFindings:
    """Fly, find what is missing, and fly the extended model, as ``flight-8.mcap``."""
    vehicle, given = write_models(folder)
    recordings = []
    for number in range(len(AIR_C)):
        steps.report(f"flying {number + 1} of {len(AIR_C)}", 0.0)
        recordings.append(fly(folder, write_scenario(folder, number), vehicle, seed + number))
    findings = steps.all(recordings, Settings(str(given), seed=seed))
    steps.report("flying the extended model", 1.0)
    fly(folder, write_scenario(folder, len(AIR_C)), steps.folder / MODEL, seed)
    return findings
