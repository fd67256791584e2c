"""Separate gaps: the gap workflow for each of many logs or sensors on its own, on one processor or several.

It makes a folder for each log or sensor, as 'msp-lab gap' does, and a table with a row for each. Logs that cannot be
used are named, and the others are compared. Files are read and written where the comparison is computed, so that the
memory does not grow with their number: the workers of a cluster need them under the same path.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from msp_lab.gap.conclusion import found_parts
from msp_lab.gap.findings import GapFindings, LastStep, Settings
from msp_lab.gap.labels import finding_label
from msp_lab.gap.steps import Steps
from msp_lab.logs.cli import with_logs_imported
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import sensors_in
from msp_lab.readings.runs import file_names
from msp_range.clock import SystemClock
from msp_sim.effects.own import add_own_effects_once
from msp_sim.model.model import load_model

Each = Literal["log", "sensor"]
TABLE = "gaps.csv"


@dataclass(frozen=True)
class Job:
    """One separate gap: its name, its files, the sensors of it that are used (none: all), and its folder."""

    name: str
    paths: tuple[Path, ...]
    sensors: tuple[str, ...]
    folder: Path


@dataclass(frozen=True)
class Common:
    """What all separate gaps have in common: settings, source of the truth, last step, and files with effects."""

    settings: Settings
    truth: str
    until: LastStep
    effects: tuple[Path, ...] = ()


@dataclass(frozen=True)
class SeparateGap:
    """A row of the table."""

    name: str
    """Name of the log or sensor."""
    readings: int = 0
    verdict: str = ""
    """How many were compared, and the verdict; 0 and empty where they could not be."""
    named: str = ""
    """Effects that were named, separated by commas."""
    before_nats: float | None = None
    after_nats: float | None = None
    noise_floor_nats: float | None = None
    """Gap per reading with the given model, with what was added, and what random variation gives."""
    sentence: str = ""
    """The finding in a sentence."""
    error: str = ""
    """Why it could not be compared; empty: it was."""


def jobs_of(paths: Sequence[Path], each: Each, settings: Settings, out: Path) -> dict[str, Job]:
    """The separate gaps by name: one per path, or one per sensor of all of them."""
    absolute = tuple(path.resolve() for path in paths)
    out = out.resolve()
    if each == "log":
        named = zip(file_names(absolute), absolute, strict=True)
        return {name: Job(name, (path,), settings.of, out / name) for name, path in named}
    model = load_model(settings.model)
    found = sensors_in(absolute, model.sensor, load_maps(settings.map), run_column=settings.run_column)
    return {
        name: Job(name, absolute, (name,), out / quote(name, safe=""))
        for name in found
        if name in (settings.of or found)
    }


def separate_gap(common: Common, job: Job) -> SeparateGap:
    """Compare one log or sensor with the model, and write its folder."""
    add_own_effects_once(common.effects)
    settings = replace(common.settings, of=job.sensors)
    measured, _ = with_logs_imported(
        list(job.paths), common.truth, list(settings.map), job.folder / "readings", is_shown=False
    )
    steps = Steps(job.folder, SystemClock(), lambda what, share: None)
    return _row(job.name, steps.all(measured, settings, common.until))


def _row(name: str, findings: GapFindings) -> SeparateGap:
    return SeparateGap(
        name,
        findings.rows,
        findings.verdict or "",
        ", ".join(map(finding_label, found_parts(findings))),
        findings.nats.before,
        findings.nats.after,
        findings.nats.noise_floor,
        findings.sentence,
    )
