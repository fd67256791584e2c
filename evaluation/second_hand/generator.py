"""Cases: a table with a known truth, and a bench table of the same sensor in which nothing is hidden.

``case("one:10", 7)`` is always the same case. Kinds: ``null:0``, ``null:0.3``, ``null:0.5``, ``null:0.8`` (correlation
of successive readings), ``null:drift`` (a slow wander inside runs), ``null:tape`` (the bench's ranges err), and
``one:Z``, ``two:Z``, ``three:Z``, ``unknown:Z`` (effects of Z standard errors each), and ``humid:Z`` (vapour is in the
air of the bench, too, which has no column for it). Behind ``@`` may stand the correlation of successive readings, which
is drawn otherwise: ``one:10@0.9``; ``null:0.9`` has it too. ``one:10@tape`` has such a bench and no correlation.
"""

import re
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from operator import or_
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from evaluation.second_hand.base import Base, draw_base
from evaluation.second_hand.density import Law, base_law
from evaluation.second_hand.effect import Effect, Kind, law_with
from evaluation.second_hand.flights import Design, draw_bench, draw_flights
from evaluation.second_hand.physics import KNOWN
from evaluation.second_hand.rows import Rows
from evaluation.second_hand.sample import draw
from evaluation.second_hand.size import sizes_of
from evaluation.second_hand.unknown import UNKNOWN

FINAL_SEED = 3_000_000_000
"""Seeds from here on are for a final run and refused without ``final``: nothing has been tuned on them."""
SENSORS = ("left", "right")
NUMBER = r"\d+(\.\d+)?"
COUNTS = {"one": 1, "two": 2, "three": 3, "unknown": 1, "humid": 1}
HUMID = tuple(each for each in KNOWN if each.title == "humidity")
BENCH_HUMIDITY_PCT = 50.0
NULLS = ("null:0", "null:0.3", "null:0.5", "null:0.8", "null:drift", "null:tape")
ATTEMPTS = 40
"""Most draws of runs and effects for one case; an effect that would be impossibly large is drawn again."""
ATTEMPTS_OF_ONE = 20
"""After so many draws the next effect of the list is taken: this one is hardly ever as large as asked."""
NO_ANSWER_SHARE = 0.003
"""Share of the rows without an answer: an empty cell."""

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Case:
    """Columns of both tables in the CSV form, and the truth as numbers and words for a JSON file."""

    bench: Columns
    runs: Columns
    truth: dict[str, Any]


@dataclass(frozen=True)
class Hidden:
    """What a case is drawn from: times and contexts of both tables, the base, and the effects with their sizes."""

    bench: Rows
    rows: Rows
    base: Base
    effects: Sequence[Effect] = ()
    sizes: Sequence[float] = ()
    asked: float | None = None
    attempt: int = 0


class SeedError(ValueError):
    """The seed is kept for a final run."""


def check_seed(seed: int, final: bool) -> None:
    """Refuse seeds that are kept for a final run, unless this is one."""
    if seed >= FINAL_SEED and not final:
        raise SeedError(f"seed {seed}: seeds from {FINAL_SEED} on are kept for a final run (--final)")


def rng_of(kind: str, seed: int) -> Generator:
    """The source of randomness of a case."""
    return default_rng([seed, zlib.crc32(kind.encode())])


def case(kind: str, seed: int, final: bool = False) -> Case:
    """Make a case.

    Raises
    ------
    SeedError
        The seed is one of those kept for a final run, and this is none.
    ValueError
        There is no such kind.
    """
    return _finish(kind, seed, *drawn(kind, seed, final))


