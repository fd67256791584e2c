"""Separate gaps: the gap workflow for each of many logs or sensors on its own, on one processor or several.

It makes a folder for each log or sensor, as 'msp-lab gap' does, and a table with a row for each. Logs that cannot be
used are named, and the others are compared. Files are read and written where the comparison is computed, so that the
memory does not grow with their number: the workers of a cluster need them under the same path.

With the other sensors of the vehicle as the reference, a sensor at which something was named is no reference any more,
and the others are compared again without it: its effect would show in them with the other sign.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from urllib.parse import quote

from msp_lab.gap.conclusion import found_parts
from msp_lab.gap.findings import GapFindings, LastStep, Settings
from msp_lab.gap.labels import finding_label
from msp_lab.gap.steps import Steps
from msp_lab.logs.cli import with_logs_imported
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.intake import PREVIOUS, load_readings, sensors_in
from msp_lab.readings.others import MIN_OTHERS
from msp_lab.readings.runs import file_names
from msp_range.clock import SystemClock
from msp_range.recording.csv_form import write_csv
from msp_sim.effects.own import add_own_effects_once
from msp_sim.model.model import load_model
from msp_sim.terminal import make_folder

Each = Literal["log", "sensor"]
TABLE = "gaps.csv"
READINGS = "readings-{}.csv"
"""Readings with the other sensors as reference, of each round."""
SUMMARY = "sensors.json"


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


@dataclass(frozen=True)
class SensorGap:
    """What was found at one sensor."""

    sensor: str
    """Name of the sensor."""
    findings: GapFindings
    """Findings of its own comparison."""
    without: tuple[str, ...]
    """Sensors that were no reference for it, since something was named at them before."""
    doubted: str | None = None
    """The sensor that differs most from the rest. It was part of this one's reference, or without it something else is
    named: what is named here may be that one's."""

    @property
    def named(self) -> tuple[str, ...]:
        """Effects of the catalogue that were named, and unknown ones by their channel and variables."""
        effects = [effect.name for effect in self.findings.confirmed]
        unknown = [f"unknown {curve.channel} of {' and '.join(curve.variables)}" for curve in self.findings.unknown]
        return (*effects, *unknown)

    @property
    def words(self) -> frozenset[str]:
        """What was named, and what the readings cannot tell from it."""
        return frozenset(
            {*self.named, *(other.name for effect in self.findings.confirmed for other in effect.alternatives)}
        )

    @property
    def summary(self) -> dict[str, Any]:
        """Its entry in ``sensors.json``."""
        of_sensor = {"sensor": self.sensor, "named": self.named, "without": self.without, "doubted": self.doubted}
        return {**of_sensor, "sentence": self.findings.sentence}

    @property
    def evidence_nats(self) -> float:
        """Gain of what was named, over all readings [nat]."""
        return self.findings.rows * sum(finding.gain_nats or 0.0 for finding in found_parts(self.findings))


def compare_sensors(
    paths: Sequence[Path], settings: Settings, folder: Path, steps: Callable[[Path], Steps], draw: bool
) -> tuple[tuple[SensorGap, ...], tuple[str, ...]]:
    """Compare each sensor with the rest, and again without the one that differs most, as often as something is named.

    Parameters
    ----------
    paths
        Recordings, or tables of several sensors.
    settings
        As for one sensor; `of` selects sensors, none: all.
    folder
        Gets a table of each round, a folder for each sensor, and the summary.
    steps
        The workflow in a sensor's folder.
    draw
        Whether to draw the pages.

    Returns
    -------
    tuple
        What was found at each sensor, and what was noticed about the readings.

    Raises
    ------
    RecordingError, ConfigError
        As the workflow itself; or fewer than three sensors look down.
    """
    make_folder(folder)
    found: dict[str, SensorGap] = {}
    without: list[str] = []
    while True:
        table, sensors, messages = _with_reference(paths, settings, folder, without)
        # Fewer others know less: they are asked whether what was named holds without the one that is off.
        todo = [name for name in settings.of or sensors if name not in without and (not without or found[name].named)]
        for name in todo:
            findings = steps(folder / name).all([table], replace(settings, of=(name,), run_column=None, map=()), "add")
            gap = SensorGap(name, findings, tuple(without))
            if without and gap.named and not gap.words & found[name].words:
                gap = replace(gap, doubted=without[-1])
            found[name] = gap
        named = [found[name] for name in todo if found[name].named and found[name].doubted is None]
        if not named:
            break
        without.append(max(named, key=lambda gap: gap.evidence_nats).sensor)
        if len(named) == 1:
            break
        # Of those that are left each needs enough others.
        if len(sensors) - len(without) <= MIN_OTHERS:
            left = [gap for gap in named if gap.sensor not in without]
            found |= {gap.sensor: replace(gap, doubted=without[-1]) for gap in left}
            break
    if draw:
        for name in found:
            steps(folder / name).show()
    gaps = tuple(found[name] for name in sorted(found))
    content = json.dumps([gap.summary for gap in gaps], indent=2)
    (folder / SUMMARY).write_text(content + "\n", encoding="utf-8")
    return gaps, messages


def _with_reference(
    paths: Sequence[Path], settings: Settings, folder: Path, without: Sequence[str]
) -> tuple[Path, list[str], tuple[str, ...]]:
    """A table of all readings with the other sensors as reference, the sensors, and what was noticed."""
    model = load_model(settings.model)
    column_map = load_maps(settings.map)
    loaded = load_readings(
        paths, model.sensor, column_map, run_column=settings.run_column, truth="others", without=without
    )
    path = folder / READINGS.format(len(without) + 1)
    path.unlink(missing_ok=True)
    write_csv(path, {name: column for name, column in loaded.data.columns.items() if name != PREVIOUS})
    return path, sorted(set(loaded.data["sensor"].tolist())), loaded.messages
