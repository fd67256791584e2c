"""Blind flights with the truth hidden, and the table of what was found.

Cases that are in OUT are kept, so that an interrupted campaign is resumed, and a larger number adds cases.
For instance ``--cases 30 --nulls 8 --seed 4 --out build/others``.
"""

import argparse

from evaluation.others.campaign import Case, run_case, table
from evaluation.runner import Row, as_objects, campaign_options, publish, run_cases


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    campaign_options(parser)
    parser.add_argument("--cases", type=int, default=20, help="cases with an effect (default: %(default)s)")
    parser.add_argument("--nulls", type=int, default=5, help="cases without one (default: %(default)s)")
    parser.add_argument("--standard-errors", type=float, default=10.0, help="size of an effect (default: %(default)s)")


def main(given: argparse.Namespace) -> None:
    """Fly and compare what is not there yet, and print the table."""
    out = given.out.resolve()  # scenarios name files next to them
    wanted = {f"{given.seed}:{number}:{given.standard_errors:g}": number for number in range(given.cases)}
    cases = {name: (out, given.seed, number, given.standard_errors, False) for name, number in wanted.items()}
    nulls = {f"{given.seed}:{number}:null": (out, given.seed, number, 0.0, True) for number in range(given.nulls)}
    found = run_cases(cases | nulls, run_case, given.jobs, out / "cases.jsonl", line=_line)
    publish(table(as_objects(Case, found[: len(cases)]), as_objects(Case, found[len(cases) :])), out)


def _line(row: Row) -> str:
    return f"{row['effect']} {row['parameters']} at {row['sensor']}: {row['named']}, {row['seconds']:g} s"
