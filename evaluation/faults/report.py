"""A campaign as tables: one row for each group, the goals, and the worst flights.

Lines of flights.jsonl enter; tables leave, as lists of cells with the headings first.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from statistics import stdev
from typing import Any

import numpy as np
from rich import box
from rich.table import Table

from evaluation.faults.families import FAMILIES
from evaluation.faults.judge import LEANS, PROBABILITIES, REPORT_WRONG_S
from evaluation.faults.plans import ROWS_BY_TURN, SHARES, SOURCES, TURNS
from evaluation.faults.truth import MOTIONS

Line = dict[str, Any]
Cells = list[list[str]]

WORST = 4
"""Flights listed for each kind of error; more only lengthen the table."""
FAULTLESS = ("no fault", "hover", "airframe", "follow", "minimum", "banked", "edge", "boxes")
"""Groups and families of which flights without a fault of a sensor have no other fault either."""
BOOTSTRAP = 2000
"""Draws of flights for the limits of a share; ten times as many change them by less than a tenth of their width."""
FROM_S, FOR_S, WORST_M, REPORTED = range(4)
"""Fields of an event; see `evaluation.faults.judge.Event`."""


@dataclass(frozen=True)
class Sum:
    """Several flights together."""

    lines: Sequence[Line]

    def total(self, name: str) -> float:
        """Sum of a figure of the verdicts."""
        return float(sum(line["verdict"][name] for line in self.lines))

    def events(self, name: str) -> list[Sequence[Any]]:
        """Wrong distances or silences of all flights."""
        return [event for line in self.lines for event in line["verdict"][name]]

    @property
    def wrong_s(self) -> float:
        """Time with wrong distances [s]."""
        return _lasting_s(self.events("wrong"))

    @property
    def reported(self) -> str:
        """Wrong distances that were reported, of all of them."""
        events = self.events("wrong")
        return f"{len(events) - len(_unreported(events))} of {len(events)}"

    @property
    def decidable(self) -> str:
        """Wrong distances without a report that the observer could have reported in time, of all of them."""
        decided = [is_decidable(line, i) for line in self.lines for i in _unreported(line["verdict"]["wrong"])]
        return f"{sum(decided)} of {len(decided)}" if decided else ""

    @property
    def unreported_silences(self) -> str:
        """Silences that were not reported, of all of them."""
        events = self.events("silences")
        return f"{len(_unreported(events))} of {len(events)}"

    @property
    def false_objects(self) -> int:
        """Texts on objects that were not there."""
        return len(self.events("false_objects"))

    def share(self, part: str, whole: str) -> float | None:
        """One sum over another [%]; None: there was no time."""
        total = self.total(whole)
        return 100.0 * self.total(part) / total if total else None

    def percent(self, part: str, whole: str) -> str:
        """The same in words; empty: there was no time."""
        share = self.share(part, whole)
        return "" if share is None else f"{share:.1f}"

    def percent_with_error(self, part: str, whole: str) -> str:
        """A share [%] and its standard error: flights differ, the moments of a flight do not."""
        verdicts = [line["verdict"] for line in self.lines]
        shares = [100.0 * each[part] / each[whole] for each in verdicts if each[whole] > 0.0]
        error = f" ± {stdev(shares) / math.sqrt(len(shares)):.1f}" if len(shares) > 1 else ""
        return self.percent(part, whole) + error

    def cells(self) -> dict[str, str]:
        """Heading -> figure, of the columns of all tables."""
        wrong, silences, verdicts = self.events("wrong"), self.events("silences"), [e["verdict"] for e in self.lines]
        unreported = [_unreported(each["wrong"]) for each in verdicts]
        warnings = [len(line["verdict"]["warnings"]) for line in self.lines if line["healthy"]]
        return {
            "flights": str(len(self.lines)),
            "flights wrong and unreported": str(sum(map(bool, unreported))),
            "wrong distances": str(len(wrong)),
            "longest, s": f"{max((event[FOR_S] for event in wrong), default=0.0):.1f}",
            "together, s": f"{self.wrong_s:.1f}",
            "wrong, s": f"{self.wrong_s:.1f}",
            "reported": self.reported if wrong else "",
            "unreported, s": f"{_lasting_s([wrong[i] for i in _unreported(wrong)]):.1f}",
            "decidable": self.decidable,
            "wrong 'above max.'": str(round(self.total("above_wrong"))),
            "within 3 s.d., %": self.percent("honest_in_range_s", "in_range_s"),
            "valid within 3 s.d., %": self.percent("honest_s", "valid_s"),
            "while faulty, %": self.percent("faulty_honest_s", "faulty_in_range_s"),
            "within 1.96 s.d., %": self.percent("covered_s", "valid_s"),
            "silent, s": f"{_lasting_s(silences):.1f}",
            "longest silence, s": f"{max(each['longest_gap_s'] for each in verdicts):.1f}",
            "unreported silences": self.unreported_silences,
            "false objects": str(self.false_objects),
            "false objects in 1000 s": f"{1000.0 * self.false_objects / self.total('flown_s'):.1f}",
            "false warnings": str(sum(warnings)) if warnings else "",
        }


_COLUMNS = {
    each: each
    for each in (
        *("flights", "wrong distances", "longest, s", "together, s", "reported", "wrong 'above max.'"),
        *("within 3 s.d., %", "while faulty, %", "within 1.96 s.d., %", "longest silence, s", "unreported silences"),
        "false objects in 1000 s",
    )
}
_HOSTILE_COLUMNS = {
    each: each
    for each in (
        *("flights", "flights wrong and unreported", "wrong distances", "reported", "wrong, s", "unreported, s"),
        *("decidable", "longest, s", "silent, s", "longest silence, s", "unreported silences", "within 3 s.d., %"),
        *("false objects", "false warnings"),
    )
} | {"within 3 s.d., %": "valid within 3 s.d., %"}
"""Headings of a table -> cells of a `Sum`."""


def _lasting_s(events: Sequence[Sequence[Any]]) -> float:
    """How long events last together [s]."""
    return float(sum(event[FOR_S] for event in events))


def _unreported(events: Sequence[Sequence[Any]]) -> list[int]:
    """Which events were not reported."""
    return [i for i, event in enumerate(events) if event[REPORTED] is None]


def is_decidable(line: Line, i: int) -> bool:
    """Whether the observer knew in time that a distance was wrong; see `evaluation.faults.observer`."""
    decided_s = line.get("decidable_s") or []
    return i < len(decided_s) and decided_s[i] is not None and decided_s[i] <= REPORT_WRONG_S


def shown(cells: Cells) -> Table:
    """A table for a terminal."""
    table = Table(*cells[0], box=box.SIMPLE)
    for row in cells[1:]:
        table.add_row(*row)
    return table


def markdown(cells: Cells) -> str:
    """A table for a document."""
    return "".join(f"| {' | '.join(row)} |\n" for row in [cells[0], ["---"] * len(cells[0]), *cells[1:]])


def groups_table(lines: Sequence[Line]) -> Cells:
    """One row for each group and kind."""
    rows: list[str] = []
    for group in SHARES:
        rows += [f"{group}: {kind}" for kind in TURNS[group]] if group in ROWS_BY_TURN else [group]
    return _table("group", _COLUMNS, [(row, _in(lines, "row", row)) for row in rows] + [("all", list(lines))])


def families_table(lines: Sequence[Line]) -> Cells:
    """One row for each hostile family, and where it has several kinds of flight one for each."""
    parts: list[tuple[str, list[Line]]] = []
    for name in FAMILIES:
        some = _in(lines, "group", name)
        rows = sorted({line["row"] for line in some})
        parts += [(name, some), *((row, _in(some, "row", row)) for row in rows if row != name)]
    return _table("family", _HOSTILE_COLUMNS, [*parts, ("all", list(lines))])


def edges_table(lines: Sequence[Line]) -> Cells:
    """Longest silences at edges: of the flights with edges of each row."""
    table = [["row", "edges", "median, s", "90 %, s", "longest, s", "over 0.3 s", "over 0.5 s"]]
    for row in dict.fromkeys(line["row"] for line in lines if line["group"] in ("edge", "boxes")):
        longest_s = np.array([each_s for line in _in(lines, "row", row) for _, each_s in line["verdict"]["edges"]])
        quantiles = [f"{each:.2f}" for each in np.quantile(longest_s, [0.5, 0.9, 1.0])]
        table.append([row, str(len(longest_s)), *quantiles, *(str((longest_s > limit).sum()) for limit in (0.3, 0.5))])
    return table


def _in(lines: Iterable[Line], key: str, value: str) -> list[Line]:
    return [line for line in lines if line[key] == value]


def _table(heading: str, columns: dict[str, str], parts: Sequence[tuple[str, list[Line]]]) -> Cells:
    """A row for each part that has flights."""
    rows = [(name, Sum(some).cells()) for name, some in parts if some]
    return [[heading, *columns], *([name, *(cells[each] for each in columns.values())] for name, cells in rows)]


def coverage_table(lines: Sequence[Line]) -> Cells:
    """How often the stated 95 % interval holds the truth in flights in which nothing is wrong.

    By number of sensors, lean and motion; standing on the ground, at or below the sensors' minimum, has a row of its
    own and counts in no other. The limits are those of a bootstrap over flights, 95 %.
    """
    table = [["valid distances", "flights", "s", "95 % interval holds, %", "95 % limits, %"]]
    healthy = [line for line in lines if line["group"] in FAULTLESS and not line["faults"]]
    parts = [("in the air", healthy, "")]
    for count in sorted({line["facts"]["sensors"] for line in healthy}):
        some = [line for line in healthy if line["facts"]["sensors"] == count]
        parts.append(("1 sensor" if count == 1 else f"{count} sensors", some, ""))
    parts += [(word, healthy, word) for word in (*LEANS, *MOTIONS)]
    draws = np.random.default_rng(1)
    for name, some, word in parts:
        each = np.array([_covered_s(line, word) for line in some]).reshape(-1, 2)
        each = each[each[:, 1] > 0.0]
        if len(each):
            drawn = each[draws.integers(len(each), size=(BOOTSTRAP, len(each)))].sum(axis=1)
            low, high = np.quantile(100.0 * drawn[:, 0] / drawn[:, 1], [0.025, 0.975])
            covered_s, valid_s = each.sum(axis=0)
            share = f"{100.0 * covered_s / valid_s:.1f}"
            table.append([name, str(len(each)), f"{valid_s:.0f}", share, f"{low:.1f} to {high:.1f}"])
    return table


def _covered_s(line: Line, word: str) -> tuple[float, float]:
    """Time in which the interval holds, and with a valid distance, of a lean or a motion; '': of all in the air."""
    some = [
        seconds
        for key, seconds in line["verdict"]["covered_by"].items()
        if word == "standing" or not key.endswith("standing")
        if not word or word in key.split(", ")
    ]
    return sum(covered_s for covered_s, _ in some), sum(valid_s for _, valid_s in some)


def probability_table(lines: Sequence[Line]) -> Cells:
    """How often a fused distance is wrong, by the probability that was recorded with it."""
    table = [["recorded probability", "distances", "of these wrong, %"]]
    for i, (low, high) in enumerate(pairwise([*PROBABILITIES, 1.0])):
        all_, wrong = (sum(line["probable"][i][k] for line in lines) for k in (0, 1))
        if all_:
            table.append([f"{low:g} to {high:g}", str(all_), f"{100.0 * wrong / all_:.2f}"])
    return table


def goals_table(lines: Sequence[Line]) -> Cells:
    """The figures to reach and those that were reached; flights that were not flown leave their rows out."""
    table = [["figure", "goal", "reached"]]
    some = _of(lines, "one", "two")
    if some.lines:
        reached = f"{len(some.events('wrong'))} in {len(some.lines)} flights"
        table.append(["wrong distances, faults on one or two without a common wrong height", "0 in 700", reached])
    some = _of(lines, "three or four")
    if some.lines:
        shares = [100.0 * some.wrong_s / some.total(whole) for whole in ("faulty_s", "judged_s")]
        reached = f"{shares[0]:.1f} % while faulty ({shares[1]:.1f} % of the flights), {some.reported} reported"
        table.append(["wrong distances on three and four: time, reported within 2 s", "at most 1 %, all", reached])
    for group, goal in (("no fault", 99.5), ("one", 98.0), ("two", 90.0)):
        some = _of(lines, group)
        if some.lines:
            reached = f"{some.percent('honest_in_range_s', 'in_range_s')} %"
            if group != "no fault":
                faulty = some.percent("faulty_honest_s", "faulty_in_range_s")
                reached = f"{faulty} % while faulty ({reached} of the flights)"
            table.append([f"valid and within three stated deviations: {group}", f"{goal:g} %", reached])
    # A wrong air temperature is in all readings alike, so no quality can show it.
    some = Sum([line for line in lines if line["group"] not in ("temperature", "thermometer")])
    if some.total("sure_s"):
        reached = f"{some.share('sure_honest_s', 'sure_s'):.2f} %, and it is stated for "
        reached += f"{some.percent('sure_honest_s', 'honest_s')} % of what is within them"
        beyond_s = some.total("valid_s") - some.total("honest_s")
        if beyond_s > 0.0:
            share = (some.total("sure_s") - some.total("sure_honest_s")) / beyond_s
            reached += f" and for {100.0 * share:.1f} % of the {beyond_s:.1f} s that are not"
        table.append(["a quality of 90 or more is within three stated deviations", "99.5 %", reached])
    some = _of(lines, "temperature")
    if some.lines:
        sources = [[line for line in some.lines if line["facts"]["source"] == source] for source in SOURCES]
        each = ", ".join(
            f"{name} {Sum(of).percent_with_error('covered_s', 'valid_s')}"
            for name, of in zip(SOURCES, sources, strict=True)
            if of
        )
        reached = f"{some.percent('covered_s', 'valid_s')} % ({each})"
        table.append(["stated 95 % interval contains the truth, -20 to 45 C", "90 to 99 %", reached])
    table.append(["unreported silences, all flights", "0", Sum(lines).unreported_silences])
    some = _of(lines, "hover")
    if some.lines:
        reached = f"{some.false_objects} in {some.total('flown_s'):,.0f} s"
        table.append(["false objects in hover", "1 in 100,000 s", reached])
    crashed = [line for line in lines if line["crashed"]]
    if crashed:
        table.append(["flights that the bridge did not survive", "0", str(len(crashed))])
    return table


def _of(lines: Iterable[Line], *groups: str) -> Sum:
    return Sum([line for line in lines if line["group"] in groups])


def _worst_event(events: Sequence[Sequence[Any]]) -> tuple[float, str]:
    if not events:
        return 0.0, ""
    worst = max(events, key=lambda event: event[FOR_S])
    off = f", {worst[WORST_M]:+.1f} m" if worst[WORST_M] else ""
    return worst[FOR_S], f"{worst[FOR_S]:.1f} s{off} from {worst[FROM_S]:.1f} s"


def _errors(line: Line) -> dict[str, tuple[float, str]]:
    """How bad a flight is by each kind of error, as a number and in words."""
    verdict = line["verdict"]
    wrong, silences, false_objects = verdict["wrong"], verdict["silences"], len(verdict["false_objects"])
    size, words = _worst_event(wrong)
    unreported = [i for i in _unreported(wrong) if wrong[i][FOR_S] == size]
    if any(not is_decidable(line, i) for i in unreported) and line["group"] in FAMILIES:
        words += ", undecidable"
    beyond_s = verdict["in_range_s"] - verdict["honest_in_range_s"]
    above_s = verdict["above_wrong_s"]
    return {
        "wrong distance": (size, words),
        "wrong 'above the maximum'": (above_s, f"{verdict['above_wrong']} messages, {above_s:.1f} s"),
        "unreported silence": _worst_event([silences[i] for i in _unreported(silences)]),
        "not valid or not within 3 s.d.": (beyond_s, f"{beyond_s:.1f} of {verdict['in_range_s']:.1f} s"),
        "false objects": (false_objects, str(false_objects)),
        "crash": (float(bool(line["crashed"])), str(line["crashed"])),
    }


def worst_table(lines: Sequence[Line]) -> Cells:
    """The worst flights for each kind of error, each of another row."""
    table = [["error", "flight", "group", "how bad", "faults"]]
    measured = [(line, _errors(line)) for line in lines]
    for error in measured[0][1] if measured else ():
        rows: set[str] = set()
        for line, errors in sorted(measured, key=lambda each: each[1][error][0], reverse=True):
            size, words = errors[error]
            if size <= 0 or len(rows) == WORST:
                break
            if line["row"] not in rows:
                rows.add(line["row"])
                kinds = ", ".join(f"{each['kind']} {each.get('probability', 1):g}" for each in line["faults"])
                table.append([error, line["again"], line["row"], words, kinds])
    return table
