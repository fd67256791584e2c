"""Makes cases, runs the workflow on each, and prints a table of what it named; what is there is not made again.

For instance ``--kinds null:0.5=50 one:10=100 --seed 1000 --out build/second``.
"""

import argparse
from collections.abc import Callable, Sequence

from evaluation.runner import Row, campaign_options, publish, run_cases
from evaluation.second_hand.generator import FINAL_SEED, NULLS, case
from evaluation.second_hand.score import failures, outcome, table
from evaluation.second_hand.workflow import run_case

KINDS = (*NULLS, "one:6", "one:10", "one:20", "two:10", "three:10", "unknown:10")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    kind_options(parser, KINDS, 20)


def kind_options(parser: argparse.ArgumentParser, kinds: Sequence[str], cases: int) -> None:
    """Add those of a campaign with cases of several kinds."""
    campaign_options(parser)
    usual = " ".join(kinds)
    parser.add_argument("--kinds", nargs="+", default=list(kinds), metavar="KIND[=CASES]", help=f"default: {usual}")
    parser.add_argument("--cases", type=int, default=cases, help="cases of a kind that names no number of its own")
    parser.add_argument("--final", action="store_true", help=f"allow seeds from {FINAL_SEED} on")


def run_kinds(given: argparse.Namespace, make: Callable[..., Row], kinds: Sequence[str] = ()) -> list[Row]:
    """Make the rows that the options ask for and that are not there yet: by kind, seed, and whether it may be final.

    Raises
    ------
    argparse.ArgumentTypeError
        A kind is none of `kinds`, where those are all, or a seed is one that is kept for a final run.
    """
    named = [each.partition("=") for each in given.kinds]
    for kind, _, _ in named:
        if kinds and kind not in kinds:
            raise argparse.ArgumentTypeError(f"kind {kind!r}: expected one of {', '.join(kinds)}")
    cases = [(kind, given.seed + i) for kind, _, count in named for i in range(int(count or given.cases))]
    if max(seed for _, seed in cases) >= FINAL_SEED and not given.final:
        raise argparse.ArgumentTypeError(f"seeds from {FINAL_SEED} on are kept for a final run (--final)")
    wanted = {f"{kind} {seed}": (kind, seed, given.final) for kind, seed in cases}
    return run_cases(wanted, make, given.jobs, given.out / "cases.jsonl")


def main(given: argparse.Namespace) -> None:
    """Make what is not there yet, and print the table."""
    results = run_kinds(given, make_result)
    publish(f"{table(results)}\n\n{failures(results)}", given.out)


def make_result(kind: str, seed: int, final: bool = False) -> Row:
    """Make a case and run the workflow on it: what was hidden, what the workflow found, and the outcome."""
    made = case(kind, seed, final)
    found = run_case(made)
    return {"outcome": outcome(made.truth, found), "truth": made.truth, "found": found}
