"""Explain the rows of a table that lie outside their Monte-Carlo bands.

For every filter of a table (`msp_lab.filter_study.table`) it finds the setting that fits all of its rows, or that none
does, with what was tried. The search goes over differences of implementations (`msp_lab.filter_study.changes`), one and
then two at a time. The fewest changes win, then the best fit.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import minimize_scalar

from msp_lab.filter_study.bands import SEEDS, WIDTH, Band, band_in, find_bands
from msp_lab.filter_study.changes import ROUND, Changes, all_made, double, single
from msp_lab.filter_study.nine import AS_REPORTED, Variant
from msp_lab.filter_study.table import Row, Table

SEARCH_SEEDS = 60
"""Runs per scenario for the search; its results are then checked with all `SEEDS`."""
NEAR = 2.0
"""The search keeps settings that fit in bands this many times as wide, since it has fewer seeds."""
FINALISTS = 12
"""Settings from the search that are checked with all seeds, at most."""
AS_GOOD = 4.0
"""Prefer a rounder number if the misfit grows by less than this: two standard deviations."""
MOST_TRIED = 10
"""Values of a factor that are compared before it is rounded: the best is then known to a few per cent."""
CAP = 1e4
"""Limit of one value's part of a misfit, so that two rows far outside still count more than one."""

SEARCH_ORDER = ("steps", "fixed", "random")
"""The scenario that excludes most settings comes first."""

Rows = Mapping[str, Row]


@dataclass(frozen=True)
class FilterResult:
    """Result for one filter."""

    filter: str
    """Name of the filter."""
    rows: Rows
    """Its rows in the table, by scenario."""
    before: Mapping[str, Band]
    """Bands of the study as it is stated, by scenario."""
    changes: Changes | None
    """The explanation of the rows; empty: they lie in those bands; None: nothing that was tried explains them."""
    after: Mapping[str, Band]
    """Bands with the changes, or with the nearest change."""
    tried: int
    """Number of settings that were compared."""
    nearest: Changes | None = None
    """If nothing fits all rows: the single change that comes nearest."""
    alone: Mapping[str, Changes | None] = field(default_factory=dict)
    """If nothing fits all rows: the changes that fit each row alone; None for a row that no change fits."""


def explain_rows(table: Table) -> tuple[bool, list[FilterResult]]:
    """Return whether the table's errors are truth less estimate, and a verdict for every filter in it."""
    of_filter: dict[str, dict[str, Row]] = {}
    for row in table.values():
        of_filter.setdefault(row.filter, {})[row.scenario] = row
    reverse = _is_reversed(of_filter)
    return reverse, [
        _verdict(name, rows, replace(AS_REPORTED[name], reversed=reverse)) for name, rows in of_filter.items()
    ]


def misfit(variant: Variant, rows: Rows, seeds: int, near: float = math.inf) -> tuple[float, float]:
    """-2 log likelihood of all values, taken as normal around their middles, and their largest distance in spreads.

    Both are infinite as soon as a row is farther away than ``near``.
    """
    total, largest = 0.0, 0.0
    for name in sorted(rows, key=SEARCH_ORDER.index):
        band = band_in(variant, name, seeds)
        distance = band.distance(rows[name])
        total += float(np.minimum(distance**2, CAP).sum()) + 2.0 * band.log_spread
        largest = max(largest, float(np.abs(distance).max()))
        if largest > near:
            return math.inf, math.inf
    return total, largest


def _is_reversed(of_filter: Mapping[str, Rows]) -> bool:
    """The sign of the whole table: the one with which more of its filters fit as stated, then the one with which they
    fit better with a change that makes them late. An early one with the other sign looks the same.
    """
    scores = []
    for reverse in (False, True):
        unfit, total = 0, 0.0
        for name, rows in of_filter.items():
            base = replace(AS_REPORTED[name], reversed=reverse)
            unfit += misfit(base, rows, SEEDS)[1] > WIDTH
            lags = (change for change in single(base) if change.kind in _LAGS)
            late = [change for change in lags if change.kind != "delay" or change.value > 0]
            total += min(misfit(start, rows, SEARCH_SEEDS)[0] for start in (base, *(one.made_in(base) for one in late)))
        scores.append((unfit, total))
    return scores[1] < scores[0]


