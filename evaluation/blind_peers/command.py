"""Peers on blind tables: draws tables of each kind, and asks every peer.

Tables lie in a folder as `evaluation.blind` lays them out, and are those of its plan with this seed: given ``--out``
with a folder in which that was drawn, the first of each kind are taken from it. What is there already is not made
again. Needs the extra ``bench``.
"""

import argparse
import json
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import default_rng

from evaluation.blind.flight import REGIMES
from evaluation.blind.run import Campaign
from evaluation.blind.run import run as run_gap
from evaluation.blind.score import accepted_names, judge
from evaluation.blind.tables import draw_plan
from evaluation.blind_peers.detectors import DETECTORS, compare
from evaluation.blind_peers.library import library
from evaluation.blind_peers.namers import NAMERS
from evaluation.runner import Row, run_cases
from evaluation.shares import share_of
from msp_range.recording.csv_form import read_csv
from msp_sim.model.model import load_model

ALPHA = 0.05
OURS = "gap workflow"
KINDS = ("null", "one:6", "one:10", "three:10")


def ask(
    seed: int, table: Path, namers: Iterable[str] = tuple(NAMERS), detectors: Iterable[str] = tuple(DETECTORS)
) -> Row:
    """What each peer reports of one table, and its seconds of the processor, into ``peers.json`` next to it too."""
    answers = table / "peers.json"
    reported: dict[str, Any] = json.loads(answers.read_text(encoding="utf-8")) if answers.exists() else {}
    if {*namers, *detectors} <= reported.keys():
        return reported
    model = load_model(table.parents[1] / "bases" / f"{(table / 'base').read_text(encoding='utf-8')}.yaml")
    data = read_csv(table / "measured.csv")
    runs = np.unique(data["run"])
    training = default_rng((seed, int(table.name))).permutation(runs)[: runs.size // 2]
    chosen = data.select(np.isin(data["run"], training))
    contexts = {name: column for name, column in chosen.columns.items() if name != "reading_cm"}

    def timed(what: Callable[[], Any]) -> tuple[Any, float]:
        start_s = time.process_time()
        return what(), time.process_time() - start_s

    if not set(namers) <= reported.keys():
        scores, library_s = timed(lambda: library(model, contexts, chosen["reading_cm"]))
        for name in namers:
            names, seconds = timed(partial(NAMERS[name], scores))
            reported[name] = {"names": sorted(names), "seconds": round(library_s + seconds, 2)}
    if not set(detectors) <= reported.keys():
        rng = default_rng((seed, int(table.name), 1))
        compared = compare(model, contexts, chosen["reading_cm"], rng)
        for name in detectors:
            p_value, seconds = timed(partial(DETECTORS[name], compared, rng))
            reported[name] = {"p_value": p_value, "seconds": round(seconds, 2)}
    answers.write_text(json.dumps(reported, indent=1) + "\n", encoding="utf-8")
    return reported


Counts = dict[tuple[str, str], list[bool]]
"""Yes or no, table by table, of each method in each column."""


def score(out: Path) -> tuple[Counts, dict[str, list[float]]]:
    """What every method reported of the tables that peers saw, against the answers; and seconds per table."""
    names = accepted_names()
    counts: Counts = defaultdict(list)
    seconds: dict[str, list[float]] = defaultdict(list)
    for path in sorted((out / "answers").glob("*.json")):
        answer = json.loads(path.read_text(encoding="utf-8"))
        table = out / "tables" / path.stem
        if not (table / "peers.json").exists():
            continue
        for method, reported in json.loads((table / "peers.json").read_text(encoding="utf-8")).items():
            seconds[method].append(reported["seconds"])
            gap = {"effects": [{"name": name, "verdict": "named"} for name in reported.get("names", ())]}
            alarm = reported["p_value"] < ALPHA if "p_value" in reported else bool(reported["names"])
            _count(counts, method, answer, gap if "names" in reported else None, alarm, names)
        if (table / "gap" / "gap.json").exists():
            gap = json.loads((table / "gap" / "gap.json").read_text(encoding="utf-8"))
            seconds[OURS].append(gap.get("seconds", float("nan")))
            _count(counts, OURS, answer, gap, judge(answer, gap, names).named or bool(gap.get("unknown")), names)
    return counts, seconds


def _count(
    counts: Counts,
    method: str,
    answer: Mapping[str, Any],
    gap: Mapping[str, Any] | None,
    alarm: bool,
    names: Mapping[str, frozenset[str]],
) -> None:
    if answer["kind"] == "null":
        counts[method, answer["regime"]].append(alarm)
    elif answer["kind"] in ("one", "three"):
        wanted = max(each["wanted"] for each in answer["hidden"])
        counts[method, f"{answer['kind']}, {wanted:g} s.e.: found"].append(alarm)
        if gap is not None:
            counts[method, f"{answer['kind']}, {wanted:g} s.e.: exact set"].append(judge(answer, gap, names).exact)


def show(counts: Counts, seconds: Mapping[str, list[float]]) -> str:
    """Two tables in Markdown: shares with 95 % intervals after Wilson."""
    methods = [each for each in (OURS, *NAMERS, *DETECTORS) if each in seconds]
    columns = {column for _, column in counts}
    nulls = [regime for regime in REGIMES if regime in columns]
    rest = sorted(columns - set(nulls))
    parts = []
    for heading, shown in (("Nothing hidden: reported that something is", nulls), ("Something hidden", rest)):
        if not shown:
            continue
        of = max(len(counts.get((method, column), ())) for method in methods for column in shown)
        lines = [f"{heading} (at most {of} tables each)", "", "| | " + " | ".join(shown) + " | s a table |"]
        lines.append("|---" * (len(shown) + 2) + "|")
        for method in methods:
            reported = [counts.get((method, column), []) for column in shown]
            cells = [share_of(sum(each), len(each)) for each in reported]
            lines.append(f"| {method} | " + " | ".join(cells) + f" | {np.mean(seconds[method]):.2g} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("count", type=int, help="tables of each kind")
    parser.add_argument("seed", type=int, help="random seed")
    parser.add_argument("--out", type=Path, help="folder; build/blind-peers-SEED-COUNT unless given")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print both tables."""
    out = given.out or Path("build") / f"blind-peers-{given.seed}-{given.count}"
    campaign = Campaign(out, given.seed)
    cases = draw_plan(given.seed, [f"{kind}={given.count}" for kind in KINDS])
    run_gap(campaign, cases, given.jobs)
    run_cases({str(case.number): (given.seed, campaign.table(case)) for case in cases}, ask, given.jobs)
    print(show(*score(out)))
