"""Cases: a table of late or early readings with a known truth, and a bench table of the same sensor.

``case("late", 7)`` is always the same case. Kinds: ``late`` (readings are 0.05 to 0.5 s older than their stamps),
``early`` (the reference is the older one, by 0.05 to 0.3 s), ``with`` (late, and one more effect), ``none`` (nothing is
hidden), ``long`` (late, with more readings than the workflow searches).
"""

from numpy.random import Generator

from evaluation.delay.flights import Log, draw_flights, draw_log, late, logged
from evaluation.second_hand.base import Base, draw_base
from evaluation.second_hand.density import base_law
from evaluation.second_hand.effect import Effect, law_with
from evaluation.second_hand.flights import draw_bench
from evaluation.second_hand.generator import Case, Columns, check_seed, rng_of
from evaluation.second_hand.physics import KNOWN
from evaluation.second_hand.rows import Rows
from evaluation.second_hand.sample import draw

KINDS = ("late", "early", "with", "none", "long")
ROWS = {"long": 40_000}
"""Readings of a table, about; of the other kinds `USUAL_ROWS`."""
USUAL_ROWS = 6_000
SECOND = {
    "scale": 2.0,
    "propeller_spread": 1.0,
    "misses_when_tilted": 2.5,
    "stale": 0.2,
    "multipath": 0.08,
    "vibration": 0.7,
    "coarse_rounding": 0.5,
    "slant_axis": 1.0,
}
"""Effects of `evaluation/second_hand` that a late sensor has as well, by turns, and their sizes there: each is found
alone."""
DELAYS_S = {"early": (-0.3, -0.05), "none": (0.0, 0.0)}
"""Delays of a kind [s]; of the others 0.05 to 0.5 s."""


def case(kind: str, seed: int, final: bool = False) -> Case:
    """Make a case.

    Raises
    ------
    SeedError
        The seed is one of those kept for a final run, and this is none.
    """
    check_seed(seed, final)
    rng = rng_of(f"delay {kind}", seed)
    base, log = draw_base(rng), draw_log(rng, ROWS.get(kind, USUAL_ROWS))
    rows = draw_flights(rng, log)
    delay_s = round(float(rng.uniform(*DELAYS_S.get(kind, (0.05, 0.5)))), 4)
    seen = late(rows, delay_s)
    effects: list[Effect] = []
    if kind == "with":
        title = list(SECOND)[seed % len(SECOND)]
        effects = [next(each for each in KNOWN if each.title == title).draw(rng, seen)]
    sizes = [SECOND[each.kind.title] for each in effects]
    reading_cm = draw(seen, base, law_with(seen, base, effects, sizes), rng).reading_cm
    return Case(
        bench=_bench(rng, rows, base),
        runs=logged(rng, rows, log) | {"reading_cm": reading_cm},
        truth=_truth(kind, seed, rows, log, base, delay_s)
        | {"effects": [{"title": each.kind.title, "names": sorted(each.kind.names)} for each in effects]},
    )


def _truth(kind: str, seed: int, rows: Rows, log: Log, base: Base, delay_s: float) -> dict[str, object]:
    return {
        "kind": kind,
        "seed": seed,
        "delay_ms": 1e3 * delay_s,
        "rows": len(rows),
        "runs": int(rows.run.max()) + 1,
        "spacing_s": rows.spacing_s,
        "edges": log.edges,
        "pauses": log.pauses,
        "repeated": log.repeated,
        "noise_cm": log.noise_cm,
        "names_noise": log.names_noise,
        "correlation": base.correlation,
    }


def _bench(rng: Generator, rows: Rows, base: Base) -> Columns:
    bench = draw_bench(rng, rows)
    return bench.columns(draw(bench, base, base_law(bench, base), rng).reading_cm, "bench{:02d}")
