"""The steps of the gap workflow as commands run them: files in, files out.

``gap.json``, ``named.json``, the extended model, the page and its pictures are written, each as soon as it is known.
"""

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from numpy.random import default_rng
from threadpoolctl import threadpool_limits

from msp_lab.gap import before_after, naming
from msp_lab.gap.conclusion import with_words
from msp_lab.gap.findings import GapFindings, LastStep, Settings
from msp_lab.gap.findings_file import (
    MODEL,
    NAMED,
    NUMBERS,
    TRAINING_FIT,
    as_json,
    read_findings,
    read_named,
    write_findings,
    write_model,
    write_named,
)
from msp_lab.gap.intake import Comparison, read_readings
from msp_lab.gap.naming import ExtendedModels
from msp_lab.gap.problem import Progress
from msp_lab.readings.column_map import load_maps
from msp_lab.readings.from_files import Columns, Files, map_options, paths_of
from msp_lab.readings.intake import sha256
from msp_range import __version__
from msp_range.clock import Clock, SystemClock, date_of
from msp_range.yaml_file import ConfigError, config_path
from msp_sim.model.in_flight import in_flight
from msp_sim.model.model import load_model
from msp_sim.terminal import make_folder

DRAWN = (
    "report.html",
    *(
        f"{name}.{suffix}"
        for name in ("lead", "residuals", "path", "pit", "autocorrelation", "slices", "unknown-*")
        for suffix in ("png", "svg", "pdf")
    ),
    *(f"{name}.csv" for name in ("measures", "steps", "slices-table", "model-numbers", "parameters-*")),
)
"""The page, its pictures and its tables."""


@dataclass(frozen=True)
class Steps:
    """The workflow in a folder."""

    folder: Path
    """Where everything is written."""
    clock: Clock
    """For the date and how long it takes."""
    report: Progress
    """Reports what is being done."""
    answer: Callable[[GapFindings], None] = lambda _: None
    """Shows the findings, before pictures are drawn."""

    def all(
        self,
        paths: Sequence[Path],
        settings: Settings,
        until: LastStep = "show",
    ) -> GapFindings:
        """Read the data, compare, name, add and show, or only so far."""
        started_s = self.clock.now()
        self._clear()
        comparison = self._comparison(paths, settings)
        findings = self._written(self._compare(comparison), started_s)
        if until != "compare":
            findings, models = self._name(comparison, findings, started_s)
            if until != "name":
                findings = self._add(comparison, findings, models, started_s)
        self.answer(findings)
        if until == "show":
            self._draw(findings, comparison)
        return findings

    def name(self) -> GapFindings:
        """Name what is missing, with alternatives."""
        started_s = self.clock.now()
        comparison = self.same_comparison(read_findings(self.folder), "compare")
        findings, _ = self._name(comparison, self._compare(comparison), started_s)
        self.answer(findings)
        return findings

    def add(self) -> GapFindings:
        """Add what was named, and write the extended model."""
        started_s = self.clock.now()
        models, findings = read_named(self.folder)
        findings = self._add(self.same_comparison(findings, "name"), findings, models, started_s)
        self.answer(findings)
        return findings

    def show(self) -> GapFindings:
        """Draw the pictures and write the page."""
        findings = with_words(read_findings(self.folder))
        self.answer(findings)
        self._draw(findings, self._comparison_of(findings))
        return findings

    def _compare(self, comparison: Comparison) -> GapFindings:
        findings = before_after.compare(comparison, date_of(self.clock.utc()), self.report)
        return replace(findings, model_sha256=sha256(Path(findings.settings.model)), version=__version__)

    def _name(
        self, comparison: Comparison, findings: GapFindings, started_s: float
    ) -> tuple[GapFindings, ExtendedModels]:
        findings, models = naming.name(comparison, findings, self.report)
        findings = self._written(findings, started_s)
        write_named(models, findings, self.folder)
        return findings, models

    def _add(
        self, comparison: Comparison, findings: GapFindings, models: ExtendedModels, started_s: float
    ) -> GapFindings:
        findings = self._written(before_after.add(comparison, findings, models, self.report), started_s)
        try:
            self._write_models(findings, models, comparison)
        except ConfigError as error:
            # The findings are worth more than the file.
            message = f"The extended model is not written: {error}."
            findings = self._written(replace(findings, messages=(*findings.messages, message)), started_s)
        return findings

    def _write_models(self, findings: GapFindings, models: ExtendedModels, comparison: Comparison) -> None:
        given = Path(findings.settings.model).name
        heading = f"{given}, extended by msp-lab gap on {findings.date}."
        flown = in_flight(models.final_fit, comparison.held_out.contexts, default_rng(comparison.settings.seed))
        write_model(self.folder / MODEL, models.final_fit, findings, heading, flown)
        heading = (
            f"{given} with the values of the training runs, for the gap on the held-out runs; to fly with, use {MODEL}."
        )
        write_model(self.folder / TRAINING_FIT, models.training_fit, findings, heading)

    def _draw(self, findings: GapFindings, comparison: Comparison) -> None:
        from msp_lab.gap.report import write_report

        training_fit, final_fit = (
            load_model(path) if path.exists() else comparison.model
            for path in (self.folder / TRAINING_FIT, self.folder / MODEL)
        )
        self.report("drawing", 0.97)
        given = len(comparison.model.effects)
        fitted = training_fit.added_from(given), final_fit.added_from(given)
        write_report(findings, comparison.model, *fitted, comparison.held_out, self.folder)

    def _written(self, findings: GapFindings, started_s: float) -> GapFindings:
        """The findings with their words and how long they took, in ``gap.json`` too."""
        findings = replace(with_words(findings), seconds=round(self.clock.now() - started_s, 3))
        write_findings(findings, self.folder)
        return findings

    def _clear(self) -> None:
        """Make the folder, and remove what an earlier comparison left there: it would be taken for this one's."""
        make_folder(self.folder)
        for name in (NUMBERS, NAMED, MODEL, TRAINING_FIT, *DRAWN):
            for path in self.folder.glob(name):
                path.unlink()

    def _comparison(self, paths: Sequence[Path], settings: Settings) -> Comparison:
        model = load_model(settings.model)
        self.report("reading", 0.0)
        readings = read_readings(
            paths, model, load_maps(settings.map), run_column=settings.run_column, sensors=settings.of
        )
        return Comparison.of(readings, model, settings)

    def _comparison_of(self, findings: GapFindings) -> Comparison:
        return self._comparison([Path(source.path) for source in findings.sources], findings.settings)

    def same_comparison(self, findings: GapFindings, step: str) -> Comparison:
        """The comparison of earlier findings; an error where its files have changed since that step."""
        comparison = self._comparison_of(findings)
        pairs = zip(findings.sources, comparison.readings.sources, strict=True)
        changed = [old.path for old, new in pairs if old.sha256 != new.sha256]
        if findings.model_sha256 != sha256(Path(findings.settings.model)):
            changed.append(findings.settings.model)
        if changed:
            raise ConfigError(f"{', '.join(changed)}: has changed since 'msp-lab {step}'; run 'msp-lab compare' again")
        return comparison


