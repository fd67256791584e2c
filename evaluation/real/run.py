"""Measured sets end to end by the commands, and what was reported of them against the table of names.

For instance ``robot_mb1433 --closure``.
"""

import argparse
import json
import shlex
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evaluation import CONFIGS
from evaluation.closure.closure import Closure, describe, gap_closed
from evaluation.real.analysis import data_folder
from evaluation.real.commands import run_command
from evaluation.real.names import Line, expected_names
from evaluation.real.sets import SETS, MeasuredSet
from evaluation.runner import Row, run_cases

KEPT = ("named", "indistinguishable")
"""Verdicts on an effect with which its name stands in the report."""


@dataclass(frozen=True)
class Found:
    """One thing that the workflow found."""

    names: frozenset[str]
    """Names that it cannot separate, the first choice among them."""
    values: Mapping[str, float] = field(default_factory=dict)
    """Parameters of the first choice."""


@dataclass(frozen=True)
class Outcome:
    """What happened to a set."""

    command: str
    """The last command that ran, as it would be typed."""
    failure: str
    """Its last line on standard error where it failed; empty where all went well."""
    verdict: str = ""
    """Of the workflow."""
    found: tuple[Found, ...] = ()
    """All that was found, in the words of `names.csv`."""
    forbidden: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    """Found although forbidden; required and not found."""
    gap: tuple[float, float] | None = None
    """Nats per reading before and after, as the workflow measures it."""
    closed: Closure | None = None
    """The same by the measures of `evaluation.closure`; None where they were not asked."""


def run_set(
    measured: MeasuredSet, data: Path, out: Path, closure: bool = False, longest_s: float | None = None
) -> Outcome:
    """Characterise where the set has a bench session, then `msp-lab gap`.

    Parameters
    ----------
    measured
        The set.
    data
        Folder of measured data.
    out
        Folder to work in; `gap` and `model.yaml` are left there.
    closure
        Also measure how much of the gap is closed (half a minute more).
    longest_s
        A command that takes longer is stopped and has failed [s]; None: none is stopped.
    """
    out.mkdir(parents=True, exist_ok=True)
    model = CONFIGS / "sensors" / f"{measured.sensor}.yaml"
    column_map = () if measured.column_map is None else ("--map", measured.column_map)
    if measured.bench:
        bench = [data / each for each in measured.bench]
        characterised = out / "model.yaml"
        characterised.unlink(missing_ok=True)  # of a run before this one: the command overwrites none
        command = (
            "characterise",
            *bench,
            "--sensor",
            model,
            *column_map,
            "--date",
            "2026-11-22",
            "--out",
            characterised,
        )
        failed = _run(command, longest_s)
        if failed:
            return Outcome(_typed(command), failed)
        model = characterised
    raw = [data / each for each in measured.readings]
    readings = measured.prepare(data, out / "form") if measured.column_map is None else raw
    command = ("gap", *readings, "--model", model, *column_map, "--out", out / "gap", "--until", "add")
    failed = _run(command, longest_s)
    if failed:
        return Outcome(_typed(command), failed)
    gap = json.loads((out / "gap" / "gap.json").read_text(encoding="utf-8"))
    found = found_in(gap)
    forbidden, missing = compare_names(found, expected_names()[measured.name])
    measure = (gap.get("gap") or {}).get("nats_per_reading")
    nats = None if measure is None else (measure["before"], measure["after"])
    closed = None
    if closure:
        form = measured.prepare(data, out / "form")
        closed = gap_closed(form, model, out / "gap" / "model.yaml", gap["held_out_runs"])
    return Outcome(_typed(command), "", gap["verdict"], found, forbidden, missing, nats, closed)


def _run(arguments: tuple[object, ...], longest_s: float | None) -> str:
    print(_typed(arguments), file=sys.stderr, flush=True)
    try:
        done = run_command("msp-lab", *arguments, longest_s=longest_s)
    except subprocess.TimeoutExpired as error:
        return f"stopped after {error.timeout:g} s (--longest)"
    return "" if done.returncode == 0 else (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]


