"""The steps of the gap workflow as commands run them: files in, files out, each step going on from ``gap.json``.

Paths and a clock enter; what is written is ``gap.json``, the extended model, the page and its pictures.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from msp_lab.gap import workflow
from msp_lab.gap.findings import NUMBERS, GapFindings, Settings, read_findings, write_findings
from msp_lab.gap.intake import read_readings
from msp_lab.gap.judge import sentence
from msp_lab.gap.measures import Table
from msp_lab.gap.model_file import MODEL, PROVED, write_model
from msp_lab.gap.workflow import Compared, Say
from msp_lab.readings.column_map import load_map
from msp_lab.readings.intake import sha256
from msp_range import __version__
from msp_range.clock import Clock, date_of
from msp_range.yaml_file import ConfigError
from msp_sim.model.model import Model, load_model
from msp_sim.terminal import make_folder

DRAWN = ("report.html", "residuals.png", "path.png", "pit.png", "slices.png", "unknown-*.png")
"""The page and its pictures."""


@dataclass(frozen=True)
class Steps:
    """The workflow in a folder.

    Attributes
    ----------
    folder
        Where everything is written.
    clock
        For the date and how long it takes.
    say
        Is told what is being done.
    """

    folder: Path
    clock: Clock
    say: Say

    def all(
        self,
        paths: Sequence[Path],
        settings: Settings,
        until: Literal["compare", "name", "add", "show"] = "show",
    ) -> GapFindings:
        """Read the data, compare, name, add and show, or only so far."""
        started_s = self.clock.now()
        self._clear()
        compared = self._compared(paths, settings)
        findings = self._written(compared.findings, started_s)
        if until == "compare":
            return findings
        if until == "name":
            findings, _ = workflow.name(compared, self.say)
            return self._written(findings, started_s)
        findings = self._finish(compared, started_s)
        if until == "show":
            self._draw(findings, compared.before, compared.table)
        return findings

    def name(self) -> GapFindings:
        """Name what is missing, and write it with its rivals."""
        started_s = self.clock.now()
        findings, _ = workflow.name(self._again(), self.say)
        return self._written(findings, started_s)

    def add(self) -> GapFindings:
        """Add what was named, prove it, and write the extended model."""
        started_s = self.clock.now()
        return self._finish(self._again(), started_s)

    def show(self) -> GapFindings:
        """Draw the pictures and write the page."""
        findings = read_findings(self.folder)
        self._draw(findings, *self._readings(findings))
        return findings

    def _draw(self, findings: GapFindings, before: Model, table: Table) -> None:
        from msp_lab.gap.report import Models, write_report

        proved, quoted = (
            load_model(path) if path.exists() else before for path in (self.folder / PROVED, self.folder / MODEL)
        )
        self.say("drawing", 0.97)
        write_report(findings, Models(before, proved, quoted), table, self.folder)

    def _written(self, findings: GapFindings, started_s: float) -> GapFindings:
        """The findings with their sentence and how long they took, in ``gap.json`` too."""
        findings = replace(findings, sentence=sentence(findings), seconds=round(self.clock.now() - started_s, 3))
        write_findings(findings, self.folder)
        return findings

    def _finish(self, compared: Compared, started_s: float) -> GapFindings:
        named, explained = workflow.name(compared, self.say)
        added = workflow.add(compared, named, explained, self.say)
        findings = self._written(added.findings, started_s)
        given = Path(findings.settings.model).name
        write_model(self.folder / MODEL, added.model, findings, f"{given}, extended by msp-lab gap on {findings.date}.")
        heading = f"{given} as it was when the confirming runs judged it; to fly with, take {MODEL}."
        write_model(self.folder / PROVED, added.proved, findings, heading)
        return findings

    def _clear(self) -> None:
        """Make the folder; what an earlier comparison left there would be taken for this one's, and goes."""
        make_folder(self.folder)
        for name in (NUMBERS, MODEL, PROVED, *DRAWN):
            for path in self.folder.glob(name):
                path.unlink()

    def _again(self) -> Compared:
        """The comparison of a folder's ``gap.json``, made again from its data."""
        earlier = read_findings(self.folder)
        compared = self._compared([Path(each.path) for each in earlier.sources], earlier.settings)
        now = compared.findings
        changed = [old.path for old, new in zip(earlier.sources, now.sources, strict=True) if old.sha256 != new.sha256]
        if earlier.model_sha256 != now.model_sha256:
            changed.append(earlier.settings.model)
        if changed:
            raise ConfigError(f"{', '.join(changed)}: has changed since 'msp-lab compare'; compare again")
        return compared

    def _readings(self, findings: GapFindings) -> tuple[Model, Table]:
        compared_with, _ = workflow.with_least_weights(load_model(findings.settings.model))
        readings = read_readings(
            [Path(each.path) for each in findings.sources],
            compared_with,
            load_map(findings.settings.map) if findings.settings.map else None,
            findings.settings.run_column,
        )
        _, table, _ = workflow.confirming(readings, compared_with, findings.settings)
        return compared_with, table

    def _compared(self, paths: Sequence[Path], settings: Settings) -> Compared:
        model = load_model(settings.model)
        self.say("reading", 0.0)
        column_map = load_map(settings.map) if settings.map else None
        readings = read_readings(paths, model, column_map, settings.run_column)
        compared = workflow.compare(readings, model, settings, date_of(self.clock.utc()), self.say)
        made_from = replace(compared.findings, model_sha256=sha256(Path(settings.model)), version=__version__)
        return replace(compared, findings=made_from)
