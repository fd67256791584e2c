"""Runs methods on the frozen tables of `evaluation/benchmark`, and scores their findings.

What is there is not made again: delete the folder after a change of a method. Methods whose package is not installed
(the extra ``bench``) are left out.
"""

import argparse
import json
from importlib.util import find_spec
from pathlib import Path

from evaluation.benchmark.methods import HERE, METHODS, NEEDS, find
from evaluation.benchmark.score import scored, show
from evaluation.document import replace_section
from evaluation.runner import publish, run_cases

README = HERE / "README.md"


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--out", type=Path, default=Path("build/benchmark"), help="folder (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--methods", nargs="+", choices=list(METHODS), metavar="METHOD", help="default: all")
    parser.add_argument("--also", nargs="+", type=Path, default=[], metavar="FINDINGS.json", help="score these too")
    parser.add_argument("--write", action="store_true", help="write the table into README.md too")


def main(given: argparse.Namespace) -> None:
    """Run what is not there yet, write a findings file for each method, and print the scores."""
    methods = [each for each in given.methods or METHODS if each not in NEEDS or find_spec(NEEDS[each])]
    names = sorted(path.name.partition(".")[0] for path in (HERE / "tables").iterdir())
    # Seconds are compared, so that each method has its tables together.
    cases = {f"{method}: {name}": (method, name) for method in methods for name in names}
    rows = run_cases(cases, find, given.jobs, given.out / "findings.jsonl")
    paths = []
    for k, method in enumerate(methods):
        found = rows[k * len(names) : (k + 1) * len(names)]
        kept = [{key: each for key, each in row.items() if key != "again"} for row in found]
        content = {"method": method, "tables": dict(zip(names, kept, strict=True))}
        paths.append(given.out / f"{method.replace(' ', '-').replace(',', '')}.json")
        paths[-1].write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    scores = scored([*paths, *given.also])
    table = show(scores)
    publish(table, given.out)
    mistakes = [f"{method}: {name}: {text}" for method, each in scores.items() for name, text in each.mistakes.items()]
    (given.out / "mistakes.txt").write_text("\n".join(mistakes) + "\n", encoding="utf-8")
    if given.write:
        replace_section(README, "results", table)
