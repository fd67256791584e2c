"""``python -m evaluation.fuzz``: mutated input through the readers of the project, ten minutes an area.

Ends with exit code 1 where anything failed. ``--only yaml build/fuzz/yaml-1-77`` checks saved inputs again, in this
process, where a traceback and a debugger can be had.
"""

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from evaluation.fuzz import base, csv_files, link, log_files, mcap_files, yaml_files

FILES: dict[str, Any] = {"yaml": yaml_files, "csv": csv_files, "mcap": mcap_files, "logs": log_files}
"""Areas that read files: name on the command line -> module with ``fuzz(seconds, seed)`` and ``prepare(folder)``."""
AREAS: dict[str, Any] = {"link": link, **FILES}
"""Name on the command line -> module with ``fuzz(seconds, seed)``."""


def main() -> int:
    """Run the areas that the command line names; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.fuzz", description=__doc__)
    parser.add_argument("--seconds", type=float, default=600.0, help="time of each area [s] (default: 600)")
    parser.add_argument("--seed", type=int, default=1, help="random seed (default: 1)")
    parser.add_argument("--only", choices=AREAS, help="this area alone")
    parser.add_argument("saved", nargs="*", type=Path, help="saved inputs to check again; needs --only")
    chosen = parser.parse_args()
    if chosen.saved:
        if chosen.only not in FILES:
            parser.error(f"saved inputs need --only {', '.join(FILES)}")
        with tempfile.TemporaryDirectory() as folder:
            check = AREAS[chosen.only].prepare(Path(folder))
            for path in chosen.saved:
                check(path.read_bytes())
                print(f"{path}: passes")
        return 0
    results = []
    for name in [chosen.only] if chosen.only else AREAS:
        results.append(AREAS[name].fuzz(chosen.seconds, chosen.seed))
        base.show(results[-1])
    return 1 if any(result.failures for result in results) else 0


if __name__ == "__main__":
    sys.exit(main())
