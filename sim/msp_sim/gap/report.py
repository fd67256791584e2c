"""The page of a gap: verdict first, then pictures, tables and how it was done; also as PNGs beside it.

Findings, the models before and after and the confirming readings enter, files leave. Needs the extra ``lab``.
"""

from pathlib import Path

import numpy as np

from msp_range.page.page import Omitted, Picture, Table, render
from msp_range.page.style import png, style
from msp_range.yaml_file import ConfigError
from msp_sim.effects import CATALOGUE
from msp_sim.gap import measures
from msp_sim.gap.findings import GapFindings, Measure, Slice
from msp_sim.gap.judge import bounds
from msp_sim.gap.pictures import (
    draw_curve,
    draw_path,
    draw_pit,
    draw_residuals,
    draw_slices,
    shown_slices,
    slice_words,
    subjects,
)
from msp_sim.gap.words import name_of
from msp_sim.model.model import Model

PAGE = "report.html"


def write_report(findings: GapFindings, before: Model, after: Model, table: measures.Table, folder: Path) -> Path:
    """Draw what there is to show and write the page; older files of these names are replaced.

    Parameters
    ----------
    findings
        All of them, or those of the first step.
    before, after
        The model as given, and as the confirming runs judged it.
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
    with style():
        pictures = _pictures(findings, before, after, table)
    html = render(
        __package__ or "msp_sim.gap",
        "gap.html",
        findings=findings,
        pictures=pictures,
        gap=_gap_table(findings, before),
        slices=_slice_table(findings),
        effects=[(each, CATALOGUE.get(each.name)) for each in findings.effects],
        not_testable=_not_testable(findings),
        measured=len(table),
    )
    try:
        for each in pictures:
            if isinstance(each, Picture):
                (folder / f"{each.name}.png").write_bytes(each.png)
        (folder / PAGE).write_text(html, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: the report cannot be written: {error.strerror}") from None
    return folder / PAGE


def _pictures(findings: GapFindings, before: Model, after: Model, table: measures.Table) -> list[Picture | Omitted]:
    rng = np.random.default_rng([findings.settings.seed, 4])
    wanted = subjects(findings, table)
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
                f"Residuals over {names}, left with the model as given and right with what was added.",
                png(draw_residuals(wanted, before, after, table, rng)),
            )
        )
    else:
        found.append(Omitted("residuals", "What does not fit, before and after", "No context column varies."))
    found.append(
        Picture(
            "path",
            "The way of the gap",
            "What a model that is free in each slice of context would gain a reading, after each thing that was added. "
            "Twins are readings that the final model itself drew: in the grey there is no gap to be seen.",
            "Bars of the gap after each step, with the floor that simulated twins show.",
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
            "Two histograms, left with the model as given and right with what was added.",
            png(draw_pit(before, after, table, rng)),
        )
    )
    if len(shown_slices(findings)) > 1:
        found.append(
            Picture(
                "slices",
                "Slices of context",
                "Those that differ most from the model as given, the surest first, with 95 % intervals; open circles: "
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


def _gap_table(findings: GapFindings, before: Model) -> Table | None:
    gap = findings.gap
    if gap is None:
        return None
    bound = bounds(findings, before)
    lines = (
        ("gap [nats a reading]", gap.nats_per_reading, bound["nats_per_reading"]),
        ("bias [cm]", gap.bias_cm, bound["bias_cm"]),
        ("spread, by which factor off", gap.spread_ratio, bound["spread_ratio"]),
        ("odds of short readings, by which factor off", gap.odds.short, None),
        ("odds of missed echoes, by which factor off", gap.odds.missed, None),
        ("odds of random readings, by which factor off", gap.odds.random, None),
        ("readings that the model cannot give, by which factor off", gap.odds.code, None),
    )
    return Table(
        "measures",
        "The gap in its measures",
        ("measure", "before", "after", "95 % interval", "chance (twins)", "counts as closed up to"),
        tuple((name, *_row(measure, limit)) for name, measure, limit in lines),
        "On the confirming runs. Root mean squares over the slices of the context in which it is surest, less what "
        "chance adds. A factor of 1 is right.",
    )


def _row(measure: Measure, limit: float | None) -> tuple[str, ...]:
    low, high = _short(measure.low), _short(measure.high)
    interval = f"{low} to {high}" if low and high else ""
    return (_short(measure.before), _short(measure.after), interval, _short(measure.floor), _short(limit))


def _slice_table(findings: GapFindings) -> Table:
    rows = tuple(_slice_row(each) for each in shown_slices(findings))
    return Table(
        "slices-table",
        "The same slices in numbers",
        ("slice", "bias [cm]", "spread", "odds short", "odds missed", "odds random", "nats", "p"),
        rows,
        "Before, with standard errors, and after an arrow with what was added. Spread and odds as ratios to the "
        "model. p-values are corrected for the number of slices and measures.",
    )


def _slice_row(each: Slice) -> tuple[str, ...]:
    cells = [slice_words(each), _arrow(_plus_minus(each.bias_cm, each.bias_se_cm), each.after.get("bias_cm"), False)]
    for name in ("log_spread", "log_odds_short", "log_odds_missed", "log_odds_random"):
        value, error = getattr(each, name), getattr(each, f"{name}_se")
        if value is None or error is None or error > 1.0:
            cells.append("few")
            continue
        ratio = float(np.exp(value))
        cells.append(_arrow(f"{ratio:.2f} ± {ratio * error:.2f}", each.after.get(name), True))
    cells.append(_arrow(_short(max(each.nats or 0.0, 0.0)), max(each.after.get("nats") or 0.0, 0.0), False))
    cells.append("" if each.p_value is None else "≤ 0.001" if each.p_value <= 0.001 else f"{each.p_value:.3f}")
    return tuple(cells)


def _plus_minus(value: float | None, error: float | None) -> str:
    return "?" if value is None or error is None else f"{value:+.2f} ± {error:.2f}"


def _arrow(text: str, later: float | None, is_log: bool) -> str:
    if later is None:
        return text
    return f"{text} → {np.exp(later):.2f}" if is_log else f"{text} → {_short(later)}"


def _not_testable(findings: GapFindings) -> list[tuple[str, list[str]]]:
    """Columns to record, each with the effects that it would show."""
    found: dict[str, list[str]] = {}
    for each in findings.not_testable:
        found.setdefault(" and ".join(each.columns) or each.why, []).append(each.name)
    return sorted(found.items())


def _short(value: float | None) -> str:
    if value is None:
        return ""
    return "0" if abs(value) < 5e-5 else f"{value:.2g}" if abs(value) < 1.0 else f"{value:.3g}"
