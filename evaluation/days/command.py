"""Makes tables of slow data and of flights with words, runs the workflow on each, and prints what it named.

For instance ``--kinds slow:null=20 slow:scale=20 words:surface=20 --seed 1 --out build/days``. An effect without a name
in the catalogue is right as a curve over its variable.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from evaluation.days.generator import KINDS, case
from evaluation.runner import Row, publish, run_cases
from evaluation.second_hand.command import kind_options, wanted
from evaluation.second_hand.workflow import run_case
from evaluation.shares import share_of


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    kind_options(parser, KINDS, 10)


def main(given: argparse.Namespace) -> None:
    """Make what is not there yet, and print the table."""
    results = run_cases(wanted(given, KINDS), make_result, given.jobs, given.out / "cases.jsonl")
    publish(f"{table(results)}\n\n{lines(results)}", given.out)


def make_result(kind: str, seed: int, final: bool = False) -> Row:
    """Make a case and run the workflow on it: what was hidden, what the workflow found, and the outcome."""
    made = case(kind, seed)
    with TemporaryDirectory() as folder:
        found = run_case(made, Path(folder))
    return {"truth": made.truth, "found": found, "outcome": outcome(made.truth, found)}


def outcome(truth: dict[str, Any], found: dict[str, Any]) -> str:
    """``right``, ``nothing``, ``wrong`` (another name or curve), ``more`` (the right one, and others), ``crash``."""
    if found["crash"]:
        return "crash"
    said = [({each["name"], *each["alternatives"]}, False) for each in found["effects"]]
    said += [(set(each["variables"]), True) for each in found["curves"]]
    right = [_is_right(truth["effects"][0], names, is_curve) if truth["effects"] else False for names, is_curve in said]
    if not any(right):
        return "wrong" if said else "right" if not truth["effects"] else "nothing"
    return "right" if sum(right) == len(said) else "more"


def _is_right(effect: dict[str, Any], names: set[str], is_curve: bool) -> bool:
    return bool(names & {effect["variable"]}) if is_curve else bool(names & {*effect["names"], effect["variable"]})


def table(results: Sequence[Row]) -> str:
    """Outcomes by kind, in Markdown."""
    text = [
        "| kind | tables | right | 95 % | nothing | wrong | right and more | crash |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in dict.fromkeys(row["truth"]["kind"] for row in results):
        words = [row["outcome"] for row in results if row["truth"]["kind"] == kind]
        counts = [words.count(word) for word in ("right", "nothing", "wrong", "more", "crash")]
        share = share_of(counts[0], len(words))
        text.append(f"| {kind} | {len(words)} | {counts[0]} | {share} | " + " | ".join(map(str, counts[1:])) + " |")
    return "\n".join(text)


def lines(results: Sequence[Row]) -> str:
    """A line for each table that is not right: what was hidden, and what the workflow reported."""
    text = []
    for row in results:
        truth, found = row["truth"], row["found"]
        if row["outcome"] == "right":
            continue
        hidden = ", ".join(f"{each['title']} {each['size']:.3g}" for each in truth["effects"]) or "nothing"
        sizes = "{white_cm:.2g}, {lasting_cm:.2g} for {lasts_s:.3g} s, {of_runs_cm:.2g} cm".format(**truth)
        said = [" or ".join([each["name"], *each["alternatives"]]) for each in found["effects"]]
        said += [f"curve of {each['channel']} over {' '.join(each['variables'])}" for each in found["curves"]]
        said += [f"calibration: {each}" for each in found["calibration"]] + [found["crash"]] * bool(found["crash"])
        text.append(
            f"{truth['kind']} {truth['seed']}: {row['outcome']}; hidden {hidden}; {truth['rows']} rows, "
            f"{truth['runs']} runs, noise {sizes}; found {'; '.join(said) or 'nothing'}; {found['verdict']}"
        )
    return "\n".join(text)
