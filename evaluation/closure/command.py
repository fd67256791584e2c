"""Gap closed in cases of the blind tables, such as build/blind-1-200/tables/0003."""

import argparse
from pathlib import Path

from evaluation.closure.closure import case_closed, describe


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("cases", nargs="+", type=Path, help="folders with measured.csv, base and gap/")
    parser.add_argument("--model", type=Path, help="given model; left out: the case's base, ../../bases/REGIME.yaml")


def main(given: argparse.Namespace) -> None:
    """Print a line for each case."""
    for case in given.cases:
        if not (case / "gap" / "model.yaml").exists():
            print(f"{case}: no gap/model.yaml; run the workflow to its step add")
            continue
        base = given.model or case.parents[1] / "bases" / f"{(case / 'base').read_text(encoding='utf-8')}.yaml"
        print(f"{case}: {describe(case_closed(case, base))}")
