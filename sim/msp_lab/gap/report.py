"""The page of a gap: verdict first, then pictures, tables and how it was done; also as PNGs beside it.

Findings, the models before and after and the confirming readings enter, files leave. Needs the extra ``lab``.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from msp_lab.gap import judge
from msp_lab.gap.findings import FoundEffect, GapFindings
from msp_lab.gap.measures import Table
from msp_lab.gap.model_file import MODEL
from msp_lab.gap.pictures import draw_curve, draw_path, draw_pit, draw_residuals, draw_slices, subjects
from msp_lab.gap.tables import measures_table, model_table, parameters_table, shown_slices, slices_table, steps_table
from msp_lab.gap.words import added_words, capitalised, headline, listed, name_of
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import Effect
from msp_sim.model.model import Active, Model
from msp_sim.page.page import Omitted, Picture, render, write_page
from msp_sim.page.style import png, style


@dataclass(frozen=True)
class Models:
    """The model of each stage.

    Attributes
    ----------
    given
        What the readings were held against.
    proved
        With what was added, as the confirming runs judged it.
    quoted
        The same with the numbers of the confirming runs: what ``model.yaml`` holds.
    """

    given: Model
    proved: Model
    quoted: Model


def write_report(findings: GapFindings, models: Models, table: Table, folder: Path) -> Path:
    """Draw what there is to show and write the page; older files of these names are replaced.

    Parameters
    ----------
    findings
        All of them, or those of the first step.
    models
        Before and after; the given one thrice where nothing has been added yet.
    table
        The confirming readings.
    folder
        Where `report.html` and a PNG a picture go.

    Returns
    -------
    Path
        Of the page, which needs none of the other files.

    Raises
    ------
    ConfigError
        A file cannot be written.
    """
    before, after = models.given, models.proved
    with style():
        pictures = _pictures(findings, before, after, table)
    html = render(
        __package__ or "msp_lab.gap",
        "gap.html",
        findings=findings,
        headline=headline(findings),
        capitalised=capitalised,
        choosing=listed(findings.choosing),
        confirming=listed(findings.confirming),
        pictures={each.name: each for each in pictures},
        gap=measures_table(findings, before),
        steps=steps_table(findings),
        slices=slices_table(findings),
        numbers=model_table(findings, before, models.quoted),
        had=[_effect_words(each) for each in before.effects],
        effects=[(each, effect, parameters_table(each, effect)) for each, effect in _with_catalogue(findings)],
        not_testable=_not_testable(findings),
        measured=len(table),
        bound={"sigmas": judge.BIAS_SIGMAS, "spread": judge.SPREAD_RATIO, "nats": judge.NATS, "floors": judge.FLOORS},
        model_file=folder / MODEL if (folder / MODEL).exists() else None,
    )
    return write_page(folder, html, pictures)


def _pictures(findings: GapFindings, before: Model, after: Model, table: Table) -> list[Picture | Omitted]:
    rng = np.random.default_rng([findings.settings.seed, 4])
    wanted, added = subjects(findings, table), added_words(findings)
    found: list[Picture | Omitted] = []
    if wanted:
        names = ", ".join(name_of(each.column) for each in wanted)
        found.append(
            Picture(
                "residuals",
                "What does not fit, before and after",
                "Readings of the confirming runs, which took no part in choosing or fitting. Line and grey band are "
                "what the model expects. Where the coloured points lie on the line and inside the band, the model "
                "tells what the sensor does.",
                f"Residuals over {names}: left the model as given, right {added}.",
                png(draw_residuals(wanted, before, after, table, rng, added)),
            )
        )
    else:
        found.append(Omitted("residuals", "What does not fit, before and after", "No context column varies."))
    found.append(
        Picture(
            "path",
            "The way of the gap",
            "What a model that is free in each slice of context would gain a reading, after each thing that was added. "
            "Twins are readings that the final model itself drew at the same contexts: in the grey there is no gap "
            "to be seen.",
            "Bars of the gap after each step, on the ground of what simulated twins show.",
            png(draw_path(findings)),
        )
    )
    found.append(
        Picture(
            "pit",
            "The whole distribution, before and after",
            "For each reading the share of the model's readings that are smaller (randomised probability integral "
            "transform). Flat where the model is right; a slope is a bias, a U too small a spread, high ends are "
            "outliers that the model does not have.",
            f"Two histograms: left the model as given, right {added}.",
            png(draw_pit(before, after, table, rng, added)),
        )
    )
    if len(shown_slices(findings)) > 1:
        found.append(
            Picture(
                "slices",
                "Slices of context",
                "Those that differ most from the model as given, the surest first, with 95 % intervals; open marks: "
                "with what was added. In brackets the number of readings.",
                "Bias and ratios of spread and odds in slices of context, before and after.",
                png(draw_slices(findings)),
            )
        )
    else:
        why = "No slice of context differs from the model by more than chance."
        found.append(Omitted("slices", "Slices of context", why))
    for number, each in enumerate(findings.unknown, start=1):
        if each.curve:
            found.append(
                Picture(
                    f"unknown-{number}",
                    f"Unknown effect {number}: {each.channel} over {name_of(each.variables[0])}",
                    f"No effect of the catalogue explains it. In short: {each.formula}.",
                    "A fitted curve with its band.",
                    png(draw_curve(each)),
                )
            )
    return found


def _with_catalogue(findings: GapFindings) -> list[tuple[FoundEffect, Effect | None]]:
    return [(each, CATALOGUE.get(each.name)) for each in findings.effects]


def _effect_words(each: Active) -> str:
    """An effect of a model with its numbers."""
    values = ", ".join(f"{name} {value:.4g}" for name, value in each.values.items())
    return f"{each.stream.replace('_', ' ')} ({values})" if values else each.stream.replace("_", " ")


def _not_testable(findings: GapFindings) -> list[tuple[str, list[str]]]:
    """Columns to record, each with the effects that it would show."""
    found: dict[str, list[str]] = {}
    for each in findings.not_testable:
        found.setdefault(" and ".join(each.columns) or each.why, []).append(each.name)
    return sorted(found.items())
