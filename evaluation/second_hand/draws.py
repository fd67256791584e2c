"""Runs the workflow on each case with several draws of the splits, and prints how often it names the same.

For instance ``--kinds null:0.5=20 one:10=20 --seed 1 --draws 5 --out build/draws``.
"""

import argparse
from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from evaluation.runner import Row, campaign_options, publish, run_cases
from evaluation.second_hand.generator import FINAL_SEED, case
from evaluation.second_hand.score import matched, names_of
from evaluation.second_hand.workflow import run_case

KINDS = ("null:0.5=20", "null:0.8=20", "one:6=20", "one:10=20", "one:20=20")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    campaign_options(parser)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), metavar="KIND=CASES", help="default: %(default)s")
    parser.add_argument("--draws", type=int, default=5, help="random seeds of the splits, from 1 on")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    wanted = {
        f"{kind} {seed} {draw}": (kind, seed, draw)
        for kind, count in (each.split("=") for each in given.kinds)
        for seed in range(given.seed, given.seed + int(count))
        for draw in range(1, given.draws + 1)
    }
    if max(seed for _, seed, _ in wanted.values()) >= FINAL_SEED:
        raise argparse.ArgumentTypeError(f"seeds from {FINAL_SEED} on are kept for a final run")
    publish(table(run_cases(wanted, _find, given.jobs, given.out / "cases.jsonl")), given.out)


def table(rows: Sequence[Row]) -> str:
    """For each kind the share of cases with the same names and curves in all draws, and of draws as the first one."""
    found: dict[str, dict[int, list[dict[str, Any]]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        found[row["kind"]][row["seed"]].append(row)
    lines = ["| kind | cases | the same in all draws | draws that say what most say |", "|---|---|---|---|"]
    others = []
    for kind, cases in found.items():
        alike = {
            seed: [max(sum(same(a, b) for b in drawn) for a in drawn), len(drawn)] for seed, drawn in cases.items()
        }
        whole = sum(most == count for most, count in alike.values())
        share = sum(most for most, _ in alike.values()) / sum(count for _, count in alike.values())
        lines.append(f"| {kind} | {len(cases)} | {whole / len(cases):.2f} | {share:.2f} |")
        others += [
            f"{kind} {seed}: " + "; ".join(_said(each) for each in cases[seed])
            for seed, (most, count) in alike.items()
            if most < count
        ]
    return "\n".join([*lines, "", *others])


def same(one: dict[str, Any], other: dict[str, Any]) -> bool:
    """Whether two draws name as many effects, each with a name that the other has too, and the same curves."""
    first, second = names_of(one), names_of(other)
    curves = [sorted((each["channel"], *each["variables"]) for each in found["curves"]) for found in (one, other)]
    return len(first) == len(second) == matched(first, second) and curves[0] == curves[1]


def _find(kind: str, seed: int, draw: int) -> Row:
    return {"kind": kind, "seed": seed} | run_case(case(kind, seed), draw)


def _said(found: dict[str, Any]) -> str:
    curves = [f"curve of {each['channel']} over {' and '.join(each['variables'])}" for each in found["curves"]]
    return ", ".join([*(each["name"] for each in found["effects"]), *curves]) or "nothing"
