"""Blind tables: flights in which something is hidden, or nothing, with the answers apart.

A seed enters, cases leave. Regimes of noise, what is hidden, how large it is and how the flights go are all drawn. For
each regime there is a base as well: flights of the same vehicle with nothing hidden, and a turn of its sensor before a
wall, which is what a user would characterise first.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.random import Generator, default_rng

from evaluation.blind.flight import REGIMES, Columns, Regime, contexts, fly, habits, land, run_numbers
from evaluation.blind.mechanisms import KNOWN, UNKNOWN
from evaluation.blind.size import Hidden, size_for, stage
from evaluation.blind.sound import Array

Kind = Literal["null", "one", "three", "unknown", "confounded"]
SHARES: dict[Kind, float] = {"null": 0.3, "one": 0.25, "three": 0.1, "unknown": 0.25, "confounded": 0.1}

RUNS, ROWS = 40, 100
"""Of a case; half of them choose and fit."""

BASE_READINGS = 400
"""At each height of a base."""

TOGETHER = {
    "bias": ("one_hangs_lower", "slow_clock", "air_not_compensated", "one_thermometer_for_the_path", "read_late"),
    "bias too": ("cold_start", "rough_ground", "humidity_ignored", "stamped_at_the_echo", "bent_counter"),
    "spread": ("gravel", "wash_across_the_path", "shaken"),
    "missed": ("long_grass", "steep"),
    "heard": ("neighbour_heard", "second_bounce", "strut", "blown_about", "second_lobe", "rings_on", "transmitter"),
    "code": ("bytes_on_top_of_each_other", "high_byte_lost", "top_bit", "repeated"),
}
"""Three effects are of three of these kinds."""


@dataclass(frozen=True)
class Case:
    """A blind table before it is flown."""

    number: int
    seed: int
    """Which, and from what it is drawn."""
    kind: Kind
    regime: Regime
    """What it tests, in which noise."""
    hidden: tuple[tuple[str, float], ...] = ()
    """Mechanisms, in standard errors as wanted."""
    twist: str = ""
    """Of a confounded pair: the flights in which the two look alike."""


def draw_cases(
    seed: int, count: int, kind: Kind | None = None, regime: Regime | None = None, standard_errors: float | None = None
) -> list[Case]:
    """Cases by a seed.

    Parameters
    ----------
    seed
        Of the draws.
    count
        Cases.
    kind, regime, standard_errors
        All of one kind, in one regime, of one size; drawn unless given.
    """
    rng = default_rng((seed, 0))
    cases = []
    for number in range(count):
        drawn: Kind = kind or rng.choice(list(SHARES), p=list(SHARES.values()))
        # Nulls are spread over all regimes; effects are hidden in independent readings, so that their size is plain.
        chosen: Regime = regime or (REGIMES[int(rng.integers(len(REGIMES)))] if drawn == "null" else "iid")
        size = standard_errors or float(rng.choice((6.0, 10.0, 20.0) if drawn == "one" else (10.0, 20.0)))
        hidden: tuple[tuple[str, float], ...] = ()
        twist = ""
        if drawn == "one":
            hidden = ((str(rng.choice(list(KNOWN))), size),)
        elif drawn == "unknown":
            hidden = ((str(rng.choice(list(UNKNOWN))), max(size, 10.0)),)
        elif drawn == "three":
            groups = rng.choice(list(TOGETHER), 3, replace=False)
            hidden = tuple((str(rng.choice(TOGETHER[str(group)])), size) for group in groups)
        elif drawn == "confounded":
            twist = str(rng.choice(list(CONFOUNDED)))
            hidden = ((str(rng.choice(CONFOUNDED[twist][0])), 10.0),)
        cases.append(Case(number, seed, drawn, chosen, hidden, twist))
    return cases


PARTS: tuple[tuple[Kind, Regime, float], ...] = (
    *(("null", regime, 0.0) for regime in REGIMES),
    *(("one", "iid", size) for size in (6.0, 10.0, 20.0)),
    *(("three", "iid", size) for size in (10.0, 20.0)),
    *(("unknown", "iid", size) for size in (10.0, 20.0)),
    ("confounded", "iid", 10.0),
)
"""What a plan can ask for: kind, regime and standard errors."""


def draw_plan(seed: int, plan: Sequence[str]) -> list[Case]:
    """Cases in the numbers that are wanted, mixed evenly, so that a part of them is like the whole.

    Parameters
    ----------
    seed
        Of the draws.
    plan
        KIND=COUNT of all `PARTS` of a kind each, KIND:REGIME=COUNT or KIND:STANDARD_ERRORS=COUNT of one. A number that
        is raised adds cases and leaves the others as they are.

    Raises
    ------
    ValueError
        What is asked for is in no part, or is no number.

    Examples
    --------
    >>> [(case.number, case.kind, case.regime) for case in draw_plan(1, ["null:ar1=2", "one:6=1"])]
    [(1, 'null', 'ar1'), (6, 'one', 'iid'), (15, 'null', 'ar1')]
    """
    names = [f"{kind}:{regime if kind == 'null' else format(size, 'g')}" for kind, regime, size in PARTS]
    counts = dict.fromkeys(range(len(PARTS)), 0)
    for each in plan:
        what, _, number = each.partition("=")
        meant = [k for k, name in enumerate(names) if what in (name, name.partition(":")[0])]
        if not meant or not number.isdecimal():
            raise ValueError(f"plan {each!r}: expected WHAT=COUNT, with what of {', '.join(names)}")
        counts |= dict.fromkeys(meant, int(number))
    placed = []
    for k, count in counts.items():
        kind, regime, size = PARTS[k]
        for i, case in enumerate(draw_cases(seed, count, kind, regime, size or None)):
            placed.append(((i + 0.5) / count, replace(case, number=k + len(PARTS) * i)))
    return [case for _, case in sorted(placed, key=lambda each: (each[0], each[1].number))]


def _constant_air(columns: Columns, rng: Generator) -> None:
    celsius = float(rng.choice((4.0, 8.0, 31.0, 35.0)))
    for name in ("air_temperature_c", "target_temperature_c"):
        columns[name] = np.round(celsius + 0.05 * rng.standard_normal(columns[name].size), 1)
    columns["humidity_pct"] = np.full(columns["humidity_pct"].size, 50.0)


def _usual(columns: Columns, rng: Generator) -> None:
    """Nothing special: the two look alike whatever happens."""


def _one_height(columns: Columns, rng: Generator) -> None:
    columns["true_range_cm"] = 220.0 + 2.0 * rng.standard_normal(columns["true_range_cm"].size)


def _rotors_on_or_off(columns: Columns, rng: Generator) -> None:
    run = run_numbers(columns)
    on = (rng.random(run.max() + 1) < 0.5)[run]
    columns["throttle"] = np.where(on, 0.55, 0.0)
    columns["vibration_hz"] = np.where(on, 68.0, 0.0)


Twist = Callable[[Columns, Generator], None]
CONFOUNDED: dict[str, tuple[tuple[str, ...], Twist]] = {
    "air of one temperature": (("air_not_compensated", "slow_clock"), _constant_air),
    "usual flights": (("wrong_thermometer", "slow_clock"), _usual),
    "one height": (("read_late", "stamped_at_the_echo"), _one_height),
    "rotors on or off": (("wash_across_the_path", "shaken"), _rotors_on_or_off),
}
"""Pairs that look alike, and the flights in which they do."""


def fly_case(case: Case) -> tuple[Columns, Array, list[dict[str, object]]]:
    """Contexts, readings, and what was hidden with its size."""
    seeds = np.random.SeedSequence((case.seed, 1, case.number))
    context_seed, twist_seed, hiding = seeds.spawn(3)
    columns = contexts(default_rng(context_seed), RUNS, ROWS, case.regime)
    ways = habits(case.regime)
    if case.twist:
        CONFOUNDED[case.twist][1](columns, default_rng(twist_seed))
    hidden: Hidden = []
    sizes: list[dict[str, object]] = []
    for name, wanted in case.hidden:
        size, has = size_for(columns, ways, name, wanted, case.number)
        hidden = [*hidden, (name, size)]
        sizes.append({"mechanism": name, "size": size, "standard_errors": has, "wanted": wanted})
    flight, reading_cm = stage(columns, ways, hidden, hiding)
    return flight.columns, reading_cm, sizes


def fly_base(seed: int, regime: Regime) -> tuple[Columns, Array]:
    """What a user characterises: readings on a lift at fixed heights, nothing hidden, and the sensor turned to a wall.

    A height is a run. Only what a bench knows is in the columns.
    """
    rng = default_rng((seed, 2, REGIMES.index(regime)))
    # Not on whole centimetres: where the noise is small, rounding would hide the scale at every one of them.
    heights_cm = np.arange(50.0, 371.0, 4.7)
    lifted = contexts(rng, heights_cm.size, BASE_READINGS, regime, step_s=0.1)
    lifted["true_range_cm"] = np.repeat(heights_cm, BASE_READINGS)
    lifted["incidence_deg"] = np.zeros(lifted["true_range_cm"].size)
    turned = _turned(rng)
    readings = [land(fly(lifted, habits(regime), rng), rng), land(fly(turned, habits("iid"), rng), rng)]
    turned["run"] = np.char.add("wall", turned["true_range_cm"].astype(int).astype(str))
    known = ("time_s", "sensor", "run", "true_range_cm", "incidence_deg")
    joined = {name: np.concatenate([lifted[name], turned[name]]) for name in known}
    joined["sensor"] = np.full(joined["true_range_cm"].size, "front")
    joined["condition"] = np.repeat(["baseline", "field_of_view"], [each.size for each in readings])
    return joined, np.concatenate(readings)


def _turned(rng: Generator) -> Columns:
    """Contexts of a stepper motor's turn before a wall at four ranges, in a room."""
    angles = np.arange(-11, 12) * 1.8
    ranges = np.array([50.0, 100.0, 150.0, 200.0])
    readings = 20
    grid_cm, grid_deg = (np.repeat(each.ravel(), readings) for each in np.meshgrid(ranges, angles, indexing="ij"))
    n = grid_cm.size
    columns = contexts(rng, 1, n, "iid")
    for name in columns:
        if columns[name].dtype.kind == "f":
            columns[name] = np.full(n, float(np.median(columns[name])))
    columns |= {
        "time_s": 0.1 * np.arange(n),
        "sensor": np.full(n, "front"),
        "run": np.full(n, "wall"),
        "true_range_cm": grid_cm,
        "incidence_deg": grid_deg,
        "range_rate_cm_s": np.zeros(n),
        "target": np.full(n, "concrete"),
    }
    return columns
