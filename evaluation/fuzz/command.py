"""Mutated input through the readers of the project, ten minutes an area.

Ends with exit code 1 where anything failed. ``--only yaml build/fuzz/yaml-1-77`` checks saved inputs again, in this
process, where a traceback and a debugger can be had.
"""

import argparse
import tempfile
from pathlib import Path
from typing import Any

from evaluation.fuzz import base, csv_files, link, log_files, mcap_files, yaml_files

AREAS: dict[str, Any] = {"link": link, "yaml": yaml_files, "csv": csv_files, "mcap": mcap_files, "logs": log_files}
"""Name on the command line -> module with ``fuzz(seconds, seed)`` and ``prepare(folder)``."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--seconds", type=float, default=600.0, help="time of each area [s] (default: 600)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: 1)")
    parser.add_argument("--only", choices=AREAS, help="this area alone")
    parser.add_argument("saved", nargs="*", type=Path, help="saved inputs to check again; needs --only")


def main(given: argparse.Namespace) -> int:
    """Run the areas that the command line names; returns the exit code."""
    if given.saved:
        if given.only is None:
            raise argparse.ArgumentTypeError(f"saved inputs need --only {', '.join(AREAS)}")
        with tempfile.TemporaryDirectory() as folder:
            check = AREAS[given.only].prepare(Path(folder))
            for path in given.saved:
                check(path.read_bytes())
                print(f"{path}: passes")
        return 0
    results = []
    for name in [given.only] if given.only else AREAS:
        results.append(AREAS[name].fuzz(given.seconds, given.seed))
        base.show(results[-1])
    return 1 if any(result.failures for result in results) else 0
