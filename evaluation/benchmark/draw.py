"""Draws the frozen tables anew, with their models and answers: `python -m evaluation.benchmark.draw FOLDER`.

Everything comes from the generators of `evaluation.second_hand`, `evaluation.days` and `evaluation.blind`. The product
characterises each sensor on its bench table, predicts each reading of the frozen table, and converts what was hidden
into the parameters of its effects.
"""

import csv
import gzip
import io
import json
import sys
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray
from scipy.stats import norm

from evaluation.benchmark.slices import slices_of
from evaluation.blind import run as blind_run
from evaluation.blind.flight import Regime, habits
from evaluation.blind.mechanisms import MECHANISMS
from evaluation.blind.score import accepted_names
from evaluation.blind.size import fly_once
from evaluation.blind.tables import Kind, draw_cases, fly_base, fly_case
from evaluation.csv_form import cells_of
from evaluation.days import generator as days
from evaluation.product import command
from evaluation.second_hand import generator as second
from evaluation.second_hand.density import base_law
from evaluation.second_hand.effect import law_with
from evaluation.second_hand.flights import Design
from evaluation.second_hand.sample import draw
from evaluation.second_hand.workflow import characterise
from msp_range.recording.csv_form import write_csv
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model, load_model

Array = NDArray[np.floating[Any]]
Columns = dict[str, NDArray[Any]]

SEED = 27_000_000
"""First seed of a kind; nothing else in the project uses seeds from here to `SEED` + 999."""
PLAN: Mapping[str, int] = {
    **{f"second_hand null:{what}": 1 for what in ("0", "0.3", "0.5", "0.8", "drift")},
    "second_hand one:5": 9,
    "second_hand one:10": 7,
    "second_hand two:10": 4,
    "second_hand unknown:10": 4,
    **{f"days {kind}": 1 for kind in ("slow:null", "slow:temperature", "slow:supply", "slow:day")},
    **{f"days {kind}": 1 for kind in ("words:null", "words:surface", "words:battery")},
    **{f"blind null:{regime}": 1 for regime in ("iid", "ar1")},
    "blind one:10": 2,
    "blind unknown:10": 1,
}
"""Generator and kind -> tables. Of these sizes all together stay under the 1.5 MB that a repository bears easily."""
RUN_ROWS = 115
"""Most rows of a run of the second generator: of its usual 600 a table would have 4,500 rows."""
MOST_ROWS = 2_000
"""Tables of `days` with more are left out, and the next seed is taken; nothing but the number of rows is asked."""
BLIND_RUNS = 20
"""Runs of a table of `blind`: the half on which its sizes are defined."""
REDRAWN = 40
"""Tables drawn with what is hidden and without it, to see where it shows: the change of a slice is known to 0.2
standard deviations."""
SHOWN, UNSEEN = 3.0, 1.0
"""A slice differs where the change is at least, and does not where it is at most, so many standard deviations of such
tables; between them nobody can be asked to know, and it does not count."""
FAR = 4.0
"""Standard deviations beyond which a reading counts as an outlier."""
EXPLAINED = 0.98
"""Share of what a bias does to the readings that an effect has to do as well, for its parameter to be the answer."""


@dataclass(frozen=True)
class Effect:
    """What is hidden, for the answers; and what it does to the place of each hit, or its parameter, where known."""

    title: str
    names: Collection[str]
    channel: str
    columns: Collection[str]
    standard_errors: float
    moved_cm: Array | None = None
    value: float | None = None


@dataclass(frozen=True)
class Drawn:
    """A table in the CSV form before it is written, what is hidden, and what draws its readings again, with or without
    that."""

    columns: Columns
    again: Callable[[Generator, bool], Array]
    hidden: Sequence[Effect] = ()


