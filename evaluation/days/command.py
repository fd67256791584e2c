"""Makes tables of slow data and of flights with words, runs the workflow on each, and prints what it named.

For instance ``--kinds slow:null=20 slow:scale=20 words:surface=20 --seed 1 --out build/days``. An effect without a name
in the catalogue is right as a curve over its variable.
"""

import argparse
from collections.abc import Sequence
from typing import Any

from evaluation.days.generator import KINDS, case
from evaluation.runner import Row, publish
from evaluation.second_hand.command import kind_options, run_kinds
from evaluation.second_hand.score import all_in_words, names_of
from evaluation.second_hand.workflow import run_case
from evaluation.shares import share_of

TOLD_CM = 0.3
"""Offsets of runs of a larger deviation are in the readings, and may be named: the other tables have smaller ones."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    kind_options(parser, KINDS, 10)


def main(given: argparse.Namespace) -> None:
    """Make what is not there yet, and print the table."""
    results = run_kinds(given, make_result, KINDS)
    publish(f"{table(results)}\n\n{lines(results)}", given.out)


def make_result(kind: str, seed: int, final: bool = False) -> Row:
    """Make a case and run the workflow on it: what was hidden, what the workflow found, and the outcome."""
    made = case(kind, seed)
    found = run_case(made)
    return {"truth": made.truth, "found": found, "outcome": outcome(made.truth, found)}


def outcome(truth: dict[str, Any], found: dict[str, Any]) -> str:
    """``right``, ``nothing``, ``wrong`` (another name or curve), ``more`` (the right one, and others), ``crash``."""
    if found["crash"]:
        return "crash"
    names, curves = names_of(found), [set(each["variables"]) for each in found["curves"]]
    if truth["of_runs_cm"] > TOLD_CM:
        names = [each for each in names if "run_offsets" not in each]
    right = 0
    for effect in truth["effects"]:
        right = sum(bool(each & {*effect["names"], effect["variable"]}) for each in names)
        right += sum(effect["variable"] in each for each in curves)
    reported = len(names) + len(curves)
    if not right:
        return "wrong" if reported else "nothing" if truth["effects"] else "right"
    return "right" if right == reported else "more"


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
        text.append(
            f"{truth['kind']} {truth['seed']}: {row['outcome']}; hidden {hidden}; {truth['rows']} rows, "
            f"{truth['runs']} runs, noise {sizes}; found {all_in_words(found)}; {found['verdict']}"
        )
    return "\n".join(text)
