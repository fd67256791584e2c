"""The study on a terminal: tables with bands and gaps, explanations, and the changepoint filter's figures."""

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from rich.console import Console

from msp_lab.filter_study.bands import WIDTH, Band
from msp_lab.filter_study.changes import Changes
from msp_lab.filter_study.explain import FilterResult
from msp_lab.filter_study.goals import Goal
from msp_lab.filter_study.scenarios import NAMES
from msp_lab.filter_study.statistics import STATISTICS
from msp_lab.filter_study.table import Row
from msp_range.terminal import plain_table

HEADINGS = ("RMS", "90th %", "median", "mean", "variance")
TITLES = {"fixed": "fixed range", "steps": "set ranges", "random": "random ranges"}


def print_tables(console: Console, verdicts: Sequence[FilterResult], delays: Mapping[str, Mapping[str, float]]) -> None:
    """Print one table per scenario: the value, its band as stated, and the gap before and after the explanation.

    Parameters
    ----------
    console
        Output.
    verdicts
        One per filter.
    delays
        Delay [samples] by scenario and filter.
    """
    for scenario in NAMES:
        rows = [verdict for verdict in verdicts if scenario in verdict.rows]
        if not rows:
            continue
        title = f"{TITLES[scenario]}: value, and band as stated [cm]"
        header = ("filter", *HEADINGS, "delay", "gap", "after")
        console.print(plain_table(header, [_row(row, scenario, delays[scenario]) for row in rows], title=title))
    console.print(
        f"gap: largest distance of a value from the middle of its band, in spreads; a band is {WIDTH:g} spreads to "
        "either side. ! is outside.\n"
        "delay: samples, of the filter as stated; the medians look ahead by half a window.\n",
    )


def _row(verdict: FilterResult, scenario: str, delays: Mapping[str, float]) -> list[str]:
    row, before, after = verdict.rows[scenario], verdict.before[scenario], verdict.after[scenario]
    delay = delays.get(verdict.filter, float("nan"))
    return [
        verdict.filter,
        *(_cell(row, before, index) for index in range(len(STATISTICS))),
        "-" if np.isnan(delay) else f"{delay:.0f}",
        _gap(before, row),
        "" if verdict.changes == () else _gap(after, row),
    ]


def print_explanations(console: Console, reverse: bool, verdicts: Sequence[FilterResult]) -> None:
    """Print what was found about columns and signs, and the explanation of each filter's rows."""
    swapped = [f"{row.filter} ({row.scenario})" for verdict in verdicts for row in verdict.rows.values() if row.swapped]
    if swapped:
        console.print(
            f"The columns median and mean are swapped in {len(swapped)} of {sum(len(each.rows) for each in verdicts)} "
            "rows: RMS^2 = mean^2 + (N - 1)/N variance holds with the other one. Above they are exchanged back.",
        )
    console.print(f"Errors are {'truth less estimate' if reverse else 'estimate less truth'}.\n")
    for verdict in verdicts:
        for line in _explanation(verdict):
            console.print(line)


def _explanation(verdict: FilterResult) -> Iterable[str]:
    if verdict.changes == ():
        yield f"{verdict.filter}: within the bands as stated"
        return
    if verdict.changes is not None:
        yield f"{verdict.filter}: {_words(verdict.changes)} (of {verdict.tried} settings tried)"
    else:
        yield f"{verdict.filter}: unexplained; {verdict.tried} settings tried, with one change and with two"
        yield f"    nearest with one change: {_words(verdict.nearest or ())}"
        for scenario, changes in verdict.alone.items():
            words = "nothing" if changes is None else _words(changes) or "as stated"
            yield f"    {scenario} alone: {words}"
    for scenario, row in verdict.rows.items():
        predicted = ", ".join(
            f"{name} {middle:.{digits}f} ({value:.{digits}f})"
            for name, middle, value, digits in zip(
                HEADINGS, verdict.after[scenario].middle, row.values, row.decimals, strict=True
            )
        )
        yield f"    {scenario:6} predicts (table): {predicted}"


def print_goals(console: Console, goals: Iterable[Goal]) -> None:
    """Print the changepoint filter's figures with their goals."""
    met = {True: "yes", False: "NO", None: ""}
    rows = [(goal.name, goal.shown, goal.wanted, met[goal.met]) for goal in goals]
    console.print(plain_table(("figure", "value", "goal", "met"), rows, "lrl", "the changepoint filter"))


def _words(changes: Changes) -> str:
    return " and ".join(change.text for change in changes)


def _cell(row: Row, band: Band, index: int) -> str:
    digits = 1 if band.high[index] >= 100 else 2
    value, low, high = row.values[index], band.low[index], band.high[index]
    mark = "!" if abs(band.distance(row)[index]) > WIDTH else ""
    return f"{mark}{value:.{digits}f}\n{low:.{digits}f}..{high:.{digits}f}"


def _gap(band: Band, row: Row) -> str:
    return f"{np.abs(band.distance(row)).max():.1f}"