def find_gap(
    files: Files,
    model: Path | str = "mb1242",
    *,
    columns: Columns | None = None,
    out: Path | str | None = None,
    until: LastStep = "add",
    seed: int = 1,
) -> dict[str, Any]:
    """Find where readings and a sensor model disagree and what the model is missing, as ``msp-lab gap`` does.

    Parameters
    ----------
    files
        Readings with true ranges, best of four runs or more.
    model
        The sensor model to compare with.
    columns
        Where another table's columns are.
    out
        Folder for ``gap.json``, the extended model.yaml and with ``until="show"`` the page; None: nothing is kept.
    until
        The last step: compare, name what is missing, add it to the model, show it as a page with pictures.
    seed
        Random seed.

    Returns
    -------
    dict
        The content of ``gap.json``: `gap` in its measures, `effects` that were named, `plain` sentences.

    Raises
    ------
    UserError
        The readings or files cannot be used; in a line, with what to do.

    Examples
    --------
    >>> import numpy as np
    >>> from msp_range import ReadingModel
    >>> from msp_range.recording.csv_form import write_csv
    >>> sensor = ReadingModel.of("mb1242")
    >>> rng = np.random.default_rng(1)
    >>> true_cm = rng.uniform(40.0, 400.0, 2000)
    >>> reading_cm = sensor.sample({"true_range_cm": true_cm}, rng) + 4.0
    >>> folder = TemporaryDirectory()
    >>> table = Path(folder.name, "readings.csv")
    >>> columns = {"time_s": np.arange(2000.0), "sensor": np.full(2000, "mine"), "run": np.repeat([*"abcdefgh"], 250)}
    >>> write_csv(table, {**columns, "reading_cm": reading_cm, "true_range_cm": true_cm})
    >>> found = find_gap(table, until="compare")
    >>> found["gap"]["bias_cm"]["before"] > 3.0
    True
    >>> folder.cleanup()
    """
    settings = Settings(str(config_path(model, "sensors")), seed=seed, map=map_options(columns))
    with TemporaryDirectory() as kept_nowhere, threadpool_limits(limits=1):
        steps = Steps(Path(kept_nowhere if out is None else out), SystemClock(), lambda what, share: None)
        return dict(json.loads(as_json(steps.all(paths_of(files), settings, until))))