def drawn(kind: str, seed: int, final: bool = False, within: Design | None = None) -> tuple[Hidden, Generator]:
    """What a case is made of, before its readings are drawn, and the source of their randomness; errors as `case`.

    Parameters
    ----------
    within
        What is asked of the runs besides what the effects ask.
    """
    check_seed(seed, final)
    within = within or Design()
    family, _, rest = kind.partition(":")
    number, _, correlation = rest.partition("@")
    if not re.fullmatch(rf"null:(drift|tape|{NUMBER})|({'|'.join(COUNTS)}):{NUMBER}(@({NUMBER}|tape))?", kind):
        raise ValueError(f"kind {kind!r}: expected null:R, drift or tape, or {', '.join(COUNTS)} with :Z or :Z@R")
    rng = rng_of(kind, seed)
    if "tape" in (number, correlation):
        number, correlation = ("0" if family == "null" else number), "0"
        within = within | Design(tape=True)
    if family == "null":
        drift = number == "drift"
        base = draw_base(rng, rng.choice([0.0, 0.3]) if drift else float(number), drift)
        rows = draw_flights(rng, within)
        return Hidden(draw_bench(rng, rows, within.tape), rows, base), rng
    given = float(correlation) if correlation else None
    known = {"unknown": UNKNOWN, "humid": HUMID}.get(family, KNOWN)
    return _hidden(kind, seed, rng, known, COUNTS[family], float(number), given, within), rng


def _hidden(
    kind: str,
    seed: int,
    rng: Generator,
    table: tuple[Kind, ...],
    count: int,
    asked: float,
    correlation: float | None,
    within: Design,
) -> Hidden:
    # The seed goes round the list, so that every effect comes up equally often in a block of seeds.
    for attempt in range(ATTEMPTS):
        first = (seed + attempt // ATTEMPTS_OF_ONE) % len(table)
        others = [index for index in range(len(table)) if index != first]
        picked = [table[first], *(table[index] for index in rng.choice(others, count - 1, replace=False))]
        if _same_thing(picked):
            continue
        base = draw_base(rng, correlation)
        design = reduce(or_, (each.design for each in picked), within)
        rows = draw_flights(rng, design)
        bench = draw_bench(rng, rows, design.tape)
        effects = [each.draw(rng, rows) for each in picked]
        sizes = sizes_of(rows, bench, base, effects, asked, seed % 2**31)
        if sizes is not None:
            return Hidden(bench, rows, base, effects, sizes, asked, attempt)
    raise RuntimeError(f"{kind} {seed}: no possible size in {ATTEMPTS} draws")


def _same_thing(picked: list[Kind]) -> bool:
    """Two mechanisms that are one to the readings: scale and thermometer, the two slants, two of one sensor."""
    titles = {each.title for each in picked}
    return any(len(titles & pair) > 1 for pair in ({"scale", "thermometer_bias"}, {"slant_axis", "slant_beam_edge"}))


def _finish(kind: str, seed: int, hidden: Hidden, rng: Generator) -> Case:
    rows, bench, base = hidden.rows, hidden.bench, hidden.base
    truth = {
        "kind": kind,
        "seed": seed,
        "z": hidden.asked,
        "attempt": hidden.attempt,
        "runs": int(rows.run.max()) + 1,
        "rows": len(rows),
        "sensors": int(rows.sensor.max()) + 1,
        "base": {name: value if isinstance(value, str) else float(value) for name, value in asdict(base).items()},
        "effects": [
            {
                "title": effect.kind.title,
                "names": sorted(effect.kind.names),
                "channel": effect.kind.channel,
                "variable": effect.kind.variable,
                "size": size,
                "between_runs": effect.kind.between_runs,
                **{name: float(value) for name, value in effect.details.items()},
            }
            for effect, size in zip(hidden.effects, hidden.sizes, strict=True)
        ],
    }
    law = law_with(rows, base, hidden.effects, hidden.sizes)
    at_bench = base_law(bench, base)
    if kind.startswith("humid"):
        air = {**bench.contexts, "humidity_pct": np.full(len(bench), BENCH_HUMIDITY_PCT)}
        effects = [each.kind.draw(rng, replace(bench, contexts=air)) for each in hidden.effects]
        at_bench = law_with(bench, base, effects, hidden.sizes)
    return Case(
        bench=_columns(bench, base, at_bench, rng, "bench{:02d}"),
        runs=_columns(rows, base, law, rng, "run{:02d}"),
        truth=truth,
    )


def _columns(rows: Rows, base: Base, law: Law, rng: Generator, run: str) -> Columns:
    reading_cm = draw(rows, base, law, rng).reading_cm
    answered_cm = np.where(rng.random(len(rows)) < NO_ANSWER_SHARE, np.nan, reading_cm)
    return rows.columns(answered_cm, run, SENSORS)
