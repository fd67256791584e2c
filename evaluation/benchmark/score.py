"""Scores findings files: `python evaluation/benchmark/score.py FINDINGS.json ...` prints a table in Markdown.

README.md next to this file says what a findings file holds and what the columns are. It needs numpy, and nothing else
of this repository but the folder that it lies in.
"""

import csv
import gzip
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

HERE = Path(__file__).parent
CHANNELS = ("bias", "spread", "short", "missed", "random")
TIME = frozenset({"time_s", "time_in_run_s"})
"""Columns that are one to a form that is over the time."""
MOST_NAMES = 3
"""A finding may have so many names that its author cannot tell apart; with more it says too little to be right."""
REPORTED = 0.3
"""A slice counts as reported where at least this share of its readings is in reported regions of its column: one region
of a twelfth of the readings says it of a quarter of them."""
NEAR_LIMIT = 6.0
"""Standard errors up to which an effect is near the limit of what can be found: there estimates of what was found are
too large on average."""


class FindingsError(ValueError):
    """A findings file is not in the form of README.md."""


@dataclass
class Score:
    """What one method got right, table by table.

    Attributes
    ----------
    quiet
        Tables with nothing hidden in which nothing was reported.
    exact, near
        Tables with one or two effects, and those with one near the limit: all are named, and nothing else is reported.
    unknown
        Tables with a form that has no name: its channel and a column that it is over, and no name.
    wrong
        Tables in which a name stands for nothing hidden, of all.
    slices
        Of each slice that counts, whether it differs and whether it was reported.
    ratios
        Reported value over true value of each effect that was found, and of those near the limit.
    covered
        Of those with an interval.
    seconds
        Of each table that has them.
    mistakes
        By table where it is not right: what was hidden, and what was found.
    """

    quiet: list[bool] = field(default_factory=list)
    exact: list[bool] = field(default_factory=list)
    near: list[bool] = field(default_factory=list)
    unknown: list[bool] = field(default_factory=list)
    wrong: list[bool] = field(default_factory=list)
    slices: list[tuple[bool, bool]] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    near_ratios: list[float] = field(default_factory=list)
    covered: list[bool] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    mistakes: dict[str, str] = field(default_factory=dict)

    @property
    def where(self) -> tuple[float, float, float]:
        """F1 of the slices, precision and recall; NaN where nothing was reported."""
        differs, reported = np.array(self.slices, dtype=bool).reshape(-1, 2).T
        if not reported.any():
            return np.nan, np.nan, np.nan
        both = float(np.sum(differs & reported))
        return 2.0 * both / float(differs.sum() + reported.sum()), both / reported.sum(), both / max(differs.sum(), 1)