def second_hand(kind: str, seed: int, bench: Path) -> tuple[Drawn, int]:
    """A table of the second generator, and its seed; its bench table is written."""
    hidden, rng = second.drawn(kind, seed, within=Design(longest=RUN_ROWS))
    rows, base = hidden.rows, hidden.base
    laws = base_law(rows, base), law_with(rows, base, hidden.effects, hidden.sizes)
    own_law = base_law(hidden.bench, base)
    write_csv(bench, hidden.bench.columns(draw(hidden.bench, base, own_law, rng).reading_cm, "bench{:02d}", SENSORS))
    hits = float(np.mean(1.0 / (1.0 + np.exp(laws[0].odds).sum(axis=0))))
    effects = []
    for effect, size in zip(hidden.effects, hidden.sizes, strict=True):
        what = effect.kind
        moved_cm = law_with(rows, base, [effect], [size]).centre_cm - laws[0].centre_cm
        value = VALUES[what.title](size, hits) if what.title in VALUES else None
        asked = float(hidden.asked or 0.0)
        effects.append(Effect(what.title, what.names, what.channel, [what.variable], asked, moved_cm, value))

    def again(rng: Generator, with_hidden: bool) -> Array:
        return draw(rows, base, laws[with_hidden], rng).reading_cm

    return Drawn(rows.columns(again(rng, True), "run{:02d}", SENSORS), again, effects), seed


SENSORS = second.SENSORS
VALUES: Mapping[str, Callable[[float, float], float]] = {
    "propeller_short": lambda size, hits: size,
    "stale": lambda size, hits: size,
    "latency": lambda size, hits: 1000.0 * size,
    "coarse_rounding": lambda size, hits: size,
    "vibration": lambda size, hits: float(np.expm1(size)),
    "spread_with_range": lambda size, hits: float(np.expm1(size)) / 3.0,
    **dict.fromkeys(("crosstalk", "multipath", "ring_down", "cycle_slip"), lambda size, hits: size * hits),
}
"""Title of an effect of the second generator that moves no hits, or otherwise than the product -> its parameter in the
catalogue, from its size there and the share of hits, by the definitions of both. Missing: those whose size depends on a
place or a power that a method may take otherwise."""


def slow_or_words(kind: str, seed: int, bench: Path) -> tuple[Drawn, int]:
    """A table of `evaluation.days`, the first from this seed on that is small enough, and its seed."""
    table, hidden, size, rng = days.drawn(kind, seed)
    if table.run.size > MOST_ROWS:
        return slow_or_words(kind, seed + 1, bench)
    moved_cm = size * hidden.moves(table) if hidden else np.zeros(table.run.size)
    effects = []
    if hidden:
        known = hidden.title, hidden.names, "bias", [hidden.variable], days.STANDARD_ERRORS
        effects.append(Effect(*known, moved_cm))

    def again(rng: Generator, with_hidden: bool) -> Array:
        return days.read(rng, table.true_cm + moved_cm * with_hidden + days.error_cm(rng, table))

    write_csv(bench, days.bench(rng, table.noise))
    return Drawn(table.columns | {"reading_cm": again(rng, True)}, again, effects), seed


def blind(kind: str, seed: int, bench: Path) -> tuple[Drawn, int]:
    """Half of the runs of a table of `evaluation.blind`, which are its first in time, and its seed."""
    family, _, rest = kind.partition(":")
    regime = rest if family == "null" else "iid"
    size = None if family == "null" else float(rest)
    [case] = draw_cases(seed, 1, cast(Kind, family), cast(Regime, regime), size)
    flown, reading_cm, sizes = fly_case(case)
    blind_run.write(bench, *fly_base(seed, case.regime))
    here = np.isin(flown["run"], np.unique(flown["run"])[:BLIND_RUNS])
    columns = {name: column[here] for name, column in flown.items()}
    effects = []
    for name, has in ((str(each["mechanism"]), float(str(each["standard_errors"]))) for each in sizes):
        what, names = MECHANISMS[name], accepted_names().get(name, frozenset())
        effects.append(Effect(name, names, what.channel, what.variables, has))

    def again(rng: Generator, with_hidden: bool) -> Array:
        seeds = tuple(int(each) for each in rng.integers(2**31, size=2))
        if not sizes:
            return fly_once(columns, habits(case.regime), None, 0.0, seeds)[1]
        mechanism = MECHANISMS[effects[0].title]
        act = mechanism.act if with_hidden else mechanism.without
        return fly_once(columns, habits(case.regime), act, float(str(sizes[0]["size"])), seeds)[1]

    return Drawn(columns | {"reading_cm": reading_cm[here]}, again, effects), seed


