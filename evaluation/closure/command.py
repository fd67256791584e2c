"""Gap closed in cases of the blind tables, such as build/blind-1-200/tables/0003."""

import argparse
from pathlib import Path

from evaluation.closure.closure import case_closed, describe
from evaluation.runner import Row, run_cases


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("cases", nargs="+", type=Path, help="folders with measured.csv, base and gap/")
    parser.add_argument("--model", type=Path, help="given model; left out: the case's base, ../../bases/REGIME.yaml")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Print a line for each case."""
    cases = {str(case): (case, given.model) for case in given.cases}
    run_cases(cases, closed_in, given.jobs, line=lambda row: f"{row['again']}: {row['closed']}")


def closed_in(case: Path, model: Path | None) -> Row:
    """How much of the gap is closed in a case."""
    if not (case / "gap" / "model.yaml").exists():
        return {"closed": "no gap/model.yaml; run the workflow to its step add"}
    base = model or case.parents[1] / "bases" / f"{(case / 'base').read_text(encoding='utf-8')}.yaml"
    return {"closed": describe(case_closed(case, base))}
