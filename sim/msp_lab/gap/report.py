"""The page of a gap: verdict first, then pictures, tables and methods; pictures are also written as PNG.

Files are made of the findings, the models before and after and the held-out readings. Needs the extra ``lab``.
"""

from pathlib import Path

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.conclusion import how_sure_of, in_words, is_sure
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.findings_file import MODEL
from msp_lab.gap.labels import channel_label, effect_label, extension_label
from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.pictures import BeforeAfter, entries
from msp_lab.gap.tables import measures_table, model_table, parameters_table, slices_table, steps_table
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model, Term
from msp_sim.page.page import pictures_of, write_page
from msp_sim.page.text import capitalised, listed


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
    rng = np.random.default_rng([findings.settings.seed, 4])
    pictures = pictures_of(entries(findings, BeforeAfter(before, after, extension_label(findings), readings, rng)))
    known = [(found, CATALOGUE.get(found.name)) for found in findings.effects]
    effects = [(found, effect, parameters_table(found, effect)) for found, effect in known]
    return write_page(
        folder,
        f"{__package__}/gap.html",
        pictures,
        [
            measures_table(findings, before),
            steps_table(findings),
            slices_table(findings),
            model_table(findings, before, final_fit),
            *(table for _, _, table in effects),
        ],
        findings=findings,
        training=listed(findings.training_runs),
        held_out=listed(findings.held_out_runs),
        given_effects=[_with_values(term) for term in before.effects],
        effects=effects,
        not_testable=_not_testable(findings),
        measured=len(readings),
        rules=rules,
        effect_label=effect_label,
        channel_label=channel_label,
        how_sure_of=lambda finding: how_sure_of(finding, findings),
        in_words=lambda finding: capitalised(in_words(finding, findings)),
        is_sure=lambda finding: is_sure(finding, findings),
        model_file=folder / MODEL if (folder / MODEL).exists() else None,
    )


def _with_values(term: Term) -> str:
    """An effect of a model with its values."""
    values = ", ".join(f"{name} {value:.4g}" for name, value in term.values.items())
    return f"{term.stream.replace('_', ' ')} ({values})" if values else term.stream.replace("_", " ")


def _not_testable(findings: GapFindings) -> list[tuple[str, list[str]]]:
    """Columns to record, each with the effects that they would show."""
    found: dict[str, list[str]] = {}
    for untested in findings.not_testable:
        found.setdefault(" and ".join(untested.columns) or untested.why, []).append(untested.name)
    return sorted(found.items())
