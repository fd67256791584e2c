"""Makes cases, runs the workflow on each, and prints a table of what it named; what is there is not made again."""

import argparse
import json
import multiprocessing
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

from rich.progress import Progress

from evaluation.second_hand.generator import FINAL_SEED, NULLS
from evaluation.second_hand.results import make_result, result_file
from evaluation.second_hand.score import failures, table

KINDS = (*NULLS, "one:6", "one:10", "one:20", "two:10", "three:10", "unknown:10")


def options(parser: argparse.ArgumentParser) -> None:
    """Add the given."""
    parser.add_argument(
        "--kinds", nargs="+", default=list(KINDS), metavar="KIND[=CASES]", help="default: " + " ".join(KINDS)
    )
    parser.add_argument("--cases", type=int, default=20, help="cases of a kind that names no number of its own")
    parser.add_argument("--seed", type=int, default=1, help="seed of the first case; the others follow")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, required=True, help="folder for one JSON file a case, and table.md")
    parser.add_argument("--final", action="store_true", help=f"allow seeds from {FINAL_SEED} on")


def main(given: argparse.Namespace) -> None:
    """Make what is not there yet, and print the table."""
    if given.seed + given.cases > FINAL_SEED and not given.final:
        raise argparse.ArgumentTypeError(f"seeds from {FINAL_SEED} on are kept for a final run (--final)")
    given.out.mkdir(parents=True, exist_ok=True)
    wanted = list(_wanted(given.kinds, given.cases, given.seed))
    todo = [each for each in wanted if not result_file(given.out, *each).exists()]
    with Progress() as progress:
        bar = progress.add_task("cases", total=len(wanted), completed=len(wanted) - len(todo))
        # One core each: the workers inherit it, and read it when numpy starts.
        os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
        pool = ProcessPoolExecutor(given.jobs, multiprocessing.get_context("spawn"))
        with pool:
            running = [pool.submit(make_result, given.out, *each, given.final) for each in todo]
            try:
                for done in as_completed(running):
                    done.result()
                    progress.advance(bar)
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    results = [json.loads(result_file(given.out, *each).read_text()) for each in wanted]
    text = f"{table(results)}\n\n{failures(results)}\n"
    (given.out / "table.md").write_text(text)
    print(text)


def _wanted(kinds: list[str], cases: int, seed: int) -> Iterator[tuple[str, int]]:
    for each in kinds:
        kind, _, count = each.partition("=")
        for number in range(int(count or cases)):
            yield kind, seed + number
