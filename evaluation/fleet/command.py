"""Draws fleets, runs `msp-lab fleet` on each, and prints a table; what is there is not made again."""

import argparse
import json
import tempfile
from pathlib import Path

from evaluation.fleet.generator import KINDS, fleet
from evaluation.fleet.score import Outcome, as_json, run, table

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
    parser.add_argument("--fleets", type=int, default=len(USUAL), help="number of fleets")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first of each kind; the others follow")
    parser.add_argument("--kinds", nargs="+", help=f"default: some of each; effects: {', '.join(KINDS)}")
    parser.add_argument("--out", type=Path, required=True, help="folder for one JSON file a fleet")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, and print the table."""
    given.out.mkdir(parents=True, exist_ok=True)
    kinds = given.kinds or USUAL
    outcomes = []
    for number in range(given.fleets):
        kind, seed = kinds[number % len(kinds)], given.seed + number // len(kinds)
        file = given.out / f"{kind.replace(':', '-')}-{seed}.json"
        if not file.exists():
            with tempfile.TemporaryDirectory() as folder:
                file.write_text(as_json(run(kind, seed, fleet(kind, seed), Path(folder))))
        data = json.loads(file.read_text())
        outcomes.append(Outcome(**{**data, "false": tuple(data["false"]), "shared": tuple(data["shared"])}))
        last = outcomes[-1]
        print(f"{kind} {seed}: {last.found} of {last.hidden}, false {list(last.false)}, shared {list(last.shared)}",
              last.crash, flush=True)  # fmt: skip
    print(table(outcomes))
