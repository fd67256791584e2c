"""The tables of a gap's page: measures, steps, slices, parameters and the model's own numbers.

Nothing is decided here.
"""

from collections.abc import Iterator

import numpy as np

from msp_lab.gap.findings import FoundEffect, GapFindings, Slice, error_name
from msp_lab.gap.labels import interval, short, slice_label, step_name, unit_after
from msp_lab.gap.verdict import bounds
from msp_range.descriptions import descriptions
from msp_range.reading_model.sensor_model import MixtureParameters, Weights
from msp_sim.effects.base import Effect
from msp_sim.model.model import Model
from msp_sim.page.table import PageTable
from msp_sim.page.text import plus

MOST_SLICES = 14
"""Slices on the page at most: one picture is as high as a screen."""


def measures_table(findings: GapFindings, given: Model | None = None) -> PageTable:
    """The gap in its measures, before and after, with noise floor and, for the model that was given, the bound."""
    gap = findings.gap
    assert gap is not None
    names = {
        "nats_per_reading": "gap [nats per reading]",
        "bias_cm": "bias [cm]",
        "spread_ratio": "spread, off by a factor of",
        "odds_short": "odds of short readings, off by a factor of",
        "odds_missed": "odds of missed echoes, off by a factor of",
        "odds_random": "odds of random readings, off by a factor of",
    }
    # Only some measures have a bound.
    bound = {} if given is None else bounds(findings, given)
    found = [(names[name], measure, bound.get(name)) for name, measure in gap.measures.items()]
    if (gap.odds.code.before, gap.odds.code.after or 1.0) != (1.0, 1.0):
        found.append(("readings that the model cannot give, off by a factor of", gap.odds.code, None))
    lines = [
        (
            name,
            short(measure.before),
            short(measure.after),
            interval(measure.low, measure.high),
            short(measure.noise_floor),
            short(limit),
        )
        for name, measure, limit in found
    ]
    header = ("measure", "before", "after", "95 % interval", "noise floor", "closed up to")
    columns = len(header) if given is not None else len(header) - 1
    return PageTable(
        "measures",
        "The gap in its measures",
        header[:columns],
        tuple(line[:columns] for line in lines),
        "On held-out runs. Root mean squares over the slices of the context in which the measure is most certain, less "
        "random variation. A factor of 1 is right. The interval is that of the last value, with errors of whole runs, "
        "or of blocks of readings where runs are few. 95 of 100 tables that the extended model draws stay below the "
        "noise floor.",
    )


def steps_table(findings: GapFindings) -> PageTable:
    """The gap after each step in numbers; empty where nothing was added."""
    path = findings.selection_path if len(findings.selection_path) > 1 else ()
    # None, for what is not known, becomes NaN.
    gained = np.diff(np.array([step.log_score for step in path], dtype=float), prepend=np.nan)
    return PageTable(
        "steps",
        "Each step in numbers",
        ("model", "gap [nats]", "mean log score [nats]", "gain [nats]"),
        tuple(
            (step_name(step.added), short(step.nats_per_reading), plus(step.log_score, 4), plus(gain, 4))
            for step, gain in zip(path, gained.tolist(), strict=True)
        ),
        "Per reading of the held-out runs; the log score is that of a step of the readings or a code.",
    )


def slices_table(findings: GapFindings) -> PageTable:
    """The slices that differ, in all channels."""
    return PageTable(
        "slices-table",
        "Slices in numbers",
        ("slice", "bias [cm]", "spread", "odds short", "odds missed", "odds random", "nats", "p", "changed by"),
        tuple(row for piece in shown_slices(findings) for row in _slice_rows(piece)),
        "Compared with the given model, with standard errors; below, what is left with what was added. Spread and odds "
        "are ratios to the model; few: too few such readings for a ratio. p-values are corrected for the number of "
        "slices and measures. Changed by: what was found and changes readings there by more than their noise.",
    )


