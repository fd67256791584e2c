"""The blind table: what a gap workflow reported of many tables, counted.

A folder of answers and results enters; Markdown leaves, each share with a 95 % interval after Wilson and each quantile
with one by bootstrap, and ``outcomes.json`` with how every table went.
"""

import json
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.blind.score import Outcome, accepted_names, judge
from evaluation.shares import wilson

OUTCOMES = "outcomes.json"
DRAWS = 2000
"""Of the bootstrap."""
STRONG = 10.0
"""Standard errors from which on the share that is closed counts."""


@dataclass(frozen=True)
class Scored:
    """A table with how it went."""

    number: str
    answer: dict[str, Any]
    outcome: Outcome
    verdict: str | None
    seconds: float

    @property
    def kind(self) -> str:
        """Null, one, three, unknown or confounded."""
        return str(self.answer["kind"])

    @property
    def wanted(self) -> float:
        """Standard errors that were wanted of what is hidden; 0 of nothing."""
        return max((float(each["wanted"]) for each in self.answer["hidden"]), default=0.0)


def collect(out: Path) -> tuple[list[Scored], list[str]]:
    """Judge every table that has a result; the numbers of those without."""
    names = accepted_names()
    scored, missing = [], []
    for path in sorted((out / "answers").glob("*.json")):
        result = out / "tables" / path.stem / "gap" / "gap.json"
        if not result.exists():
            missing.append(path.stem)
            continue
        answer = json.loads(path.read_text(encoding="utf-8"))
        gap = json.loads(result.read_text(encoding="utf-8"))
        outcome = judge(answer, gap, names)
        scored.append(Scored(path.stem, answer, outcome, gap.get("verdict"), float(gap.get("seconds") or 0.0)))
    return scored, missing


Group = Sequence[Scored]
Count = tuple[str, int, int]
"""What, how many, of how many."""


def counts(scored: Group) -> list[Count]:
    """The rows that are shares."""
    rows: list[Count] = []

    def row(what: str, group: Group, of: Callable[[Outcome], object]) -> None:
        if group:
            rows.append((what, sum(bool(of(each.outcome)) for each in group), len(group)))

    group: Group
    for regime in sorted({each.answer["regime"] for each in scored if each.kind == "null"}):
        group = [each for each in scored if each.kind == "null" and each.answer["regime"] == regime]
        row(f"nothing hidden, {regime}: a name", group, lambda o: o.named)
        row(f"nothing hidden, {regime}: an unknown curve", group, lambda o: o.unknown)
    for kind, many in (("one", "one effect"), ("three", "three effects")):
        for size, group in _by_size(scored, kind):
            row(f"{many}, {size:g} s.e.: exact set", group, lambda o: o.exact)
            row(f"{many}, {size:g} s.e.: a wrong name", group, lambda o: o.wrong)
    for size, group in _by_size(scored, "unknown"):
        row(f"not in the catalogue, {size:g} s.e.: called unknown, channel and variable right", group, _found)
        row(f"not in the catalogue, {size:g} s.e.: a wrong name", group, lambda o: o.wrong)
        row(f"not in the catalogue, {size:g} s.e.: nothing reported", group, lambda o: not o.reported)
    group = [each for each in scored if each.kind == "confounded"]
    row("two indistinguishable effects: resolved wrongly", group, lambda o: o.resolved_wrongly)
    row("two indistinguishable effects: both named, with the experiment", group, lambda o: o.both)
    row("two indistinguishable effects: a wrong name besides", group, lambda o: o.wrong)
    row("all tables: a wrong name", scored, lambda o: o.wrong)
    return rows


def _found(outcome: Outcome) -> bool:
    return outcome.found_unknown


def _by_size(scored: Group, kind: str) -> Iterable[tuple[float, Group]]:
    groups = defaultdict(list)
    for each in scored:
        if each.kind == kind:
            groups[each.wanted].append(each)
    return sorted(groups.items())