def read_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a frozen table: numbers, NaN where unknown, and words."""
    with gzip.open(path, "rt", encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns: dict[str, NDArray[Any]] = {}
    for name, cells in zip(header, zip(*rows, strict=True), strict=True):
        try:
            columns[name] = np.array([float(each) if each else np.nan for each in cells])
        except ValueError:
            columns[name] = np.array(cells)
    return columns


def read_findings(path: Path, tables: Mapping[str, Mapping[str, Any]], names: frozenset[str]) -> dict[str, Any]:
    """A findings file, checked.

    Parameters
    ----------
    tables
        Columns of the frozen tables by name.
    names
        That an effect may have.

    Raises
    ------
    FindingsError
        It is no JSON, a table is missing or none of the benchmark's, or a finding is not in the form.
    """
    try:
        findings: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FindingsError(f"{path}: {error}") from error
    is_form = isinstance(findings, dict) and isinstance(findings.get("method"), str)
    if not is_form or not isinstance(findings.get("tables"), dict):
        raise FindingsError(f'{path}: expected {{"method": "words", "tables": {{...}}}}')
    for what, odd in (("missing", tables.keys() - findings["tables"]), ("unknown", findings["tables"].keys() - tables)):
        if odd:
            raise FindingsError(f"{path}: tables: {', '.join(sorted(odd))}: {what}; one with nothing found is {{}}")
    for table, found in findings["tables"].items():
        for place, problem in _problems(found, tables[table], names):
            raise FindingsError(f"{path}: tables.{table}{place}: {problem}")
    return findings


def _problems(found: Any, columns: Mapping[str, Any], names: frozenset[str]) -> Iterator[tuple[str, str]]:
    """Where a table's findings are not in the form, and why."""
    lists = ("effects", "unknown", "where")
    if not isinstance(found, dict) or found.keys() - {"seconds", *lists}:
        yield "", f"found {found!r}; expected an object with effects, unknown, where and seconds, all optional"
        return
    if not _is_number(found.get("seconds", 0.0)):
        yield ".seconds", f"found {found['seconds']!r}; expected a number"
    for name in lists:
        entries = found.get(name, [])
        if not isinstance(entries, list) or not all(isinstance(each, dict) for each in entries):
            yield f".{name}", "expected a list of objects"
            return
    for k, each in enumerate(found.get("effects", [])):
        others = each.get("alternatives", [])
        for word in [each.get("name"), *(others if isinstance(others, list) else [others])]:
            if not isinstance(word, str) or word not in names:
                yield f".effects[{k}]", f"found the name {word!r}; names.csv has those that there are"
        numbers = [each[key] for key in ("low", "value", "high") if each.get(key) is not None]
        if not all(map(_is_number, numbers)) or numbers != sorted(numbers) or len(numbers) == 2:
            yield f".effects[{k}]", f"found low, value, high {numbers}; expected numbers in this order, or value alone"
    for k, each in enumerate(found.get("unknown", [])):
        if each.get("channel") not in CHANNELS:
            yield f".unknown[{k}].channel", f"found {each.get('channel')!r}; expected one of {', '.join(CHANNELS)}"
        if not isinstance(each.get("column"), str):
            yield f".unknown[{k}].column", f"found {each.get('column')!r}; expected the name of a column"
    for k, each in enumerate(found.get("where", [])):
        column = columns.get(str(each.get("column")))
        if column is None:
            yield f".where[{k}].column", f"found {each.get('column')!r}; the table has {', '.join(columns)}"
        elif column.dtype.kind == "U" and not isinstance(each.get("word"), str):
            yield f".where[{k}]", f"{each['column']} holds words; expected a word"
        elif column.dtype.kind != "U" and not (_is_number(each.get("low")) and _is_number(each.get("high"))):
            yield f".where[{k}]", f"{each['column']} holds numbers; expected low and high"


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def score(
    findings: Mapping[str, Any], answers: Mapping[str, Any], tables: Mapping[str, Mapping[str, NDArray[Any]]]
) -> Score:
    """Compare checked findings with the answers."""
    total = Score()
    for name, answer in answers.items():
        found = findings["tables"][name]
        effects = [each for each in found.get("effects", []) if each["name"] not in answer["noise"]]
        _score_what(total, name, answer["hidden"], effects, found.get("unknown", []))
        for each in answer["slices"]:
            if each["differs"] is not None:
                reported = _share_in(found.get("where", []), each, tables[name][each["column"]])
                total.slices.append((each["differs"], reported >= REPORTED))
        if "seconds" in found:
            total.seconds.append(found["seconds"])
    return total


def _score_what(total: Score, name: str, hidden: Sequence[Any], effects: Sequence[Any], unknown: Sequence[Any]) -> None:
    named, nameless = [each for each in hidden if each["names"]], [each for each in hidden if not each["names"]]
    pairs = _matched(named, effects)
    over = [{each["channel"] for each in unknown if _is_over(each, one["columns"])} for one in nameless]
    seen = [one["channel"] in channels for one, channels in zip(nameless, over, strict=True)]
    is_wrong = len(pairs) < len(effects)
    is_right = len(pairs) == len(named) and all(seen) and not is_wrong and (bool(nameless) or not unknown)
    total.wrong.append(is_wrong)
    (total.quiet if not hidden else total.unknown if nameless else total.exact).append(is_right)
    if len(named) == 1 and named[0]["standard_errors"] < NEAR_LIMIT:
        total.near.append(is_right)
    if not is_right:
        words = ["/".join([each["name"], *each.get("alternatives", [])]) for each in effects]
        words += [f"unknown {each['channel']} of {each['column']}" for each in unknown]
        there = [f"{each['title']} {each['standard_errors']:.0f}" for each in hidden]
        total.mistakes[name] = f"hidden {', '.join(there) or 'nothing'}; found {', '.join(words) or 'nothing'}"
    for one, each in pairs:
        true, value = one["names"].get(each["name"]), each.get("value")
        if true is None or value is None:
            continue
        total.ratios.append(value / true)
        if one["standard_errors"] < NEAR_LIMIT:
            total.near_ratios.append(value / true)
        if each.get("low") is not None:
            total.covered.append(each["low"] <= true <= each["high"])


