"""What explains the rows of a table that lie outside their Monte-Carlo bands: the gap workflow in small.

A table enters (`msp_lab.filter_study.table`); for every filter the setting leaves that fits all of its rows at once,
or that nothing does and what was tried. Searched is what two implementations of one filter may differ in
(`msp_lab.filter_study.changes`), one thing and then two at a time. The fewest changes win, then the best fit.
"""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from msp_lab.filter_study.bands import WIDTH, Band, Setting, band_in, find_bands
from msp_lab.filter_study.changes import ROUND, Change, Changes, all_made, double, single
from msp_lab.filter_study.nine import AS_REPORTED
from msp_lab.filter_study.table import Row, Table

SEEDS = 1000
"""Runs a scenario for the bands."""
SEARCH_SEEDS = 60
"""For the search; what it finds is then judged by the bands of all `SEEDS`."""
NEAR = 2.0
"""The search goes on with what fits, by its fewer seeds, in bands this many times as wide."""
FINALISTS = 12
"""At most so many of the settings that the search found are judged with all seeds."""
AS_GOOD = 4.0
"""A rounder number is kept where the misfit grows by less than this: two standard deviations."""
CAP = 1e4
"""A value's part of a misfit at most, so that two hopeless rows can still be told from one."""

SEARCH_ORDER = ("steps", "fixed", "random")
"""The scenario first that tells most."""

Rows = Mapping[str, Row]


@dataclass(frozen=True)
class Verdict:
    """What came of one filter.

    Attributes
    ----------
    filter
        Its name.
    rows
        Its rows in the table, by scenario.
    before
        Bands of the study as it is stated, by scenario.
    changes
        What explains the rows; empty where they lie in those bands; None where nothing that was tried does.
    after
        Bands with the changes, or with the nearest one.
    tried
        How many settings were compared.
    nearest
        Where nothing fits all rows: the one change that comes nearest.
    alone
        Where nothing fits all rows: what fits each row alone; None where nothing does.
    """

    filter: str
    rows: Rows
    before: Mapping[str, Band]
    changes: Changes | None
    after: Mapping[str, Band]
    tried: int
    nearest: Changes | None = None
    alone: Mapping[str, Changes | None] = field(default_factory=dict)


def explain_rows(table: Table) -> tuple[bool, list[Verdict]]:
    """Whether the table's errors are truth less estimate, and a verdict for every filter in it."""
    of_filter: dict[str, dict[str, Row]] = {}
    for row in table.values():
        of_filter.setdefault(row.filter, {})[row.scenario] = row
    reverse = _is_reversed(of_filter)
    return reverse, [
        _verdict(name, rows, Setting(AS_REPORTED[name], reversed=reverse)) for name, rows in of_filter.items()
    ]


def misfit(setting: Setting, rows: Rows, seeds: int, near: float = math.inf) -> tuple[float, float]:
    """-2 log likelihood of all values, taken as normal around their middles, and their largest distance in spreads.

    Both are infinite as soon as a row is farther away than ``near``.
    """
    total, largest = 0.0, 0.0
    for name in sorted(rows, key=SEARCH_ORDER.index):
        band = band_in(setting, name, seeds)
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
            base = Setting(AS_REPORTED[name], reversed=reverse)
            unfit += misfit(base, rows, SEEDS)[1] > WIDTH
            lags = (change for change in single(base) if change.kind in _LAGS)
            late = [change for change in lags if change.kind != "delay" or change.value > 0]
            total += min(misfit(each, rows, SEARCH_SEEDS)[0] for each in (base, *(one.made_in(base) for one in late)))
        scores.append((unfit, total))
    return scores[1] < scores[0]


_LAGS = ("delay", "q_factor", "window", "centred")
"""What moves the mean error where the range changes."""


def _verdict(name: str, rows: Rows, base: Setting) -> Verdict:
    before = find_bands(base, SEEDS)
    if misfit(base, rows, SEEDS)[1] <= WIDTH:
        return Verdict(name, rows, before, (), before, 1)
    searches: tuple[Iterable[Changes], ...] = (((change,) for change in single(base)), double(base))
    tried: list[Changes] = [()]
    for search in searches:
        found = list(search)
        tried += found
        changes = _best(found, base, rows)
        if changes is not None:
            return Verdict(name, rows, before, changes, find_bands(all_made(changes, base), SEEDS), len(tried))
    alone = {scenario: _best_alone(tried, base, {scenario: row}) for scenario, row in rows.items()}
    singles = [each for each in tried if len(each) == 1]
    nearest: Changes = min(singles, key=lambda each: misfit(all_made(each, base), rows, SEARCH_SEEDS)[0])
    nearest = _refined(nearest, base, rows)
    after = find_bands(all_made(nearest, base), SEEDS)
    return Verdict(name, rows, before, None, after, len(tried), nearest, alone)


def _best(found: Sequence[Changes], base: Setting, rows: Rows) -> Changes | None:
    """Of changes that are equally many, those that fit all rows best; None where none fits."""
    fits = [(misfit(all_made(changes, base), rows, SEARCH_SEEDS, NEAR * WIDTH), changes) for changes in found]
    near = sorted((each for each in fits if each[0][1] < math.inf), key=lambda each: each[0][0])
    refined = [_refined(changes, base, rows) for _, changes in near[:FINALISTS]]
    judged = [(misfit(all_made(changes, base), rows, SEEDS), changes) for changes in refined]
    fitting = [each for each in judged if each[0][1] <= WIDTH]
    return min(fitting, key=lambda each: each[0][0])[1] if fitting else None


def _best_alone(tried: Sequence[Changes], base: Setting, row: Rows) -> Changes | None:
    """The fewest changes, then the best, that fit one row."""
    for count in range(3):
        changes = _best([each for each in tried if len(each) == count], base, row)
        if changes is not None:
            return changes
    return None


def _refined(changes: Changes, base: Setting, rows: Rows) -> Changes:
    """Let each factor take the value that fits best, or a round one that fits as well."""
    for index, change in enumerate(changes):
        if not change.is_factor:
            continue

        def cost(factor: float, index: int = index, change: Change = change, changes: Changes = changes) -> float:
            others = (*changes[:index], Change(change.kind, factor), *changes[index + 1 :])
            return misfit(all_made(others, base), rows, SEEDS)[0]

        factor = _best_factor(cost, change.value)
        changes = (*changes[:index], Change(change.kind, factor), *changes[index + 1 :])
    return changes


def _best_factor(cost: Callable[[float], float], start: float) -> float:
    """Golden section over the logarithm, one step of the search to either side; then the roundest number as good."""
    shrink = (math.sqrt(5) - 1) / 2
    low, high = math.log(start) - math.log(10) / 4, math.log(start) + math.log(10) / 4
    left, right = high - shrink * (high - low), low + shrink * (high - low)
    cost_left, cost_right = cost(math.exp(left)), cost(math.exp(right))
    for _ in range(8):
        if cost_left < cost_right:
            high, right, cost_right = right, left, cost_left
            left = high - shrink * (high - low)
            cost_left = cost(math.exp(left))
        else:
            low, left, cost_left = left, right, cost_right
            right = low + shrink * (high - low)
            cost_right = cost(math.exp(right))
    factor, best = (left, cost_left) if cost_left < cost_right else (right, cost_right)
    factor = math.exp(factor)
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
