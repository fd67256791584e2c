"""The gap workflow from measured readings to an extended model: compare, name, add.

Readings, a model and a generator enter; `GapFindings` and models leave. Runs are parted once, before anything is
looked at: on one part effects are chosen and fitted, on the other, the confirming runs, every gap is measured.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import findings as found
from msp_lab.gap.cells import Partition, partitions, varying
from msp_lab.gap.findings import GapFindings, Settings
from msp_lab.gap.intake import Readings
from msp_lab.gap.judge import sentence, verdict
from msp_lab.gap.measures import Measures, Table, Twins, measure, twins, usable
from msp_lab.gap.slices import again, ranked
from msp_lab.gap.units import Split, split
from msp_lab.gap.workbench import Explanation, explain
from msp_lab.readings.intake import PREVIOUS
from msp_sim.model.model import Model

Say = Callable[[str, float], None]
"""What is being done, and which share of the whole is behind it."""

MOST_MEASURED = 12_000
"""Confirming readings on which the four measures are taken; of more, every k-th."""
TWINS = 20
RUNS_AS_UNITS = 8
"""Runs: with fewer, blocks of consecutive readings are the units of chance."""
BLOCKS = 64
LEAST_WEIGHT = 1e-4
"""A kind of reading that a model says never to come could be compared with nothing: it gets this share."""
NO_SLICES = frozenset({"time_s", PREVIOUS, "reading_cm"})


@dataclass(frozen=True)
class Compared:
    """What the confirming readings are held against, and how far the given model is from them.

    Attributes
    ----------
    before
        The given model.
    data
        All columns of all readings, by name.
    parts
        Which readings are for choosing and fitting, and which confirm.
    table
        The confirming readings that are measured on; all can be given by the model.
    partition
        Slices of them.
    twins, measures
        Of the given model.
    findings
        So far.
    """

    before: Model
    data: Mapping[str, NDArray[Any]]
    parts: Split
    table: Table
    partition: list[Partition]
    twins: Twins
    measures: Measures
    impossible: float
    findings: GapFindings


@dataclass(frozen=True)
class Added:
    """The end of the workflow: the extended model, as it was proved and as it is quoted.

    Attributes
    ----------
    proved
        With the coefficients of the runs that it was chosen on: what the confirming runs judged.
    model
        With coefficients of the confirming runs, which choosing has not made too large.
    findings
        All.
    """

    proved: Model
    model: Model
    findings: GapFindings


def with_least_weights(model: Model) -> tuple[Model, list[str]]:
    """The model with no kind of reading at a share of exactly 0, and what there is to say of it."""
    weights = model.sensor.reading_model.weights
    shares = weights.model_dump()
    missing = [name for name, share in shares.items() if share < LEAST_WEIGHT]
    if not missing:
        return model, []
    raised = {name: max(share, LEAST_WEIGHT) for name, share in shares.items()}
    total = sum(raised.values())
    changed = weights.model_copy(update={name: share / total for name, share in raised.items()})
    mixture = model.sensor.reading_model.model_copy(update={"weights": changed})
    sensor = model.sensor.model_copy(update={"reading_model": mixture})
    text = (
        f"The model gives {' and '.join(missing)} readings a share of 0; {LEAST_WEIGHT:g} is taken, since nothing can "
        "be compared with what is said never to come."
    )
    return replace(model, sensor=sensor), [text]


def compare(readings: Readings, model: Model, settings: Settings, date: str, say: Say) -> Compared:
    """Where readings and model disagree, on the confirming runs.

    Parameters
    ----------
    readings
        From `intake.read_readings`.
    model
        What they are held against.
    settings
        Its seed is that of all chance.
    date
        For the record.
    say
        Is told what is being done.
    """
    model, weighed = with_least_weights(model)
    data = dict(readings.data.columns)
    rng = np.random.default_rng([settings.seed, 1])
    say("simulating twins of the readings", 0.05)
    parts, table, impossible = confirming(readings, model, settings)
    names = [name for name in varying(table.contexts) if name not in NO_SLICES]
    partition = partitions(table.contexts, names)
    drawn = twins(model, table, partition, TWINS, rng)
    say("comparing slices of context", 0.15)
    measured = measure(model, table, partition, drawn)
    slices = ranked(model, table, partition, drawn, measured.fits, rng)
    before = _gap(measured, None, drawn, impossible, None)
    findings = GapFindings(
        verdict=None,
        rows=len(readings.data),
        runs=int(np.unique(data["run"]).size),
        gap=before,
        calibration=readings.calibration,
        slices=slices,
        choosing=parts.fit_runs,
        confirming=parts.confirm_runs,
        sources=readings.sources,
        settings=settings,
        messages=(*readings.messages, *weighed, *parts.messages),
        date=date,
        path=(found.Step("", measured.nats.value, measured.log_score),),
    )
    return Compared(model, data, parts, table, partition, drawn, measured, impossible, findings)


def confirming(readings: Readings, model: Model, settings: Settings) -> tuple[Split, Table, float]:
    """The parting of the runs, the confirming readings to measure on, and the share that the model cannot give."""
    data = dict(readings.data.columns)
    parts = split(data, data["reading_cm"], np.random.default_rng([settings.seed, 0]), run_column="run")
    rows = np.flatnonzero(parts.confirm)
    rows = rows[:: max(1, -(-rows.size // MOST_MEASURED))]
    contexts = {name: column[rows] for name, column in data.items()}
    table = Table(data["reading_cm"][rows], contexts, _units(parts.runs[rows]))
    can = usable(model, table)
    return parts, table.take(can), float(1.0 - can.mean())


def name(compared: Compared, say: Say) -> tuple[GapFindings, Explanation]:
    """Name what is missing, with rivals, on the runs for choosing; the confirming runs say what it gains."""
    settings = compared.findings.settings
    rng = np.random.default_rng([settings.seed, 2])
    contexts = {key: column for key, column in compared.data.items() if key != "reading_cm"}
    explained = explain(
        compared.before,
        contexts,
        compared.data["reading_cm"],
        compared.parts,
        rng,
        alpha=settings.alpha,
        max_effects=settings.max_effects,
        progress=lambda what, share: say(what, 0.2 + 0.6 * share),
    )
    could_see = "; ".join(
        f"{effect} above {smallest:.2g} {'' if unit == '1' else unit}".rstrip()
        for effect, _, smallest, unit in explained.detectable
    )
    findings = replace(
        compared.findings,
        effects=explained.effects,
        unknown=explained.unknown,
        calibration=(*compared.findings.calibration, *explained.calibration),
        not_testable=explained.not_testable,
        could_have_seen=could_see,
        global_p_value=explained.global_p_value,
        messages=(
            *compared.findings.messages,
            *explained.messages,
            *(f"{dropped} was tried and dropped: {why}." for dropped, why in explained.dropped),
        ),
    )
    return findings, explained


def add(compared: Compared, findings: GapFindings, explained: Explanation, say: Say) -> Added:
    """Measure the gap again with what was added, and judge."""
    say("measuring what is left of the gap", 0.82)
    proved, table = explained.model_fit, compared.table
    rng = np.random.default_rng([findings.settings.seed, 3])
    can = usable(proved, table)
    table = table.take(can)
    partition = [each.take(can) for each in compared.partition] if not can.all() else compared.partition
    drawn = twins(proved, table, partition, TWINS, rng)
    measured = measure(proved, table, partition, drawn)
    gap = _gap(compared.measures, measured, drawn, compared.impossible, 1.0 - float(can.mean()))
    say("measuring each step of the way", 0.95)
    scores = [(step.name, _log_score(step.model, compared.table)) for step in explained.path if step.name]
    # The last step is the gap that was measured; each before it had what the ones after it gain.
    later = [found.Step(step, _left(measured, scores[-1][1] - score), score) for step, score in scores]
    slices = again(findings.slices, proved, table, partition, measured.fits)
    findings = replace(findings, gap=gap, path=(*findings.path, *later), slices=slices)
    findings = replace(findings, verdict=verdict(findings, compared.before))
    return Added(proved, explained.model, replace(findings, sentence=sentence(findings)))


def _left(measured: Measures, gain: float) -> float:
    return max(measured.nats.value + gain, 0.0)


def _log_score(model: Model, table: Table) -> float:
    return float(np.maximum(model.log_prob(table.reading_cm, table.contexts), np.log(1e-12)).mean())


def _units(runs: NDArray[np.str_]) -> NDArray[np.intp]:
    """Runs, or where they are few, blocks of consecutive readings of them."""
    names, unit, counts = np.unique(runs, return_inverse=True, return_counts=True)
    if names.size >= RUNS_AS_UNITS:
        return np.asarray(unit, dtype=np.intp)
    length = max(int(np.ceil(runs.size / BLOCKS)), 5)
    place = np.zeros(runs.size, dtype=np.intp)
    for i in range(names.size):
        rows = np.flatnonzero(unit == i)
        place[rows] = np.arange(rows.size) // length
    _, blocks = np.unique(unit * (int(counts.max()) // length + 1) + place, return_inverse=True)
    return np.asarray(blocks, dtype=np.intp)


def _gap(
    before: Measures, after: Measures | None, drawn: Twins, impossible: float, impossible_after: float | None
) -> found.Gap:
    def number(key: str) -> found.Measure:
        first, floor = before.numbers()[key], drawn.floor[key]
        if after is None:
            # Nothing has been added, so the interval is that of the gap itself.
            return found.Measure(*(_known(each) for each in (first.value, np.nan, floor, first.low, first.high)))
        last = after.numbers()[key]
        return found.Measure(*(_known(each) for each in (first.value, last.value, floor, last.low, last.high)))

    code = found.Measure(
        1.0 + impossible / LEAST_WEIGHT,
        None if impossible_after is None else 1.0 + impossible_after / LEAST_WEIGHT,
        1.0,
    )
    return found.Gap(
        number("nats"),
        number("bias_cm"),
        number("spread_ratio"),
        found.Odds(number("short"), number("missed"), number("random"), code),
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
