"""Blind tables from the draw to what the tools report of them, on all cores at once.

Cases enter; a folder of bases, tables and answers leaves. The tools under test are called as a user calls them, by
their commands, in processes that have them loaded. Answers lie in a folder of their own, which no command is given.
What is there is not made again, so that an interrupted campaign can be resumed.
"""

import json
import shutil
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from evaluation.blind.flight import Columns, Regime
from evaluation.blind.mechanisms import MECHANISMS
from evaluation.blind.sound import Array
from evaluation.blind.tables import CONFOUNDED, Case, fly_base, fly_case
from evaluation.csv_form import cells_of, write_form
from evaluation.product import command
from evaluation.runner import Row, run_cases

SENSOR = Path(__file__).parent / "sensor.yaml"

Until = Literal["name", "add", "show"]


@dataclass(frozen=True)
class Campaign:
    """Where tables lie and how they are looked at."""

    out: Path
    """Folder of bases, tables and answers."""
    seed: int
    """Of bases and tools."""
    until: Until = "add"
    """Step of the workflow after which it stops; pictures are for people."""
    nulls_until: Until = "name"
    """The same where nothing is hidden: there is nothing to add if nothing is named."""

    def base(self, regime: Regime) -> Path:
        """Readings that are characterised for a regime."""
        return self.out / "bases" / f"{regime}.csv"

    def table(self, case: Case) -> Path:
        """Folder of a table."""
        return self.out / "tables" / f"{case.number:04d}"

    def answer(self, case: Case) -> Path:
        """What is hidden in it."""
        return self.out / "answers" / f"{case.number:04d}.json"

    def findings(self, case: Case) -> Path:
        """The workflow's findings of it."""
        return self.table(case) / "gap" / "gap.json"


def write(path: Path, columns: Columns, reading_cm: Array) -> None:
    """A CSV file in the one form; an empty cell is unknown."""
    write_form(path, {name: cells_of(each, 6) for name, each in {**columns, "reading_cm": reading_cm}.items()})


def draw_base(campaign: Campaign, regime: Regime) -> None:
    """Fly what a user characterises."""
    if not campaign.base(regime).exists():
        write(campaign.base(regime), *fly_base(campaign.seed, regime))


def draw(campaign: Campaign, case: Case) -> None:
    """Fly a table, and write it and its answer."""
    table, answer = campaign.table(case), campaign.answer(case)
    if (table / "measured.csv").exists():
        return
    columns, reading_cm, hidden = fly_case(case)
    for each in hidden:
        mechanism = MECHANISMS[str(each["mechanism"])]
        each |= {"channel": mechanism.channel, "variables": list(mechanism.variables)}
    pair = CONFOUNDED[case.twist][0] if case.twist else ()
    content = {"kind": case.kind, "regime": case.regime, "twist": case.twist, "pair": pair, "hidden": hidden}
    answer.parent.mkdir(parents=True, exist_ok=True)
    answer.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    table.mkdir(parents=True, exist_ok=True)
    (table / "base").write_text(case.regime, encoding="utf-8")
    write(table / "measured.csv", columns, reading_cm)


def _do_base(campaign: Campaign, regime: Regime) -> Row:
    draw_base(campaign, regime)
    base = campaign.base(regime)
    model = base.with_suffix(".yaml")
    if model.exists():
        return {"wrong": ""}
    # The lift's heights are true to a hair: what its runs differ by is the sensor's and the vehicle's.
    given = ("--sensor", SENSOR, "--set-up-std-cm", 0.02, "--seed", campaign.seed)
    return {"wrong": command("msp-lab", "characterise", base, *given, "--out", model)}


def _do_table(campaign: Campaign, case: Case) -> Row:
    draw(campaign, case)
    table, to = campaign.table(case), campaign.findings(case).parent
    model = campaign.base(case.regime).with_suffix(".yaml")
    until = campaign.until if case.hidden else campaign.nulls_until
    # Made next to its place, so that what is in it is finished.
    begun = table / "gap.part"
    shutil.rmtree(begun, ignore_errors=True)
    wrong = command(
        "msp-lab", "gap", table / "measured.csv", "--model", model, "--out", begun, "--seed", campaign.seed,
        "--until", until,
    )  # fmt: skip
    if not wrong:
        begun.rename(to)
    return {"wrong": f"table {case.number}: {wrong}" if wrong else ""}


def run(campaign: Campaign, cases: Sequence[Case], jobs: int) -> None:
    """Draw what is not there, and look for the gap in it, table by table.

    Ctrl-C finishes what is begun and leaves the rest.
    """
    left = {str(case.number): (campaign, case) for case in cases if not campaign.findings(case).exists()}
    regimes = {str(case.regime): (campaign, case.regime) for _, case in left.values()}
    wrong = [*run_cases(regimes, _do_base, jobs), *run_cases(left, _do_table, jobs)]
    print("".join(f"{row['wrong']}\n" for row in wrong if row["wrong"]), end="", file=sys.stderr)
