"""Blind cases: eight flights each, an effect on one sensor, and the gap workflow with the other sensors as reference.

A folder, the number of a case and a seed enter. What was hidden and what was said leaves.
"""

import shutil
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.random import Generator, default_rng

from evaluation.others.flights import SENSORS, fly, write_airframe, write_scenario
from evaluation.others.size import MECHANISMS, NullFlights, size_for
from evaluation.runner import Row
from msp_lab.gap.findings import Settings
from msp_lab.gap.separate import SensorGap, compare_sensors
from msp_lab.gap.steps import Steps
from msp_lab.readings.intake import PREVIOUS, Truth, load_readings, time_order
from msp_range.clock import SystemClock
from msp_range.recording.csv_form import MeasuredData
from msp_sim.model.model import Model, load_model

FLIGHTS = 8
"""Flights of a case. The size of its effect is computed from the same flights without it."""


@dataclass(frozen=True)
class Case:
    """A case and how it went."""

    seed: int
    """Of the case."""
    sensor: str
    effect: str | None
    parameters: dict[str, float]
    """What was hidden; no effect: a null."""
    standard_errors: float
    """Its size."""
    sensor_right: bool
    effect_right: bool
    """Something was named at the sensor; the effect, or a class of names that holds it."""
    named: dict[str, list[str]]
    """By sensor: what was named."""
    seconds: float
    """Of the workflow."""

    @property
    def others_named(self) -> int:
        """At how many of the other sensors something was named."""
        return sum(bool(names) for sensor, names in self.named.items() if sensor != self.sensor)


def run_case(folder: Path, seed: int, number: int, standard_errors: float, null: bool) -> Row:
    """Hide an effect, fly, and compare."""
    rng = default_rng([seed, number, int(null)])
    sensor = SENSORS[int(rng.integers(len(SENSORS)))]
    work = folder / f"{'null' if null else 'case'}-{seed}-{number:03d}"
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    effect: str | None = None
    parameters: dict[str, float] = {}
    airframe = write_airframe(work, None, None)
    scenarios = [write_scenario(work / f"flight_{i}.yaml", airframe, rng) for i in range(FLIGHTS)]
    if not null:
        effect, parameters = _hidden(work, scenarios, sensor, number, standard_errors, rng)
        write_airframe(work, sensor, {"name": effect, "parameters": parameters})
    recordings = [fly(each, int(rng.integers(2**31))) for each in scenarios]
    clock = SystemClock()
    started_s = clock.now()
    settings = Settings(str(work / "given.yaml"), seed=number + 1)
    gaps, _ = compare_sensors(
        recordings, settings, work / "gap", lambda to: Steps(to, clock, lambda what, share: None), draw=False
    )
    own = next(gap for gap in gaps if gap.sensor == sensor)
    case = Case(
        seed=seed,
        sensor=sensor,
        effect=effect,
        parameters=parameters,
        standard_errors=0.0 if null else standard_errors,
        sensor_right=bool(own.named) or effect in _names(own),
        effect_right=effect in _names(own),
        named={gap.sensor: list(gap.named) if gap.doubted is None else [] for gap in gaps},
        seconds=round(clock.now() - started_s, 1),
    )
    for recording in recordings:
        recording.unlink()
    return asdict(case)


def _hidden(
    work: Path, scenarios: Sequence[Path], sensor: str, number: int, standard_errors: float, rng: Generator
) -> tuple[str, dict[str, float]]:
    """An effect of this size, by turns; one that cannot have it leaves its turn to the next."""
    null = [fly(each, int(rng.integers(2**31))) for each in scenarios]
    given = load_model(work / "given.yaml")
    flights = _null_flights(null, given, sensor)
    for path in null:
        path.unlink()
    for turn in range(len(MECHANISMS)):
        mechanism = MECHANISMS[(number + turn) % len(MECHANISMS)]
        size = size_for(mechanism, standard_errors, given, flights, int(rng.integers(2**31)))
        if size is not None:
            return mechanism.name, mechanism.parameters(size)
    raise RuntimeError(f"no effect of {standard_errors:g} standard errors is possible")


def _null_flights(recordings: Sequence[Path], given: Model, sensor: str) -> NullFlights:
    """The same rows of one sensor with the truth and with the other sensors as reference."""

    def rows_of(truth: Truth) -> MeasuredData:
        data = load_readings(recordings, given.sensor, truth=truth, sensors=(sensor,)).data
        return data.select(time_order(data.columns))

    truth, others = rows_of("recorded"), rows_of("others")
    if not np.array_equal(truth["time_s"], others["time_s"]):
        raise RuntimeError("expected the same rows with both references")
    rows = np.flatnonzero(~np.isnan(truth["true_range_cm"]) & ~np.isnan(others["true_range_cm"]))
    truth_columns, other_columns = (
        {name: column for name, column in data.select(rows).columns.items() if name not in ("reading_cm", PREVIOUS)}
        for data in (truth, others)
    )
    return NullFlights(truth_columns, other_columns)


def _names(gap: SensorGap) -> set[str]:
    """Effects named at a sensor, and the alternatives to each that the data cannot tell from it; and numbers of the
    base that are effects, which calibration finds."""
    said = [each for each in gap.findings.effects if each.verdict != "suggested"]
    calibrated = {each.name.removeprefix("effects.") for each in gap.findings.calibration}
    return {each.name for each in said} | {other.name for each in said for other in each.alternatives} | calibrated


def table(cases: Sequence[Case], nulls: Sequence[Case]) -> str:
    """What was reached, as a table in Markdown."""
    lines = [
        "| hidden effect | cases | sensor right | sensor and effect right | other sensors with a name |",
        "|---|---|---|---|---|",
    ]
    for name in [*dict.fromkeys(case.effect for case in cases), "all"]:
        own = [case for case in cases if name in ("all", case.effect)]
        if own:
            others = sum(case.others_named for case in own)
            right = sum(case.sensor_right and case.effect_right for case in own)
            lines.append(
                f"| {name} | {len(own)} | {sum(case.sensor_right for case in own)} | {right} | "
                f"{others} of {len(own) * (len(SENSORS) - 1)} |"
            )
    if nulls:
        others = sum(bool(names) for case in nulls for names in case.named.values())
        lines.append(f"| none | {len(nulls)} | - | - | {others} of {len(nulls) * len(SENSORS)} |")
    return "\n".join(lines)
