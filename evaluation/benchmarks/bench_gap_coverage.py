"""Whether the 95 % intervals of effects hold: the gap workflow on flights of a plain sampler with known parameters.

It looks at 3 tables a seed, of 4000 readings in 40 runs, with three or four effects each; half of the runs choose and
fit, and the intervals are those that the other half gives.
"""

import argparse
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from evaluation.shares import wilson
from msp_lab.gap.naming import AllReadings, name_effects
from msp_lab.gap.runs import draw_splits
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_sim.model.model import Model
from tests.support.plain_effects import BASE, fly

SEEDS = 40
RUNS, ROWS = 40, 100
TABLES: tuple[Mapping[str, Mapping[str, float]], ...] = (
    {
        "mounting_offset": {"offset_cm": 0.8},
        "rotor_noise": {"growth": 0.8},
        "missed_by_target": {"log_odds": 1.2},
    },
    {
        "latency": {"delay_ms": 12.0},
        "prop_wash": {"log_odds": 2.5},
        "lost_high_byte": {"share": 0.03},
    },
    {
        "air_temperature": {"share": 0.3},
        "slant_range": {"share": 0.8},
        "warm_up": {"offset_cm": 1.2, "time_constant_s": 240.0},
        "multipath": {"share": 0.04, "sigma_cm": 2.5},
    },
)
"""Effects whose names are not in doubt: 8 standard errors and more."""


@dataclass
class Held:
    """How often one parameter was value, how often its interval held the truth, and its errors in units of it."""

    tables: int = 0
    held: list[bool] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)


def plain_model() -> Model:
    """The plain sampler's base as a model: its numbers are known, the effects are not."""
    sensor = load_sensor_model("configs/sensors/mb1242.yaml").model_dump()
    sensor["reading_model"] |= {
        "weights": {name: getattr(BASE, name) for name in ("hit", "short", "missed", "random")},
        "sigma_cm": BASE.sigma_cm,
        "short_rate_per_m": BASE.short_rate_per_m,
        "saturated_fraction": BASE.second_share,
    }
    return Model.of(SensorModel.model_validate(sensor | {"effects": ()}))


def coverage(seeds: Iterable[int]) -> dict[tuple[str, str], Held]:
    """By effect and parameter."""
    model = plain_model()
    found: dict[tuple[str, str], Held] = defaultdict(Held)
    for seed in seeds:
        for k, hidden in enumerate(TABLES):
            columns: dict[str, Any] = {
                name: np.array(each) for name, each in fly(hidden, RUNS, ROWS, 3 * seed + k).items()
            }
            reading_cm = columns.pop("reading_cm")
            rng = np.random.default_rng((seed, k))
            named_model = name_effects(model, AllReadings(columns, reading_cm, draw_splits(columns, rng)), rng)
            named = {each.name: each for each in named_model.effects}
            for name, values in hidden.items():
                for parameter, truth in values.items():
                    one = found[name, parameter]
                    one.tables += 1
                    if name in named:
                        value = named[name].parameters[parameter]
                        if value.low is None or value.high is None:
                            continue
                        one.held.append(value.low <= truth <= value.high)
                        one.errors.append(2.0 * 1.96 * (value.value - truth) / (value.high - value.low))
    return found


def show(found: Mapping[tuple[str, str], Held]) -> str:
    """The table in Markdown; the error's mean and spread are in standard errors, so 0 and 1 are right."""
    lines = ["| parameter | named | interval holds | share | 95 % interval | error |", "|---|---|---|---|---|---|"]
    rows = [(f"{name} {parameter}", each) for (name, parameter), each in found.items()]
    every = Held(
        sum(each.tables for _, each in rows),
        [yes for _, each in rows for yes in each.held],
        [error for _, each in rows for error in each.errors],
    )
    for what, each in [*rows, ("all", every)]:
        count, of = sum(each.held), len(each.held)
        low, high = wilson(count, of)
        error = f"{np.mean(each.errors):+.2f} +- {np.std(each.errors):.2f}" if of else ""
        share = f"{count / of:.3f}" if of else ""
        lines.append(f"| {what} | {of} of {each.tables} | {count} | {share} | {low:.3f} to {high:.3f} | {error} |")
    return "\n".join(lines)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("seeds", type=int, nargs="?", default=SEEDS, help="three tables each (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Look, and print the table."""
    print(show(coverage(range(given.seeds))))