def _matched(hidden: Sequence[Any], effects: Sequence[Any]) -> list[tuple[Any, Any]]:
    """Most hidden effects that can each be given a finding of its own, with it; there are two at most."""
    if not hidden:
        return []
    best = _matched(hidden[1:], effects)
    for k, each in enumerate(effects):
        names = {each["name"], *each.get("alternatives", [])}
        if len(names) <= MOST_NAMES and names & hidden[0]["names"].keys():
            with_it = [(hidden[0], each), *_matched(hidden[1:], [*effects[:k], *effects[k + 1 :]])]
            best = max(best, with_it, key=len)
    return best


def _is_over(found: Mapping[str, Any], columns: Sequence[str]) -> bool:
    return found["column"] in columns or bool(found["column"] in TIME and TIME & set(columns))


def _share_in(regions: Sequence[Any], piece: Mapping[str, Any], column: NDArray[Any]) -> float:
    """Share of a slice's readings that are in one of the regions of its column."""

    def inside(region: Mapping[str, Any]) -> NDArray[np.bool_]:
        if "word" in region:
            return np.asarray(column == region["word"])
        return np.asarray((column >= region["low"]) & (column <= region["high"]))

    here = [inside(each) for each in regions if each["column"] == piece["column"]]
    return float(np.mean(np.any(here, axis=0)[inside(piece)])) if here else 0.0


def show(scores: Mapping[str, Score]) -> str:
    """The table of README.md: a row for each method."""
    lines = [
        "| method | nothing hidden: quiet | one or two: exact | of these one near the limit | unknown form: found "
        "| tables with a wrong name | where: F1 (precision, recall) | value over truth, mean (near the limit) "
        "| intervals that hold the truth | s a table |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for method, each in scores.items():
        of = [_of(one) for one in (each.quiet, each.exact, each.near, each.unknown, each.wrong)]
        where = "{:.2f} ({:.2f}, {:.2f})".format(*each.where) if each.where[0] >= 0.0 else "none"
        value = "none"
        if each.ratios:
            near = f"{np.mean(each.near_ratios):.2f} of {len(each.near_ratios)}" if each.near_ratios else "none"
            value = f"{np.mean(each.ratios):.2f} of {len(each.ratios)} ({near})"
        seconds = f"{np.mean(each.seconds):.2g}" if each.seconds else ""
        lines.append("| " + " | ".join([method, *of, where, value, _of(each.covered), seconds]) + " |")
    return "\n".join(lines)


def _of(outcomes: Sequence[bool]) -> str:
    return f"{sum(outcomes)} of {len(outcomes)}"


def scored(paths: Sequence[Path], folder: Path = HERE) -> dict[str, Score]:
    """Read findings files and the folder's answers, and score each method."""
    answers = json.loads((folder / "answers" / "answers.json").read_text(encoding="utf-8"))
    tables = {name: read_columns(folder / "tables" / f"{name}.csv.gz") for name in answers}
    with (folder / "names.csv").open(encoding="utf-8", newline="") as file:
        names = frozenset(row["name"] for row in csv.DictReader(file))
    scores: dict[str, Score] = {}
    for path in paths:
        findings = read_findings(path, tables, names)
        if findings["method"] in scores:
            raise FindingsError(f"{path}: method: found {findings['method']!r}, as in another file; expected its own")
        scores[findings["method"]] = score(findings, answers, tables)
    return scores


def main(words: Sequence[str]) -> int:
    """Score the files that the command line names; with ``--mistakes`` also say where each is not right."""
    paths = [Path(word) for word in words if word != "--mistakes"]
    if not paths or any(word.startswith("-") for word in words if word != "--mistakes"):
        print(__doc__, file=sys.stderr)
        return 2
    try:
        scores = scored(paths)
    except FindingsError as error:
        print(error, file=sys.stderr)
        return 2
    print(show(scores))
    if "--mistakes" in words:
        for method, each in scores.items():
            print(f"\n{method}\n" + "\n".join(f"  {name}: {text}" for name, text in each.mistakes.items()))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