def closed(scored: Group) -> list[str]:
    """Rows on the share of the gap that is closed."""
    rows = []
    for what, kinds in (("one or three effects", ("one", "three")), ("not in the catalogue", ("unknown",))):
        group = [each.outcome.closed for each in scored if each.kind in kinds and each.wanted >= STRONG]
        known_shares = [each for each in group if each is not None]
        for label, shares in (
            (
                "of the excess over the noise floor (95 % of simulated replicates)",
                [each.over_floor for each in known_shares],
            ),
            ("of the whole gap, with random variation in it", [each.of_all for each in known_shares]),
        ):
            known = np.array([share for share in shares if share is not None])
            if known.size < 2:
                continue
            for name, q in (("median", 50), ("10th percentile", 10)):
                value, low, high = _quantile(known, q)
                rows.append(
                    f"| gap closed, {what}, {STRONG:g} s.e. or more, {label}: {name} "
                    f"| {known.size} of {len(known_shares)} | {value:.3f} | {low:.3f} to {high:.3f} |"
                )
    return rows


def _quantile(values: np.ndarray[Any, Any], q: float) -> tuple[float, float, float]:
    """A percentile with its 95 % interval by bootstrap."""
    rng = np.random.default_rng(0)
    drawn = np.percentile(rng.choice(values, (DRAWS, values.size)), q, axis=1)
    low, high = np.percentile(drawn, (2.5, 97.5))
    return float(np.percentile(values, q)), float(low), float(high)


def by_mechanism(scored: Group) -> list[str]:
    """What was reported in place of the truth, mechanism by mechanism, worst first; of three each counts by itself."""
    groups: dict[tuple[str, str, float], list[tuple[bool, str]]] = defaultdict(list)
    for each in scored:
        outcome = each.outcome
        reported = ", ".join(outcome.reported) or "nothing"
        hidden = [str(one["mechanism"]) for one in each.answer["hidden"]]
        if each.kind == "three":
            extra = ", ".join(outcome.wrong) or ", ".join(
                word for word in outcome.reported if word.startswith("unknown")
            )
            for name, met in zip(hidden, outcome.met, strict=True):
                groups["three", name, each.wanted].append((met, f"missed ({extra or 'nothing else'})"))
        elif hidden:
            right = outcome.found_unknown if each.kind == "unknown" else outcome.exact
            if each.kind == "confounded":
                right = not outcome.resolved_wrongly and outcome.named
            if outcome.separable:
                reported += f" (separable: {', '.join(outcome.separable)})"
            groups[each.kind, hidden[0], each.wanted].append((right, reported))
    lines = ["| kind | mechanism | s.e. | right | of | reported instead |", "|---|---|---|---|---|---|"]
    for (kind, name, size), went in sorted(
        groups.items(), key=lambda item: (sum(right for right, _ in item[1]) / len(item[1]), item[0])
    ):
        instead = Counter(reported for right, reported in went if not right)
        if instead:
            words = "; ".join(f"{count} x {reported}" for reported, count in instead.most_common())
            rights = sum(right for right, _ in went)
            lines.append(f"| {kind} | {name} | {size:g} | {rights} | {len(went)} | {words} |")
    return lines


def show(scored: Group, missing: Sequence[str] = ()) -> str:
    """All of it as text, in Markdown."""
    lines = ["| what | count | of | share | 95 % interval |", "|---|---|---|---|---|"]
    for what, count, of in counts(scored):
        low, high = wilson(count, of)
        lines.append(f"| {what} | {count} | {of} | {count / of:.3f} | {low:.3f} to {high:.3f} |")
    quantiles = closed(scored)
    if quantiles:
        lines += ["", "| what | tables | share | 95 % interval |", "|---|---|---|---|", *quantiles]
    lines.append("")
    for kinds in (("one",), ("three",), ("confounded",)):
        sizes = [size for each in scored if each.kind in kinds for size in each.outcome.class_sizes]
        if sizes:
            lines.append(f"Names given as alternatives to each other, mean, {kinds[0]}: {np.mean(sizes):.2f}")
    spent = [each.seconds for each in scored]
    if spent:
        lines.append(f"{len(scored)} tables; {np.mean(spent):.1f} s each")
    if missing:
        lines.append(f"Without a result, and not counted: {', '.join(missing)}")
    wrong = by_mechanism(scored)
    if len(wrong) > 2:
        lines += ["", "Wrong answers by mechanism:", "", *wrong]
    return "\n".join(lines)


def score(out: Path) -> str:
    """Judge every table of a folder that has a result, write ``outcomes.json`` into it, and return the table.

    Parameters
    ----------
    out
        Folder of answers (answers/NUMBER.json) and tables (tables/NUMBER/gap/gap.json).
    """
    scored, missing = collect(out)
    (out / OUTCOMES).write_text(json.dumps([asdict(each) for each in scored], indent=1) + "\n", encoding="utf-8")
    return show(scored, missing)