def parameters_table(found: FoundEffect, effect: Effect | None) -> PageTable:
    """The parameters of an effect that was found: value, interval and meaning."""
    meanings = {parameter.name: parameter.meaning for parameter in effect.parameters} if effect is not None else {}
    rows = tuple(
        (name, meanings.get(name, ""), f"{value.value:.4g}{unit_after(value.unit)}", interval(value.low, value.high, 4))
        for name, value in found.parameters.items()
    )
    anchor = "-".join(("parameters", found.name, *([found.of] if found.of else [])))
    return PageTable(anchor, "", ("parameter", "meaning", "value", "95 % interval"), rows, align="llr")


def model_table(findings: GapFindings, given: Model, extended: Model) -> PageTable:
    """The numbers of the base mixture in the given and in the extended model."""
    before, after = given.sensor.reading_model, extended.sensor.reading_model
    calibrated = {number.name: number for number in findings.calibration}
    rows = []
    for part, one, other, section in (
        ("weights.", before.weights, after.weights, Weights),
        ("", before, after, MixtureParameters),
    ):
        for name, description in descriptions(section).items():
            old, new = getattr(one, name), getattr(other, name)
            if not isinstance(old, float | int):
                continue
            found = calibrated.get(part + name)
            ends = "" if found is None else interval(found.low, found.high, 4)
            meaning = description.split("\n")[0].rstrip(".").replace("`", "")
            rows.append((part + name, meaning, f"{old:.4g}", f"{new:.4g}" if new != old else "same", ends))
    return PageTable(
        "model-numbers",
        "The model's own numbers",
        ("number", "meaning", "given", "in model.yaml", "95 % interval"),
        tuple(rows),
        "All are refitted with whatever is added. Those with an interval are calibration: the runs show that the "
        "given value is wrong.",
        align="llr",
    )


def shown_slices(findings: GapFindings) -> list[Slice]:
    """The whole, and the slices that differ, the most significant first."""
    # A pair repeats what one of its variables shows.
    single = [piece for piece in findings.slices if piece.differs and len(piece.variables) == 1]
    seen = {name for piece in single for name in piece.variables}
    pairs = [
        piece
        for piece in findings.slices
        if piece.differs and len(piece.variables) > 1 and not {*piece.variables} & seen
    ]
    whole = [piece for piece in findings.slices if not piece.variables]
    return [*whole, *sorted((*single, *pairs), key=lambda piece: -abs(piece.z or 0.0))[: MOST_SLICES - 1]]


def slice_with_count(cell: Slice) -> str:
    """A slice's label, and how many readings it has."""
    return f"{slice_label(cell.where)} ({cell.readings:,})"


def _slice_rows(cell: Slice) -> Iterator[tuple[str, ...]]:
    """A row for before, and one for after where it was measured."""
    known = cell.bias_cm is not None and cell.bias_se_cm is not None
    cells = [slice_with_count(cell), f"{plus(cell.bias_cm, 2)} ± {cell.bias_se_cm:.2f}" if known else "?"]
    later = ["after", plus(cell.after.get("bias_cm"), 2)]
    for name in ("log_spread", "log_odds_short", "log_odds_missed", "log_odds_random"):
        value, error, left = getattr(cell, name), getattr(cell, error_name(name)), cell.after.get(name)
        if value is None or error is None or error > 1.0:
            cells.append("few")
            later.append("")
            continue
        ratio = float(np.exp(value))
        cells.append(f"{ratio:.2f} ± {ratio * error:.2f}")
        later.append("" if left is None else f"{np.exp(left):.2f}")
    cells.append(short(max(cell.nats or 0.0, 0.0)))
    cells.append("" if cell.p_value is None else "≤ 0.001" if cell.p_value <= 0.001 else f"{cell.p_value:.3f}")
    cells.append(", ".join(name.replace("_", " ") for name in cell.by))
    yield tuple(cells)
    if cell.after:
        nats = cell.after.get("nats")
        yield (*later, "" if nats is None else short(max(nats, 0.0)), "", "")
