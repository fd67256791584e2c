"""What a gap workflow said of blind tables, against what was hidden.

`gap.json` files and answers enter, counts leave, each with a 95 % interval after Wilson. Nothing but the answers and
`names.csv` is asked: which name stands for which mechanism was written down before any table was scored.
"""

import csv
import json
import math
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

NAMES = Path(__file__).parent / "names.csv"

IN_THE_BASE = {
    "spread_with_range": "sigma_growth_cm_per_m",
    "missed_with_range": "max_growth_per_m",
}
"""Names that the base model has a parameter for: said as a calibration, they are said."""


def accepted_names(path: Path = NAMES) -> dict[str, frozenset[str]]:
    """Catalogue names by mechanism."""
    with path.open(encoding="utf-8", newline="") as file:
        return {row["mechanism"]: frozenset(row["names"].split()) for row in csv.DictReader(file)}


@dataclass(frozen=True)
class Outcome:
    """How one table went.

    Attributes
    ----------
    exact
        All that was hidden is named, and nothing else is said.
    named
        Something from the catalogue is named.
    wrong
        Names that stand for nothing hidden.
    found_unknown
        Called unknown, with the right channel and variable.
    resolved_wrongly
        A name is given, alone or with others, and what is hidden is not among them.
    experiment
        An experiment is named that would tell the two apart.
    class_sizes
        Of the names given: how many each stands with.
    """

    exact: bool
    named: bool
    wrong: tuple[str, ...]
    found_unknown: bool
    resolved_wrongly: bool
    experiment: bool
    class_sizes: tuple[int, ...]


def judge(answer: Mapping[str, Any], gap: Mapping[str, Any], names: Mapping[str, frozenset[str]]) -> Outcome:
    """Compare one answer with one `gap.json`."""
    said = [each for each in gap.get("effects", ()) if each.get("verdict") in ("named", "indistinguishable")]
    classes = [_class(each) for each in said]
    calibrated = " ".join(_words(gap.get("calibration", ())))
    unknown = list(gap.get("unknown", ()))
    wanted = [names.get(each["mechanism"], frozenset()) for each in answer["hidden"]]
    free = list(range(len(classes)))
    met = 0
    for accepted in wanted:
        match = next((k for k in free if classes[k] & accepted), None)
        if match is not None:
            free.remove(match)
            met += 1
        elif any(word in calibrated for name in accepted if (word := IN_THE_BASE.get(name))):
            met += 1
    wrong = tuple(sorted(str(said[k]["name"]) for k in free))
    known = [accepted for accepted in wanted if accepted]
    found_unknown = any(_fits(each, entry) for each in answer["hidden"] for entry in unknown)
    resolved_wrongly = any(not any(each & accepted for accepted in wanted) for each in classes)
    return Outcome(
        exact=met == len(known) == len(wanted) and not wrong and not unknown,
        named=bool(said),
        wrong=wrong,
        found_unknown=found_unknown and not wrong,
        resolved_wrongly=resolved_wrongly,
        experiment=any(each.get("experiment") for each in said),
        class_sizes=tuple(len(each) for each in classes),
    )


def _class(effect: Mapping[str, Any]) -> frozenset[str]:
    rivals = [each["name"] if isinstance(each, Mapping) else each for each in effect.get("rivals", ())]
    return frozenset({effect["name"], *rivals} if effect.get("verdict") == "indistinguishable" else {effect["name"]})


def _fits(hidden: Mapping[str, Any], entry: Mapping[str, Any]) -> bool:
    """The right channel, and a variable of those that it depends on; all of them where it takes two."""
    variables = set(entry.get("variables", ()))
    return (
        bool(hidden.get("channel"))
        and hidden["channel"] == entry.get("channel")
        and set(hidden["variables"]) <= variables
    )


def _words(values: Any) -> Iterable[str]:
    if isinstance(values, str):
        yield values
    elif isinstance(values, Mapping):
        for key, value in values.items():
            yield str(key)
            yield from _words(value)
    elif isinstance(values, Sequence):
        for value in values:
            yield from _words(value)


def interval(count: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share."""
    if of == 0:
        return 0.0, 1.0
    z = 1.959964
    share = count / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def table(outcomes: Iterable[tuple[Mapping[str, Any], Outcome]]) -> list[tuple[str, int, int]]:
    """Rows of the table: what, how many, of how many."""
    groups: dict[str, list[Outcome]] = defaultdict(list)
    for answer, outcome in outcomes:
        kind = answer["kind"]
        detail = answer["regime"] if kind == "null" else f"{max(h['wanted'] for h in answer['hidden']):g}"
        groups[f"{kind}|{detail}"].append(outcome)
    rows = []
    for key in sorted(groups):
        kind, detail = key.split("|")
        group = groups[key]
        of = len(group)
        if kind == "null":
            rows.append((f"null, {detail}: a name", sum(o.named for o in group), of))
        elif kind == "confounded":
            rows.append(("confounded pair: resolved wrongly", sum(o.resolved_wrongly for o in group), of))
            rows.append(("confounded pair: experiment named", sum(o.experiment for o in group), of))
        elif kind == "unknown":
            rows.append((f"in no catalogue, {detail} s.e.: called unknown", sum(o.found_unknown for o in group), of))
            rows.append((f"in no catalogue, {detail} s.e.: a wrong name", sum(bool(o.wrong) for o in group), of))
        else:
            many = "one effect" if kind == "one" else "three effects"
            rows.append((f"{many}, {detail} s.e.: exact set", sum(o.exact for o in group), of))
    return rows


def show(rows: Iterable[tuple[str, int, int]], class_sizes: Sequence[int] = ()) -> str:
    """The table as text, in Markdown."""
    lines = ["| what | count | of | share | 95 % interval |", "|---|---|---|---|---|"]
    for what, count, of in rows:
        low, high = interval(count, of)
        lines.append(f"| {what} | {count} | {of} | {count / of:.3f} | {low:.3f} to {high:.3f} |")
    if class_sizes:
        lines.append(f"\nNames in a class, mean: {sum(class_sizes) / len(class_sizes):.2f}")
    return "\n".join(lines)


def score(out: Path) -> str:
    """Judge every table that has a `gap/gap.json`, and return the table.

    Parameters
    ----------
    out
        Folder of answers (answers/NUMBER.json) and tables (tables/NUMBER/gap/gap.json).
    """
    answers, tables = out / "answers", out / "tables"
    names = accepted_names()
    outcomes, missing = [], []
    for path in sorted(answers.glob("*.json")):
        result = tables / path.stem / "gap" / "gap.json"
        if not result.exists():
            missing.append(path.stem)
            continue
        answer = json.loads(path.read_text(encoding="utf-8"))
        outcomes.append((answer, judge(answer, json.loads(result.read_text(encoding="utf-8")), names)))
    text = show(table(outcomes), [size for _, outcome in outcomes for size in outcome.class_sizes])
    return text + (f"\n\nWithout a result, and not counted: {', '.join(missing)}" if missing else "")
