"""``python -m evaluation.others OUT --cases N``: blind flights with the truth hidden, and the table of what was found.

Cases that are in OUT are kept, so that an interrupted campaign is resumed, and a larger N adds cases.
"""

import argparse
from pathlib import Path

from evaluation.others.campaign import Case, run_case, table


def main() -> None:
    """Fly and compare what is not there yet, and print the table."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.others", description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--cases", type=int, default=20)
    parser.add_argument("--nulls", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--standard-errors", type=float, default=10.0)
    given = parser.parse_args()
    out = given.out.resolve()  # scenarios name files next to them
    out.mkdir(parents=True, exist_ok=True)
    found: dict[bool, list[Case]] = {}
    for null, count in ((False, given.cases), (True, given.nulls)):
        found[null] = []
        for number in range(count):
            case = run_case(out, given.seed, number, given.standard_errors, null)
            found[null].append(case)
            print(f"{case.effect} {case.parameters} at {case.sensor}: {case.named}, {case.seconds:g} s", flush=True)
    text = table(found[False], found[True])
    (out / "table.md").write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