def _typed(arguments: Iterable[object]) -> str:
    return "msp-lab " + shlex.join(map(str, arguments))


def found_in(gap: Mapping[str, Any]) -> tuple[Found, ...]:
    """What a `gap.json` names, in the words of `names.csv`."""
    found = []
    for effect in gap.get("effects", ()):
        if effect["verdict"] in KEPT:
            names = frozenset({effect["name"], *(each["name"] for each in effect.get("alternatives", ()))})
            values = {name: each["value"] for name, each in effect.get("parameters", {}).items()}
            found.append(Found(names, values))
    for unknown in gap.get("unknown", ()):
        # The time in the run is the time, where runs are as they were recorded.
        variables = ["time_s" if name == "time_in_run_s" else name for name in unknown["variables"]]
        found.append(Found(frozenset(f"unknown {unknown['channel']} of {name}" for name in variables)))
    for calibration in gap.get("calibration", ()):
        # reading_model.missed_growth_per_m is named by its last part.
        found.append(Found(frozenset({f"calibration {calibration['name'].rpartition('.')[2]}"})))
    return tuple(found)


def compare_names(found: Iterable[Found], lines: Iterable[Line]) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Forbidden things that were found, and required ones that were not.

    Several indistinguishable names are right if one of them is required or allowed. What is unknown and what is
    calibration is never forbidden. A required name with values that are not there is not found.
    """
    found = list(found)
    right = {what for line in lines if line.status != "forbidden" for what in line.what}
    free = ("unknown ", "calibration ")
    forbidden = [one.names for one in found if not one.names & right and not all(x.startswith(free) for x in one.names)]
    missing = [
        " or ".join(line.what)
        for line in lines
        if line.status == "required" and not any(one.names & set(line.what) and line.holds(one.values) for one in found)
    ]
    return tuple("/".join(sorted(one)) for one in forbidden), tuple(missing)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("names", nargs="*", metavar="NAME", help="sets; left out: all")
    parser.add_argument("--out", type=Path, default=Path("build/real"), help="folder (default: %(default)s)")
    parser.add_argument("--jobs", type=int, default=1, help="processes (default: %(default)s)")
    parser.add_argument(
        "--longest", type=float, metavar="S", help="stop a command that takes longer [s] (default: none)"
    )
    parser.add_argument("--closure", action="store_true", help="measure independently how much of the gap is closed")


def main(given: argparse.Namespace) -> None:
    """Run sets, and print what was found."""
    names = [each.name for each in SETS if not given.names or each.name in given.names]
    sets = {name: (name, given.out / name, given.closure, given.longest) for name in names}
    run_cases(sets, run_named, given.jobs, given.out / "sets.jsonl", resume=False, line=lambda row: str(row["text"]))


def run_named(name: str, out: Path, closure: bool, longest_s: float | None) -> Row:
    """Run a set, and describe what was found."""
    (measured,) = [each for each in SETS if each.name == name]
    outcome = run_set(measured, data_folder(), out, closure, longest_s)
    lines = [f"{name}: {outcome.failure or outcome.verdict}"]
    if outcome.failure:
        return {"text": f"{lines[0]}\n  {outcome.command}"}
    if outcome.gap is not None:
        lines.append(f"  gap {outcome.gap[0]:.3g} to {outcome.gap[1]:.3g} nats per reading")
    if outcome.closed is not None:
        lines.append(f"  {describe(outcome.closed)}")
    for one in outcome.found:
        values = ", ".join(f"{parameter} {value:.3g}" for parameter, value in one.values.items())
        lines.append(f"  found {'/'.join(sorted(one.names))} {values}".rstrip())
    lines += [f"  {what}: {'; '.join(getattr(outcome, what)) or 'none'}" for what in ("forbidden", "missing")]
    return {"text": "\n".join(lines)}
