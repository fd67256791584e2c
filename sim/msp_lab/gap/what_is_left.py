"""What is left of a disagreement, and what shows why: runs that differ, a number of the model, a column to record.

It follows from the slices with what was found added, and from how far runs differ.
"""

from collections.abc import Iterator

from msp_lab.gap import rules
from msp_lab.gap.findings import GapFindings, Slice, error_name
from msp_lab.gap.labels import effect_label, short
from msp_lab.gap.measures import CHANNEL_OF
from msp_lab.gap.prepared import ODDS_CHANNELS
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.plain import digits
from msp_sim.effects.run_offsets import RUN_OFFSETS
from msp_sim.page.text import and_list

MOST_NAMED = 3
"""Runs, or effects that would need a column, in a sentence."""
FIELDS = {
    "bias_cm": "bias_cm",
    "spread_ratio": "log_spread",
    **{f"odds_{one}": f"log_odds_{one}" for one in ODDS_CHANNELS},
}
"""Field of a `Slice` with each measure."""
OF_RUNS = 0.5
"""What runs differ by is what is left if it is this share of the bias that is left. Two halves of the runs differ by so
much by random variation. Higher: disagreements of runs are said to be unexplained; lower: other ones to be of runs."""


def what_is_left(findings: GapFindings) -> str:
    """What is left where runs differ or readings wander about as much as the bias that is left; else nothing."""
    scatter, gap = findings.run_scatter, findings.gap
    if scatter is None or gap is None or not gap.bias_cm.is_beyond_floor:
        return ""
    bias_cm = gap.bias_cm.after or 0.0
    if scatter.deviation_cm < OF_RUNS * bias_cm:
        return ""
    size = digits(scatter.deviation_cm)
    if scatter.inside_runs:
        what = f"readings wander by {size} cm in the course of a run"
    elif any(effect.name == RUN_OFFSETS.name for effect in findings.effects):
        what = f"the runs on which it is measured differ by more, {digits(bias_cm)} cm"
    else:
        what = f"runs differ from each other by {size} cm"
    spread = f" and the spread is off by a factor {short(gap.spread_ratio.after)}" * gap.spread_ratio.is_beyond_floor
    return what + spread


def next_of_runs(findings: GapFindings) -> str:
    """What shows why runs differ, or readings wander inside them."""
    if findings.run_scatter is not None and findings.run_scatter.inside_runs:
        return "log a fixed target for as long as a run: it shows whether readings wander by themselves"
    off = {
        piece.where: off_cm for piece, off_cm in _off_from_the_rest(findings, "bias_cm") if piece.variables == ("run",)
    }
    farthest = sorted(off, key=lambda where: -abs(off[where]))[:MOST_NAMED]
    if not farthest:
        return f"to see how far runs differ: {RUN_OFFSETS.experiment}"
    runs = [f"{where.removeprefix('run ')} ({off[where]:+.2g} cm)" for where in farthest]
    return f"look at what was different in {and_list(runs)}"


def own_number(findings: GapFindings) -> str:
    """To make the model's own number again that is off alike in all slices; empty where there is none."""
    whole = next((piece for piece in findings.slices if not piece.variables), None)
    for number, label in (("log_spread", "scatter (sigma)"), ("bias_cm", "constant offset")):
        value, error = (None, None) if whole is None else (whole.after.get(number), getattr(whole, error_name(number)))
        alike = not [piece for piece, _ in _off_from_the_rest(findings, number)]
        if None not in (value, error) and alike and abs(value or 0.0) > rules.SURE_Z * (error or 0.0):
            return (
                f"make the model's own numbers of more such readings (msp-lab characterise): {label} is off everywhere"
            )
    return ""


def likely_column(findings: GapFindings) -> str:
    """The column that is not recorded and would show most effects on what is still off; empty where none would.

    What else such an effect depends on is recorded, and what is left differs over it, or over anything.
    """
    measures = {} if findings.gap is None else findings.gap.measures
    off = [key for key, measure in measures.items() if key in CHANNEL_OF and measure.is_beyond_floor]
    over = {
        CHANNEL_OF[key]: {name for piece, _ in _off_from_the_rest(findings, FIELDS[key]) for name in piece.variables}
        for key in off
    }
    likely: dict[str, list[str]] = {}
    for untested in findings.not_testable:
        effect = CATALOGUE.get(untested.name)
        if len(untested.columns) != 1 or effect is None:
            continue
        recorded = set(effect.requires) - {*untested.columns}
        # Scatter and shares need the range only since there is no hit without it.
        needed = {channel: recorded - ({TRUE_RANGE} if channel != "bias" else set()) for channel in effect.channels}
        if any(over.get(channel) and columns <= over[channel] for channel, columns in needed.items()):
            likely.setdefault(untested.columns[0], []).append(effect_label(untested.name, None))
    if not likely:
        return ""
    column, names = max(likely.items(), key=lambda item: len(item[1]))
    return f"record {column}: {and_list(names[:MOST_NAMED])} would need it, and may be what is left"


def _off_from_the_rest(findings: GapFindings, number: str) -> Iterator[tuple[Slice, float]]:
    """Slices of one column that are still off by another number than all readings, and by how much."""
    whole = next((piece for piece in findings.slices if not piece.variables), None)
    of_all = 0.0 if whole is None else whole.after.get(number) or 0.0
    for piece in findings.slices:
        value, error = piece.after.get(number), getattr(piece, error_name(number))
        if len(piece.variables) != 1 or value is None or error is None:
            continue
        if abs(value - of_all) > rules.SURE_Z * error:
            yield piece, value - of_all
