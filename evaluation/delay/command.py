"""Makes tables of late readings, runs the workflow on each, and prints what it named and by how much it was off.

For instance ``--kinds late=20 early=10 with=16 none=20 --seed 1 --out build/delay``.
"""

import argparse
from collections.abc import Sequence
from typing import Any

import numpy as np

from evaluation.delay.generator import KINDS, case
from evaluation.runner import Row, publish
from evaluation.second_hand.command import kind_options, run_kinds
from evaluation.second_hand.score import in_words, matched, names_of
from evaluation.second_hand.workflow import run_case

LATENCY = {"latency"}


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    kind_options(parser, KINDS[:-1], 10)


def main(given: argparse.Namespace) -> None:
    """Make what is not there yet, and print the table."""
    results = run_kinds(given, make_result, KINDS)
    publish(f"{table(results)}\n\n{lines(results)}", given.out)


def make_result(kind: str, seed: int, final: bool = False) -> Row:
    """Make a case and run the workflow on it: what was hidden, what the workflow found, and how that compares."""
    made = case(kind, seed, final)
    return {"truth": made.truth, "found": run_case(made)}


def scored(truth: dict[str, Any], found: dict[str, Any]) -> dict[str, Any]:
    """Compare what was found with what was hidden.

    Returns
    -------
    dict
        ``late``: the delay was named; ``second``: so was each other effect; ``wrong``: names that nothing hidden has;
        ``curves``: curves, of which nothing was hidden; ``off_ms`` and ``covered``: error of the delay, and whether its
        interval holds the truth, None where it was not named.
    """
    named = names_of(found)
    delays = [each["parameters"]["delay_ms"] for each in found["effects"] if each["name"] == "latency"]
    others = [set(each["names"]) for each in truth["effects"]]
    wanted = [*others, *([LATENCY] if truth["delay_ms"] else [])]
    is_late = any(LATENCY & names for names in named)
    known = [each for each in delays if each["low"] is not None]
    return {
        "late": is_late and bool(truth["delay_ms"]),
        "second": matched(others, named) == len(others),
        "wrong": len(named) - matched(wanted, named),
        "curves": len(found["curves"]),
        "off_ms": delays[0]["value"] - truth["delay_ms"] if delays else None,
        "half_ms": (known[0]["high"] - known[0]["low"]) / 2.0 if known else None,
        "covered": known[0]["low"] <= truth["delay_ms"] <= known[0]["high"] if known else None,
    }


def table(results: Sequence[Row]) -> str:
    """What was named, how far off delays were and how often their intervals held the truth, by kind, in Markdown."""
    text = [
        "| kind | tables | delay named | all right | wrong names | curves | crash | bias of the delay [ms] "
        "| median error, half interval [ms] | covered |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    kinds = dict.fromkeys(row["truth"]["kind"] for row in results)
    for kind in kinds:
        rows = [row for row in results if row["truth"]["kind"] == kind]
        each = [scored(row["truth"], row["found"]) for row in rows]
        right = sum(
            one["second"] and not one["wrong"] and not one["curves"] and one["late"] == (row["truth"]["delay_ms"] != 0)
            for one, row in zip(each, rows, strict=True)
        )
        off = np.array([one["off_ms"] for one in each if one["off_ms"] is not None])
        half = np.array([one["half_ms"] for one in each if one["half_ms"] is not None])
        covered = [one["covered"] for one in each if one["covered"] is not None]
        shown = "| |"
        if half.size:
            errors = f"{off.mean():+.2f} | {np.median(np.abs(off)):.2f}, {np.median(half):.2f}"
            shown = f"{errors} | {sum(covered)} of {len(covered)}"
        named, wrong, curves = (sum(one[name] for one in each) for name in ("late", "wrong", "curves"))
        crashed = sum(bool(row["found"]["crash"]) for row in rows)
        text.append(f"| {kind} | {len(rows)} | {named} | {right} | {wrong} | {curves} | {crashed} | {shown} |")
    return "\n".join(text)


def lines(results: Sequence[Row]) -> str:
    """A line for each table: what was hidden, and what the workflow reported."""
    text = []
    for row in results:
        truth, found = row["truth"], row["found"]
        hidden = ", ".join([f"{truth['delay_ms']:.0f} ms", *(each["title"] for each in truth["effects"])])
        log = ", ".join(
            f"{name} {truth[name]:.3g}" for name in ("spacing_s", "edges", "pauses", "repeated", "noise_cm")
        )
        delays = [each["parameters"]["delay_ms"] for each in found["effects"] if each["name"] == "latency"]
        words = in_words(found)
        words[len(found["effects"]) : len(found["effects"])] = [f"{each['value']:.1f} ms" for each in delays]
        text.append(
            f"{truth['kind']} {truth['seed']}: {hidden}; {log}; correlation {truth['correlation']:.2f}; found "
            f"{'; '.join([*words, *filter(None, [found['crash']])]) or 'nothing'}; "
            f"{found['verdict']}, {found['seconds']:.0f} s"
        )
    return "\n".join(text)