DIGITS = {"second_hand": 4, "days": 4, "blind": 3}
"""Significant digits of a generator's contexts: those of the last would fill a third of the bytes."""
NOISE = {"second_hand": ["heavy_tails"], "days": ["run_offsets", "session_offset"], "blind": ["heavy_tails"]}
"""Names that are true of a generator's noise, with something hidden or not: neither right nor wrong."""
GENERATORS = {"second_hand": second_hand, "days": slow_or_words, "blind": blind}


def predicted(model: Model, columns: Columns, rng: Generator) -> Columns:
    """What the model says of each reading: place and deviation of its hits, whether it is one, and its PIT."""
    sensor = model.sensor
    alone = sensor.reading_model.model_copy(update={"correlation": 0.0})
    model = replace(model, sensor=sensor.model_copy(update={"reading_model": alone}))
    reading_cm, rows = columns["reading_cm"], model.rows(columns)
    below, here = np.zeros(reading_cm.size), np.zeros(reading_cm.size)
    for value in np.arange(sensor.minimum_cm, sensor.maximum_cm + 1.0):
        p = np.exp(model.log_prob(np.full(reading_cm.size, value), columns))
        below += np.where(reading_cm > value, p, 0.0)
        here += np.where(reading_cm == value, p, 0.0)
    edges = [(reading_cm + half - rows.centre_cm) / rows.sigma_cm for half in (0.5, -0.5)]
    hit = alone.weights.hit * (norm.cdf(edges[0]) - norm.cdf(edges[1])) / np.maximum(here, 1e-300)
    nothing = np.isnan(reading_cm)
    found = {
        "model_cm": np.round(rows.centre_cm, 2),
        "model_sigma_cm": rows.sigma_cm,
        "model_hit": np.where(nothing, 0.0, (hit > 0.5).astype(float)),
        "model_pit": np.clip(np.round(below + here * rng.random(here.size), 4), 1e-4, 1.0 - 1e-4),
    }
    return {name: np.where(nothing, np.nan, each) if name == "model_pit" else each for name, each in found.items()}


def value_of(name: str, model: Model, columns: Columns, moved_cm: Array) -> float | None:
    """Parameter with which an effect moves the hits as they were moved; None where it cannot."""
    effect, rows = CATALOGUE[name], model.rows(columns).centre_cm
    strength = next(each for each in effect.parameters if each.neutral is not None)
    best: tuple[float, float | None] = (EXPLAINED, None)
    for of in [None] if effect.per is None else np.unique(columns[effect.per]):
        value = strength.step
        for _ in range(4):
            changed = model.adding(name, None if of is None else str(of), **{strength.name: value})
            moves = changed.rows(columns).centre_cm - rows
            if not np.any(moves):
                break
            value *= float(moves @ moved_cm / (moves @ moves))
            value = min(max(value, strength.low), strength.high) or strength.step
        share = float(moves @ moved_cm) ** 2 / max(float((moves @ moves) * (moved_cm @ moved_cm)), 1e-300)
        best = max(best, (share, value), key=lambda each: each[0])
    return best[1]


def where(table: Drawn, columns: Columns, rng: Generator) -> list[dict[str, Any]]:
    """Slices with whether what is hidden shows in them: true, false, or null where it does not count."""
    slices = list(slices_of(columns))
    if not table.hidden:
        return [each | {"differs": False} for each, _ in slices]

    def measures(reading_cm: Array) -> Array:
        error = np.nan_to_num((reading_cm - columns["model_cm"]) / columns["model_sigma_cm"])
        cut = np.clip(error, -FAR, FAR)
        per_row = np.stack([cut, np.abs(cut), error <= -FAR, error >= FAR])
        return np.array([per_row[:, rows].mean(axis=1) for _, rows in slices])

    drawn = np.array(
        [[measures(table.again(rng, with_hidden)) for with_hidden in (False, True)] for _ in range(REDRAWN)]
    )
    counts = np.array([rows.sum() for _, rows in slices])[:, None]
    change = np.abs(np.diff(drawn.mean(axis=0), axis=0)[0]) / (drawn[:, 0].std(axis=0, ddof=1) + 0.5 / counts)
    largest = change.max(axis=1)
    differs = [True if each >= SHOWN else False if each <= UNSEEN else None for each in largest]
    # What no slice shows, such as readings that are held, is somewhere all the same.
    return [
        each | {"differs": differ if True in differs else None}
        for (each, _), differ in zip(slices, differs, strict=True)
    ]


