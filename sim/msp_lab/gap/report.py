"""The page of a gap: verdict first, then pictures, tables and methods; pictures are also written as PNG.

Findings, the models before and after and the held-out readings enter, files leave. Needs the extra ``lab``.
"""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.autocorrelation import draw_autocorrelation, residual_autocorrelation
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.labels import agreement, capitalised, effect_label, extension_label, headline, listed, name_of
from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.model_file import MODEL
from msp_lab.gap.pictures import draw_curve, draw_path, draw_pit, draw_residuals, draw_slices, subjects
from msp_lab.gap.tables import measures_table, model_table, parameters_table, shown_slices, slices_table, steps_table
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model, Term
from msp_sim.page.page import Omitted, Picture, render, write_page
from msp_sim.page.style import files_of, style

RESIDUALS_CAPTION = (
    "Readings of held-out runs, on which no value was fitted. Line and grey band are what the model expects: where "
    "the coloured points lie on the line, it does what the sensor does. Outliers are farther from the "
    "surface than scatter explains."
)


def write_report(
    findings: GapFindings, before: Model, after: Model, final_fit: Model, readings: HeldOutReadings, folder: Path
) -> Path:
    """Draw what there is to show and write the page; older files of these names are replaced.

    Parameters
    ----------
    findings
        All of them, or those of the first step.
    before
        The model that the readings were compared with.
    after
        With what was added, with the values of the training runs; the given model where nothing has been added yet.
    final_fit
        The same with the values of all runs: what ``model.yaml`` holds.
    readings
        The held-out readings.
    folder
        Where `report.html` and a PNG of each picture go.

    Returns
    -------
    Path
        The page, which needs none of the other files.

    Raises
    ------
    ConfigError
        A file cannot be written.
    """
    with style():
        pictures = list(_pictures(findings, before, after, readings))
    measures, steps = measures_table(findings, before), steps_table(findings)
    slices, numbers = slices_table(findings), model_table(findings, before, final_fit)
    known = [(each, CATALOGUE.get(each.name)) for each in findings.effects]
    effects = [(each, effect, parameters_table(each, effect)) for each, effect in known]
    html = render(
        __package__ or "msp_lab.gap",
        "gap.html",
        findings=findings,
        headline=headline(findings),
        capitalised=capitalised,
        training=listed(findings.training_runs),
        held_out=listed(findings.held_out_runs),
        pictures={each.name: each for each in pictures},
        gap=measures,
        steps=steps,
        slices=slices,
        numbers=numbers,
        given_effects=[_with_values(each) for each in before.effects],
        effects=effects,
        not_testable=_not_testable(findings),
        measured=len(readings),
        rules=rules,
        effect_label=effect_label,
        agreement=agreement,
        model_file=folder / MODEL if (folder / MODEL).exists() else None,
    )
    tables = (measures, steps, slices, numbers, *(table for _, _, table in effects))
    return write_page(folder, html, pictures, tables=tables)


def _pictures(
    findings: GapFindings, before: Model, after: Model, readings: HeldOutReadings
) -> Iterator[Picture | Omitted]:
    rng = np.random.default_rng([findings.settings.seed, 4])
    wanted, added = subjects(findings, readings), extension_label(findings)
    for name, title, some in (("lead", "", wanted[:1]), ("residuals", "Over other contexts", wanted[1:])):
        if some:
            names = ", ".join(name_of(each.column) for each in some)
            figure = draw_residuals(some, before, after, readings, rng, added)
            alternative = f"Readings against the model over {names}: left the given model, right {added}."
            yield Picture(name, title, RESIDUALS_CAPTION, alternative, files_of(figure))
    if not wanted:
        yield Omitted("lead", "Readings against the model", "No context column varies")
    yield Picture(
        "path",
        "The gap after each step",
        "How much better each reading could still be predicted after each addition (in nats, the natural logarithm "
        "of a probability). Readings that the final model draws itself show a gap up to the grey band.",
        "Bars of the gap after each step, with the noise floor.",
        files_of(draw_path(findings)),
    )
    yield Picture(
        "pit",
        "All readings, before and after",
        "Where each reading lies among those that the model expects there, from the nearest to the farthest. Flat "
        "where the model is right. A slope: readings are too far or too near. A U: they scatter more than that. "
        "High ends: outliers that the model does not have.",
        f"Two histograms: left the given model, right {added}.",
        files_of(draw_pit(before, after, readings, rng, added)),
    )
    repeated = residual_autocorrelation(before, readings, rng)
    left = residual_autocorrelation(after, readings, rng)
    if repeated.apart.size:
        yield Picture(
            "autocorrelation",
            "Do errors repeat?",
            "How alike the errors of two readings of a sensor are, over the time between them: 1 is the same error "
            "again, 0 is independent. After, the points should lie in the grey band: then nothing is left that one "
            "reading says about the next.",
            f"Correlation of errors over the time between readings: left the given model, right {added}.",
            files_of(draw_autocorrelation(repeated, left, added)),
        )
    else:
        yield Omitted("autocorrelation", "Do errors repeat?", "There are too few readings in a row")
    if len(shown_slices(findings)) > 1:
        yield Picture(
            "slices",
            "Slices of context",
            "Parts of the readings that differ most from the given model, the most certain ones first, with 95 % "
            "intervals; open marks: with what was added. In brackets the number of readings.",
            "Bias and ratios of spread and odds in slices of context, before and after.",
            files_of(draw_slices(findings)),
        )
    else:
        why = "No slice of context differs from the model significantly."
        yield Omitted("slices", "Slices of context", why)
    for number, each in enumerate(findings.unknown, start=1):
        if each.curve:
            yield Picture(
                f"unknown-{number}",
                f"Unknown effect {number}: {each.channel} over {name_of(each.variables[0])}",
                f"No effect of the catalogue explains it. Its formula: {each.formula}.",
                "A fitted curve with its band.",
                files_of(draw_curve(each)),
            )


def _with_values(each: Term) -> str:
    """An effect of a model with its values."""
    values = ", ".join(f"{name} {value:.4g}" for name, value in each.values.items())
    return f"{each.stream.replace('_', ' ')} ({values})" if values else each.stream.replace("_", " ")


def _not_testable(findings: GapFindings) -> list[tuple[str, list[str]]]:
    """Columns to record, each with the effects that they would show."""
    found: dict[str, list[str]] = {}
    for each in findings.not_testable:
        found.setdefault(" and ".join(each.columns) or each.why, []).append(each.name)
    return sorted(found.items())
