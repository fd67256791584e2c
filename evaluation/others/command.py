"""Blind flights with the truth hidden, and the table of what was found.

Cases that are in OUT are kept, so that an interrupted campaign is resumed, and a larger N adds cases.
"""

import argparse
from pathlib import Path

from evaluation.others.campaign import Case, run_case, table


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--out", type=Path, required=True, help="folder for one JSON file a case, and table.md")
    parser.add_argument("--cases", type=int, default=20, help="cases with an effect (default: %(default)s)")
    parser.add_argument("--nulls", type=int, default=5, help="cases without one (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: %(default)s)")
    parser.add_argument("--standard-errors", type=float, default=10.0, help="size of an effect (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Fly and compare what is not there yet, and print the table."""
    out = given.out.resolve()  # scenarios name files next to them
    out.mkdir(parents=True, exist_ok=True)
    found: dict[bool, list[Case]] = {}
    for null, count in ((False, given.cases), (True, given.nulls)):
        found[null] = []
        for number in range(count):
            case = run_case(out, given.seed, number, given.standard_errors, null)
            found[null].append(case)
            print(f"{case.effect} {case.parameters} at {case.sensor}: {case.named}, {case.seconds:g} s", flush=True)
    text = table(found[False], found[True])
    (out / "table.md").write_text(text, encoding="utf-8")
    print(text)