_LAGS = ("delay", "q_factor", "window", "centred")
"""Changes that move the mean error where the range changes."""


def _verdict(name: str, rows: Rows, base: Variant) -> FilterResult:
    before = find_bands(base)
    if misfit(base, rows, SEEDS)[1] <= WIDTH:
        return FilterResult(name, rows, before, (), before, 1)
    searches: tuple[Iterable[Changes], ...] = (((change,) for change in single(base)), double(base))
    tried: list[Changes] = [()]
    for search in searches:
        found = list(search)
        tried += found
        changes = _best(found, base, rows)
        if changes is not None:
            return FilterResult(name, rows, before, changes, find_bands(all_made(changes, base)), len(tried))
    alone = {scenario: _best_alone(tried, base, {scenario: row}) for scenario, row in rows.items()}
    singles = [each for each in tried if len(each) == 1]
    nearest: Changes = min(singles, key=lambda each: misfit(all_made(each, base), rows, SEARCH_SEEDS)[0])
    nearest = _refined(nearest, base, rows)
    after = find_bands(all_made(nearest, base))
    return FilterResult(name, rows, before, None, after, len(tried), nearest, alone)


def _best(found: Sequence[Changes], base: Variant, rows: Rows) -> Changes | None:
    """Those of equally many changes that fit all rows best; None: none fits."""
    fits = [(misfit(all_made(changes, base), rows, SEARCH_SEEDS, NEAR * WIDTH), changes) for changes in found]
    near = sorted((fit for fit in fits if fit[0][1] < math.inf), key=lambda each: each[0][0])
    refined = [_refined(changes, base, rows) for _, changes in near[:FINALISTS]]
    judged = [(misfit(all_made(changes, base), rows, SEEDS), changes) for changes in refined]
    fitting = [each for each in judged if each[0][1] <= WIDTH]
    return min(fitting, key=lambda each: each[0][0])[1] if fitting else None


def _best_alone(tried: Sequence[Changes], base: Variant, row: Rows) -> Changes | None:
    """The fewest, then the best changes that fit one row."""
    for count in range(3):
        changes = _best([each for each in tried if len(each) == count], base, row)
        if changes is not None:
            return changes
    return None


def _refined(changes: Changes, base: Variant, rows: Rows) -> Changes:
    """Set each factor to the value that fits best, or to a round one that fits as well."""
    for index, change in enumerate(changes):
        if change.is_factor:
            changes = _with_best_factor(changes, index, base, rows)
    return changes


def _with_best_factor(changes: Changes, index: int, base: Variant, rows: Rows) -> Changes:
    def with_factor(factor: float) -> Changes:
        return (*changes[:index], replace(changes[index], value=factor), *changes[index + 1 :])

    def cost(factor: float) -> float:
        return misfit(all_made(with_factor(factor), base), rows, SEEDS)[0]

    return with_factor(_best_factor(cost, changes[index].value))


def _best_factor(cost: Callable[[float], float], start: float) -> float:
    """The best within one step of the search to either side; then the roundest number as good."""
    step = math.log(10) / 4
    bounds = math.log(start) - step, math.log(start) + step
    found = minimize_scalar(
        lambda log: cost(math.exp(log)), bounds=bounds, method="bounded", options={"maxiter": MOST_TRIED}
    )
    factor, best = math.exp(found.x), float(found.fun)
    decade = 10.0 ** math.floor(math.log10(factor))
    # 1 before 10 before the rest, and the nearer before the farther.
    rounds = sorted(
        (each * decade * ten for each in ROUND for ten in (1.0, 10.0)),
        key=lambda each: (not math.log10(each).is_integer(), abs(math.log(each / factor))),
    )
    for each in rounds:
        if abs(math.log(each / factor)) < 0.3 and cost(each) < best + AS_GOOD:
            return each
    return float(f"{factor:.3g}")
