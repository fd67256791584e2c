"""Draw, run and score blind tables: ``python -m tests.blind --help``, or ``make blind N=200 SEED=1``.

The tools under test are called as a user calls them, by their commands. Answers are written to a folder of their own,
which no command is given.
"""

import argparse
import csv
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from tests.blind.flight import REGIMES, Columns
from tests.blind.mechanisms import MECHANISMS
from tests.blind.score import score
from tests.blind.sound import Array
from tests.blind.tables import SHARES, Case, draw_cases, fly_base, fly_case

SENSOR = Path(__file__).parent / "sensor.yaml"


def write(path: Path, columns: Columns, reading_cm: Array) -> None:
    """A CSV file in the one form; an empty cell is unknown."""
    path.parent.mkdir(parents=True, exist_ok=True)
    names = [*columns, "reading_cm"]
    cells = [
        [("" if v != v else f"{v:.6g}") for v in column.tolist()] if column.dtype.kind == "f" else column.tolist()
        for column in (*(np.asarray(each) for each in columns.values()), reading_cm)
    ]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(names)
        writer.writerows(zip(*cells, strict=True))


def draw(out: Path, cases: list[Case], seed: int) -> None:
    """Write bases, tables and answers."""
    for regime in sorted({case.regime for case in cases}):
        write(out / "bases" / f"{regime}.csv", *fly_base(seed, regime))
    for case in cases:
        columns, reading_cm, hidden = fly_case(case)
        write(out / "tables" / f"{case.number:04d}" / "measured.csv", columns, reading_cm)
        for each in hidden:
            mechanism = MECHANISMS[str(each["mechanism"])]
            each |= {"channel": mechanism.channel, "variables": list(mechanism.variables)}
        answer = {"kind": case.kind, "regime": case.regime, "twist": case.twist, "hidden": hidden}
        path = out / "answers" / f"{case.number:04d}.json"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
        (out / "tables" / f"{case.number:04d}" / "base").write_text(case.regime, encoding="utf-8")


def run(out: Path, seed: int, at_once: int) -> None:
    """Characterise each base and look for the gap in each table, by the commands that a user has."""
    folder = Path(sys.executable).parent
    for base in sorted((out / "bases").glob("*.csv")):
        model = base.with_suffix(".yaml")
        if not model.exists():
            # The lift's heights are true to a hair: what its runs differ by is the sensor's and the vehicle's.
            given = ("--sensor", SENSOR, "--set-up-std-cm", "0.02", "--seed", str(seed))
            _call(folder / "msp-range", "characterise", base, *given, "--out", model)

    def gap(table: Path) -> None:
        model = out / "bases" / f"{(table / 'base').read_text(encoding='utf-8')}.yaml"
        if not (table / "gap" / "gap.json").exists():
            measured, to = table / "measured.csv", table / "gap"
            _call(folder / "msp-sim", "gap", measured, "--model", model, "--out", to, "--seed", str(seed))

    with ThreadPoolExecutor(at_once) as pool:
        list(pool.map(gap, sorted((out / "tables").iterdir())))


def _call(*command: str | Path) -> None:
    done = subprocess.run([str(each) for each in command], capture_output=True, text=True, check=False)
    if done.returncode != 0:
        print(f"{' '.join(str(each) for each in command[1:])}: {done.stderr.strip()[-500:]}", file=sys.stderr)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.blind", description=__doc__)
    parser.add_argument("out", type=Path, help="folder for bases, tables, answers and results")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kind", choices=list(SHARES))
    parser.add_argument("--regime", choices=REGIMES)
    parser.add_argument("--standard-errors", type=float)
    parser.add_argument("--at-once", type=int, default=2)
    parser.add_argument("--step", choices=("all", "draw", "run", "score"), default="all")
    given = parser.parse_args()
    if given.step in ("all", "draw"):
        cases = draw_cases(given.seed, given.count, given.kind, given.regime, given.standard_errors)
        draw(given.out, cases, given.seed)
    if given.step in ("all", "run"):
        run(given.out, given.seed, given.at_once)
    if given.step in ("all", "score"):
        print(score(given.out / "answers", given.out / "tables"))


if __name__ == "__main__":
    main()
