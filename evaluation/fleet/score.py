"""Runs `msp-lab fleet` on a drawn fleet, and scores what it found.

A finding is a vehicle with an effect or a change. It is right if the vehicle is one of the odd ones and a name that it
was given, or an alternative, is right. What the whole fleet shares is scored on its own.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from evaluation.fleet.generator import Fleet
from evaluation.product import command
from evaluation.second_hand.workflow import characterise
from evaluation.shares import wilson


@dataclass(frozen=True)
class Outcome:
    """What was found in a fleet.

    Attributes
    ----------
    kind, seed
        Which fleet.
    hidden, found
        Odd vehicles, and how many of them were found with a right name.
    false
        Other findings of vehicles, in words.
    shared
        Names that the whole fleet was given, without calibration.
    shared_right
        Of a fleet that shares an effect, whether that was named; None of others.
    crash
        What ended the command; empty where it succeeded.
    """

    kind: str
    seed: int
    hidden: int
    found: int
    false: Sequence[str]
    shared: Sequence[str]
    shared_right: bool | None
    crash: str


def run(kind: str, seed: int, fleet: Fleet, folder: Path) -> Outcome:
    """Write the fleet as a dataset, make a model of its bench table, and run the command."""
    # Here, so that the generator can be used without the product.
    from msp_lab.readings.dataset import record_runs, write_tables
    from msp_range.recording.csv_form import MeasuredData, write_csv

    bench, model, dataset, out = (folder / name for name in ("bench.csv", "model.yaml", "readings", "fleet"))
    write_csv(bench, fleet.bench)
    for vehicle in fleet.vehicles:
        for session in dict.fromkeys(vehicle.table["run"].tolist()):
            rows = vehicle.table["run"] == session
            table = MeasuredData({name: column[rows] for name, column in vehicle.table.items()})
            name = f"{vehicle.name}/{session}"
            write_tables(dataset, name, {"down": table})
            record_runs(dataset, {name: {"file": f"{name}.csv"}})
    crash = characterise(bench, model) or command("msp-lab", "fleet", dataset, "--model", model, "--out", out)
    family = kind.partition(":")[0]
    if crash:
        return Outcome(kind, seed, len(fleet.odd), 0, (), (), False if family == "shared" else None, crash)
    return score(kind, seed, fleet, json.loads((out / "fleet.json").read_text()))


def score(kind: str, seed: int, fleet: Fleet, findings: dict[str, Any]) -> Outcome:
    """Compare ``fleet.json`` with the truth."""
    family = kind.partition(":")[0]
    found: set[str] = set()
    false, shared = [], []
    for each in findings["effects"][: findings["found"]]:
        names = {each["name"], *(name for name, _ in each["alternatives"])}
        right = bool(names & fleet.names) and (each["kind"] in ("change", "drift")) == (family == "change")
        if each["kind"] == "shared":
            shared.append(" or ".join(sorted(names)))
        for one in each["estimates"] if each["kind"] != "shared" else []:
            if one["odd"] and right and one["vehicle"] in fleet.odd:
                found.add(one["vehicle"])
            elif one["odd"]:
                false.append(f"{each['kind']} {each['name']} {one['vehicle']}")
    is_shared = any(fleet.names & set(each.split(" or ")) for each in shared) if family == "shared" else None
    return Outcome(kind, seed, len(fleet.odd), len(found), tuple(false), tuple(shared), is_shared, "")


def table(outcomes: list[Outcome]) -> str:
    """A line for each kind, and one for all, in Markdown."""
    lines = [
        "| fleets | number | odd vehicles | found | false findings | false among found | shared named | other shared |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for kind in [*dict.fromkeys(each.kind for each in outcomes), "all"]:
        some = [each for each in outcomes if kind in (each.kind, "all")]
        hidden, found = sum(each.hidden for each in some), sum(each.found for each in some)
        false = sum(len(each.false) for each in some)
        asked = [each.shared_right for each in some if each.shared_right is not None]
        other = sum(len(each.shared) - bool(each.shared_right) for each in some)
        share = _share(false, false + found)
        of = f"{found}, {_share(found, hidden)}" if hidden else ""
        right = f"{sum(asked)} of {len(asked)}" if asked else ""
        lines.append(f"| {kind} | {len(some)} | {hidden} | {of} | {false} | {share} | {right} | {other} |")
    return "\n".join(lines)


def _share(count: int, of: int) -> str:
    """In per cent, with its 95 % interval by Wilson; empty where there is none."""
    if not of:
        return ""
    low, high = wilson(count, of)
    return f"{100.0 * count / of:.1f} % ({100.0 * low:.0f} to {100.0 * high:.0f} %)"
