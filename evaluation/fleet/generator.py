"""Fleets of 20 vehicles with a known truth, by the rows, densities and effects of `evaluation.second_hand`.

``fleet("odd:latency", 7)`` is always the same fleet. Its sensors have one base with numbers that scatter from unit to
unit. Kinds: ``null``; ``odd:EFFECT``, three vehicles with an effect of 10 standard errors each; ``shared:EFFECT``, all
of them; ``change:offset``, three vehicles whose offset changes at one of their sessions; ``odd:offset``, three that are
mounted too high or too low; ``plain:NUMBER``, one vehicle of which a number of the base is 7 standard deviations
between sensors from what is usual, or as many as ``plain:NUMBER@3`` says.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.random import Generator, default_rng
from numpy.typing import NDArray

from evaluation.fleet.likelihood import likelihood_root
from evaluation.second_hand.base import Base, draw_base
from evaluation.second_hand.density import base_law
from evaluation.second_hand.effect import Apply, Effect, Kind, law_with, moves
from evaluation.second_hand.flights import CONTEXTS, Design, draw_bench, draw_flights, shown_contexts
from evaluation.second_hand.generator import rng_of
from evaluation.second_hand.physics import KNOWN
from evaluation.second_hand.rows import Floats, Rows
from evaluation.second_hand.sample import draw
from evaluation.second_hand.size import sizes_of, standard_errors

VEHICLES = 20
ODD = 3
STANDARD_ERRORS = 10.0
OFFSET_CM, LOG_SIGMA, LOG_ODDS = 0.3, 0.05, 0.2
"""Standard deviations between sensors of one make: offset, logarithms of scatter and of odds of outliers."""
SPREADS = {"offset": OFFSET_CM, "scatter": LOG_SIGMA, "short": LOG_ODDS, "missed": LOG_ODDS, "random": LOG_ODDS}
"""The same by number, in the order in which they are drawn."""
PLAIN_SPREADS = 7.0
LEAST_ROOT = 7.0
"""Root of twice the log-likelihood ratio that an effect of 10 standard errors has to have at least (`likelihood.py`).
The table on which it is taken makes it uncertain by 1, so that three below 10 is no less than was asked for. Where an
effect has less, another fleet is drawn."""
DRAWS = 10
"""A vehicle whose flights would need an impossible size is drawn again, so often at most; then the fleet is."""
KINDS = {
    each.title: each
    for each in KNOWN
    if not each.design.many_runs and each.title not in ("sensor_offset", "thermometer_bias")
}

Columns = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Vehicle:
    """A vehicle's table in the CSV form, and what is hidden in it: effect's title and size, or nothing."""

    name: str
    table: Columns
    hidden: str = ""
    size: float = 0.0


@dataclass(frozen=True)
class Fleet:
    """A fleet, the bench table of a sensor of its make, and the truth.

    Attributes
    ----------
    vehicles, bench
        The tables.
    names
        Names in `msp-lab effects` that are right for the hidden effect.
    odd
        Vehicles that have it, or that changed; of a shared effect none.
    """

    vehicles: tuple[Vehicle, ...]
    bench: Columns
    names: frozenset[str]
    odd: frozenset[str]


def fleet(kind: str, seed: int, vehicles: int = VEHICLES) -> Fleet:
    """Draw a fleet.

    Raises
    ------
    ValueError
        There is no such kind.
    """
    family, _, title = kind.partition("@")[0].partition(":")
    possible = {"odd": (*KINDS, "offset"), "shared": KINDS, "change": ("offset",), "plain": SPREADS}
    if kind != "null" and title not in possible.get(family, ()):
        raise ValueError(
            f"kind {kind!r}: expected null, change:offset, plain:NUMBER or plain:NUMBER@SPREADS of "
            f"{', '.join(SPREADS)}, or odd:EFFECT or shared:EFFECT of {', '.join(KINDS)}"
        )
    rng = rng_of(kind, seed)
    for _ in range(DRAWS):
        drawn = _drawn(kind, rng, vehicles)
        if drawn is not None:
            return drawn
    raise RuntimeError(f"{kind} {seed}: no possible size in {DRAWS} fleets")


def _drawn(kind: str, rng: Generator, vehicles: int) -> Fleet | None:
    """A fleet, or None where its effect has no possible size."""
    family, _, title = kind.partition("@")[0].partition(":")
    common = draw_base(rng)
    hidden = None if family == "plain" else KINDS.get(title)
    if title == "offset" and family != "plain":
        hidden = _offset_kind(family == "change")
    design = replace(hidden.design if hidden is not None else Design(), sensors=1)
    columns = design.columns | {name for name in CONTEXTS if rng.random() < 0.6}
    design = replace(design, columns=columns)
    count = {"odd": ODD, "change": ODD, "plain": 1}.get(family, 0)
    odd = set(rng.choice(vehicles, count, replace=False).tolist())
    fixed = int(rng.integers(2**31))
    made, size = [], None
    names = frozenset({title}) if family == "plain" else frozenset[str]()
    bench_rows = draw_bench(rng, draw_flights(rng, design))
    for number in range(vehicles):
        has_it = hidden is not None and (family == "shared" or number in odd)
        for _ in range(DRAWS):
            base = _of_unit(common, rng, kind if number in odd else "")
            rows = draw_flights(rng, design)
            if not has_it or hidden is None:
                effects: list[Effect] = []
                sizes: list[float] | None = []
                break
            # The same generator for each: an effect's own numbers are those of the fleet.
            effects = [hidden.draw(default_rng(fixed), rows)]
            names = hidden.names
            sizes = (
                [size] if family == "shared" and size is not None else _sizes(rows, bench_rows, base, effects, fixed)
            )
            if sizes is not None:
                break
        else:
            return None
        assert sizes is not None
        asked = effects if title != "offset" and (family == "odd" or size is None) else []
        if asked and likelihood_root(rows, base, asked, sizes, fixed) < LEAST_ROOT:
            return None
        if family == "shared":
            size = sizes[0]
            sizes = [size * float(np.exp(0.1 * rng.standard_normal()))]
        made.append(
            Vehicle(
                f"V{number + 1:02d}",
                _columns(
                    rows, draw(rows, base, law_with(rows, base, effects, sizes), rng).reading_cm, columns, "flight{}"
                ),
                title if has_it else "",
                sizes[0] if sizes else 0.0,
            )
        )
    bench = _columns(
        bench_rows,
        draw(bench_rows, common, base_law(bench_rows, common), rng).reading_cm,
        frozenset(CONTEXTS),
        "bench{}",
    )
    return Fleet(tuple(made), bench, names, frozenset(f"V{number + 1:02d}" for number in odd))


def _of_unit(common: Base, rng: Generator, kind: str) -> Base:
    """The numbers of one sensor of the make; of a plain kind one of them is far from what is usual."""
    scatter = dict(zip(SPREADS, rng.standard_normal(len(SPREADS)), strict=True))
    family, _, plain = kind.partition(":")
    if family == "plain":
        number, _, spreads = plain.partition("@")
        # A fault adds outliers.
        is_less = number in ("offset", "scatter") and rng.random() < 0.5
        scatter[number] = float(spreads or PLAIN_SPREADS) * (-1.0 if is_less else 1.0)
    off = {name: spread * scatter[name] for name, spread in SPREADS.items()}
    return replace(
        common,
        offset_cm=common.offset_cm + off["offset"],
        sigma_cm=common.sigma_cm * float(np.exp(off["scatter"])),
        short=common.short + off["short"],
        missed=common.missed + off["missed"],
        random=common.random + off["random"],
    )


def _sizes(rows: Rows, bench: Rows, base: Base, effects: Sequence[Effect], seed: int) -> list[float] | None:
    if effects[0].kind.title == "offset":
        # An offset is a number of every sensor: of vehicles too it is known only within their scatter.
        error = standard_errors(
            rows, replace(base, offset_cm=0.0), effects, [1.0], seed, tables=1, known=_known_offset()
        )
        between = 0.0 if effects[0].kind.between_runs else OFFSET_CM
        return [STANDARD_ERRORS * float(np.hypot(error[0], between))]
    return sizes_of(rows, bench, base, effects, STANDARD_ERRORS, seed)


def _known_offset() -> NDArray[np.float64]:
    """Information of the base's numbers: its own offset is a constant next to the effect, and known."""
    known = np.zeros(10)
    known[0] = 1e6
    return known


def _offset_kind(changes: bool) -> Kind:
    """An offset, in all sessions or from one of them on."""

    def change(rng: Generator, rows: Rows) -> tuple[Apply, dict[str, float]]:
        runs = int(rows.run.max()) + 1
        first = int(rng.integers(2, 5)) if changes else 0
        sign = 1.0 if rng.random() < 0.5 else -1.0
        later = rows.run >= min(first, runs - 2)
        return moves(lambda size: sign * size * later), {}

    return Kind("offset", Design(), change, 30.0, 0.5, frozenset({"offset"}), between_runs=changes)


def _columns(rows: Rows, reading_cm: Floats, shown: frozenset[str], run: str) -> Columns:
    return replace(rows, contexts=shown_contexts(rows.contexts, shown)).columns(reading_cm, run)
