"""Draws fleets, runs `msp-lab fleet` on each, and prints a table; what is there is not made again.

For instance ``--fleets 20 --seed 1 --out build/fleet``.
"""

import argparse
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory

from evaluation.fleet.generator import KINDS, fleet
from evaluation.fleet.score import Outcome, run, table
from evaluation.runner import Row, as_objects, campaign_options, publish, run_cases

USUAL = (
    "null",
    "odd:latency",
    "odd:slant_axis",
    "odd:multipath",
    "odd:offset",
    "odd:propeller_short",
    "change:offset",
    "odd:cycle_slip",
    "odd:sensitivity_loss",
    "shared:latency",
    "odd:propeller_spread",
    "odd:crosstalk",
    "odd:ring_down",
    "odd:scale",
    "odd:vibration",
    "shared:multipath",
)
"""Kinds in the order in which fleets are drawn, again and again."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    campaign_options(parser)
    parser.add_argument("--fleets", type=int, default=len(USUAL), help="number of fleets (default: %(default)s)")
    parser.add_argument("--kinds", nargs="+", help=f"default: some of each; effects: {', '.join(KINDS)}")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    kinds = given.kinds or USUAL
    fleets = [(kinds[number % len(kinds)], given.seed + number // len(kinds)) for number in range(given.fleets)]
    cases = {f"{kind} {seed}": (kind, seed) for kind, seed in fleets}
    rows = run_cases(cases, find, given.jobs, given.out / "cases.jsonl", line=_line)
    publish(table(as_objects(Outcome, rows)), given.out)


def find(kind: str, seed: int) -> Row:
    """Draw a fleet, and score what is found in it."""
    with TemporaryDirectory() as folder:
        return asdict(run(kind, seed, fleet(kind, seed), Path(folder)))


def _line(row: Row) -> str:
    found = f"{row['found']} of {row['hidden']}, false {row['false']}, shared {row['shared']}"
    return f"{row['again']}: {found} {row['crash']}".rstrip()