def make(what: str, seed: int, name: str, folder: Path) -> dict[str, Any]:
    """Draw a table, write it and its model, and return its answer."""
    generator, _, kind = what.partition(" ")
    path = folder / "models" / f"{name}.yaml"
    with TemporaryDirectory() as work:
        bench = Path(work) / "bench.csv"
        table, seed = GENERATORS[generator](kind, seed, bench)
        if generator == "blind":
            given = ("--sensor", blind_run.SENSOR, "--set-up-std-cm", 0.02, "--date", "2026-01-01")
            wrong = command("msp-lab", "characterise", bench, *given, "--out", path)
        else:
            wrong = characterise(bench, path)
    if wrong:
        raise RuntimeError(f"{what} {seed}: {wrong}")
    model, rng = load_model(path), default_rng([SEED, seed])
    digits = {"time_s": 9, "true_range_cm": 4, "model_cm": 4, "model_sigma_cm": 3}
    digits |= {"reading_cm": 6, "model_pit": 4, "neighbour_lag_ms": 4, "neighbour_range_cm": 4, "uptime_s": 6}
    columns = table.columns | predicted(model, table.columns, rng)
    cells = {column: cells_of(each, digits.get(column, DIGITS[generator])) for column, each in columns.items()}
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([cells, *zip(*cells.values(), strict=True)])
    with gzip.GzipFile(folder / "tables" / f"{name}.csv.gz", "wb", mtime=0) as file:
        file.write(text.getvalue().encode())
    hidden = []
    for each in table.hidden:
        values = dict.fromkeys(sorted(each.names), each.value)
        if each.value is None and each.moved_cm is not None and np.any(each.moved_cm):
            values = {word: value_of(word, model, table.columns, each.moved_cm) for word in values}
        rounded = {word: None if value is None else float(f"{value:.5g}") for word, value in values.items()}
        columns_of_it = [] if each.names else list(each.columns)
        hidden.append(
            {"title": each.title, "names": rounded, "channel": each.channel, "columns": columns_of_it}
            | {"standard_errors": each.standard_errors}
        )
    shown = where(table, columns, rng)
    return {"drawn": f"{what}, seed {seed}", "hidden": hidden, "noise": NOISE[generator], "slices": shown}


def main(folder: Path) -> None:
    """Write all tables, models and answers, and the list of names."""
    for part in ("tables", "models", "answers"):
        (folder / part).mkdir(parents=True, exist_ok=True)
    wanted = [(what, SEED + i) for what, count in PLAN.items() for i in range(count)]
    order = default_rng(SEED).permutation(len(wanted))
    answers = {}
    for number, place in enumerate(order, start=1):
        name = f"t{number:02d}"
        what, seed = wanted[place]
        answers[name] = make(what, seed, name, folder)
        print(name, answers[name]["drawn"], [each["names"] for each in answers[name]["hidden"]], flush=True)
    lines = ",\n".join(f"{json.dumps(name)}: {json.dumps(answer)}" for name, answer in answers.items())
    (folder / "answers" / "answers.json").write_text(f"{{\n{lines}\n}}\n", encoding="utf-8")
    with (folder / "names.csv").open("w", encoding="utf-8", newline="") as file:
        rows = csv.writer(file, lineterminator="\n")
        rows.writerow(["name", "channel", "parameter", "unit", "columns", "what"])
        for effect in CATALOGUE.values():
            strength = next(each for each in effect.parameters if each.neutral is not None)
            columns = " ".join([*effect.requires, *([effect.per] if effect.per else [])])
            rows.writerow([effect.name, effect.channels[0], strength.name, strength.unit, columns, effect.sentence])


if __name__ == "__main__":
    main(Path(sys.argv[1]))
