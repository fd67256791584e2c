"""The gap workflow from measured readings to an extended model: compare, name, add.

Readings and a model enter; `GapFindings` and models leave. Runs are split before anything is looked at. Effects are
selected and fitted on all runs, and kept if nearly all splits agree. The gap is measured on half of the runs,
what is left of it with a fit of the other half alone.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.age import reading_age
from msp_lab.gap.blank_cells import KnownRows
from msp_lab.gap.causes import possible_causes
from msp_lab.gap.cells import Partition, partitions, varying
from msp_lab.gap.findings import Gap, GapFindings, Measure, OddsMeasures, PathStep, Settings
from msp_lab.gap.intake import Readings
from msp_lab.gap.measures import HeldOutReadings, Measures, Replicates, measure, replicates, usable
from msp_lab.gap.naming import ExtendedModels, NamedModel, name_effects
from msp_lab.gap.problem import Progress
from msp_lab.gap.slices import ranked, remeasured
from msp_lab.gap.splits import Splits, draw_splits
from msp_lab.gap.verdict import verdict
from msp_lab.readings.intake import PREVIOUS
from msp_sim.effects.base import REFERENCE_STD
from msp_sim.model.model import Model

NO_SLICES = frozenset({"time_s", PREVIOUS, "reading_cm", REFERENCE_STD})


@dataclass(frozen=True)
class Comparison:
    """Readings and the model that they are compared with.

    Attributes
    ----------
    model
        The given model, without kinds of reading at a share of 0.
    data
        All columns of all readings, by name.
    splits
        Of the runs.
    held_out
        The held-out readings that are measured on; the model can give all of them.
    partitions
        Slices of those.
    impossible
        Share of the held-out readings that the model cannot give.
    settings, readings
        What was asked for, and the readings as they were read.
    messages
        What was noticed.
    """

    model: Model
    data: Mapping[str, NDArray[Any]]
    splits: Splits
    held_out: HeldOutReadings
    partitions: list[Partition]
    impossible: float
    settings: Settings
    readings: Readings
    messages: tuple[str, ...]

    @classmethod
    def of(cls, readings: Readings, model: Model, settings: Settings) -> "Comparison":
        """Split the runs, and take the held-out readings to measure on.

        Parameters
        ----------
        readings
            From `intake.read_readings`.
        model
            The given model.
        settings
            With the random seed.
        """
        model, messages = with_least_weights(model)
        data = dict(readings.data.columns)
        parts = draw_splits(data, np.random.default_rng([settings.seed, 0]))
        rows = np.flatnonzero(parts.held_out)
        rows = rows[:: max(1, -(-rows.size // rules.MAX_MEASURED))]
        contexts = {name: column[rows] for name, column in data.items()}
        held_out = HeldOutReadings(data["reading_cm"][rows], contexts, _units(parts.runs[rows]))
        can = usable(model, held_out)
        held_out = held_out.take(can)
        names = [name for name in varying(held_out.contexts) if name not in NO_SLICES]
        return cls(
            model,
            data,
            parts,
            held_out,
            partitions(held_out.contexts, names),
            float(1.0 - can.mean()),
            settings,
            readings,
            (*readings.messages, *messages, *parts.messages),
        )

    def known_to(self, model: Model) -> "Comparison":
        """The comparison on those held-out readings of which the columns are known that a model's effects need."""
        contexts = self.held_out.contexts
        rows = KnownRows.of(model, self.data).needed(model, contexts).rows
        if rows.all():
            return self
        return replace(
            self, held_out=self.held_out.take(rows), partitions=[each.take(rows) for each in self.partitions]
        )


@dataclass(frozen=True)
class MeasuredGap:
    """The gap of one model on the held-out readings that it can give.

    Attributes
    ----------
    readings, partitions
        Those readings, and slices of them.
    replicates, measures
        Of the model.
    impossible
        Share of the held-out readings that it cannot give.
    """

    readings: HeldOutReadings
    partitions: list[Partition]
    replicates: Replicates
    measures: Measures
    impossible: float

    @classmethod
    def of(cls, model: Model, comparison: Comparison, rng: np.random.Generator) -> "MeasuredGap":
        """Measure a model."""
        can = usable(model, comparison.held_out)
        held_out = comparison.held_out.take(can)
        parts = comparison.partitions if can.all() else [each.take(can) for each in comparison.partitions]
        drawn = replicates(model, held_out, parts, rules.REPLICATES, rng)
        return cls(held_out, parts, drawn, measure(model, held_out, parts, drawn), float(1.0 - can.mean()))


def with_least_weights(model: Model) -> tuple[Model, list[str]]:
    """The model with no kind of reading at a share of 0, and a message if that changed it."""
    weights = model.sensor.reading_model.weights
    shares = weights.model_dump()
    missing = [name for name, share in shares.items() if share < rules.MIN_WEIGHT]
    if not missing:
        return model, []
    raised = {name: max(share, rules.MIN_WEIGHT) for name, share in shares.items()}
    total = sum(raised.values())
    changed = weights.model_copy(update={name: share / total for name, share in raised.items()})
    mixture = model.sensor.reading_model.model_copy(update={"weights": changed})
    sensor = model.sensor.model_copy(update={"reading_model": mixture})
    text = (
        f"The model gives {' and '.join(missing)} readings a share of 0; {rules.MIN_WEIGHT:g} is used, since a reading "
        "of probability 0 would decide the comparison alone."
    )
    return replace(model, sensor=sensor), [text]


def compare(comparison: Comparison, date: str, report: Progress) -> GapFindings:
    """Where readings and model disagree, on the held-out runs; `date` is recorded."""
    settings = comparison.settings
    rng = np.random.default_rng([settings.seed, 1])
    report("simulating replicates of the readings", 0.05)
    before = MeasuredGap.of(comparison.model, comparison, rng)
    report("comparing slices of context", 0.15)
    slices = ranked(comparison.model, before.readings, before.partitions, before.replicates, before.measures.fits, rng)
    return GapFindings(
        verdict=None,
        rows=len(comparison.readings.data),
        runs=int(np.unique(comparison.data["run"]).size),
        gap=_gap(before, comparison.impossible),
        calibration=comparison.readings.calibration,
        slices=slices,
        training_runs=comparison.splits.training_runs,
        held_out_runs=comparison.splits.held_out_runs,
        splits=len(comparison.splits),
        sources=comparison.readings.sources,
        settings=settings,
        messages=comparison.messages,
        date=date,
        selection_path=(PathStep("", before.measures.nats.value, before.measures.log_score),),
    )


def name(comparison: Comparison, findings: GapFindings, report: Progress) -> tuple[GapFindings, ExtendedModels]:
    """Name what is missing, with alternatives; splits of the runs validate it."""
    known = KnownRows.of(comparison.model, comparison.data)
    named = _named(comparison, known.rows, known.unasked, report)
    needed = known.needed(named.models.final_fit, comparison.data)
    if needed.rows.sum() > known.rows.sum():
        # Columns that no effect needs may be blank, so that there are more readings.
        unneeded = [*known.unasked, *(each for each in known.columns if each not in needed.columns)]
        named = replace(_named(comparison, needed.rows, unneeded, report), not_testable=named.not_testable)
        needed = needed.needed(named.models.final_fit, comparison.data)
    blank = [f"{each} is blank in most readings, so nothing is asked of it." for each in known.unasked]
    findings = replace(
        findings,
        effects=named.effects,
        unknown=named.unknown,
        calibration=(*findings.calibration, *named.calibration),
        not_testable=named.not_testable,
        detectable=named.detectable,
        p_value=named.p_value,
        messages=(
            *findings.messages,
            *named.messages,
            *filter(None, (needed.message, *blank)),
            *(f"{term} was dropped: {why}." for term, why in named.dropped),
        ),
    )
    return findings, named.models


def _named(comparison: Comparison, rows: NDArray[np.bool_], without: Sequence[str], report: Progress) -> NamedModel:
    """What is missing, from some of the readings and without some of the columns."""
    settings = comparison.settings
    return name_effects(
        comparison.model,
        {key: each[rows] for key, each in comparison.data.items() if key not in ("reading_cm", *without)},
        comparison.data["reading_cm"][rows],
        comparison.splits.take(rows),
        np.random.default_rng([settings.seed, 2]),
        alpha=settings.alpha,
        max_terms=settings.max_effects,
        report=lambda what, share: report(what, 0.2 + 0.6 * share),
    )


def add(comparison: Comparison, findings: GapFindings, models: ExtendedModels, report: Progress) -> GapFindings:
    """Measure the gap that is left with what was named, and reach a verdict."""
    report("measuring what is left of the gap", 0.82)
    model = models.training_fit
    comparison = comparison.known_to(model)
    after = MeasuredGap.of(model, comparison, np.random.default_rng([comparison.settings.seed, 3]))
    report("measuring the gap after each step", 0.95)
    scores = [(step.added, _log_score(step.model, comparison.held_out)) for step in models.path if step.added]
    # The last step is the gap that was measured; each step before it had what the later ones gain.
    left = after.measures.nats.value
    later = [PathStep(added, max(left + scores[-1][1] - score, 0.0), score) for added, score in scores]
    assert findings.gap is not None
    findings = replace(
        findings,
        gap=_gap(after, comparison.impossible, findings.gap),
        selection_path=(*findings.selection_path, *later),
        slices=remeasured(findings.slices, model, after.readings, after.partitions, after.measures.fits),
    )
    decided = verdict(findings, comparison.model)
    return replace(
        findings,
        verdict=decided,
        age=reading_age(findings, model, after.readings),
        causes=possible_causes(findings.calibration, comparison.model, comparison.data),
    )


def _log_score(model: Model, readings: HeldOutReadings) -> float:
    return float(np.maximum(model.log_prob(readings.reading_cm, readings.contexts), np.log(1e-12)).mean())


def _units(runs: NDArray[np.str_]) -> NDArray[np.intp]:
    """Runs, or where they are few, blocks of consecutive readings of them."""
    names, unit, counts = np.unique(runs, return_inverse=True, return_counts=True)
    if names.size >= rules.UNITS_FROM_RUNS:
        return np.asarray(unit, dtype=np.intp)
    length = max(int(np.ceil(runs.size / rules.UNIT_BLOCKS)), rules.MIN_BLOCK_READINGS)
    place = np.zeros(runs.size, dtype=np.intp)
    for i in range(names.size):
        rows = np.flatnonzero(unit == i)
        place[rows] = np.arange(rows.size) // length
    _, blocks = np.unique(unit * (int(counts.max()) // length + 1) + place, return_inverse=True)
    return np.asarray(blocks, dtype=np.intp)


def _gap(measured: MeasuredGap, impossible: float, before: Gap | None = None) -> Gap:
    """The gap of the given model, or with `before` that of the extended one.

    As long as nothing was added, the interval is that of the gap itself.
    """
    numbers, floor = measured.measures.numbers(), measured.replicates.noise_floor

    def number(key: str, earlier: Measure | None) -> Measure:
        now = numbers[key]
        value, low, high = (_known(each) for each in (now.value, now.low, now.high))
        if earlier is None:
            return Measure(value, None, _known(floor[key]), low, high)
        return Measure(earlier.before, value, _known(floor[key]), low, high)

    code_before, code_after = (1.0 + share / rules.MIN_WEIGHT for share in (impossible, measured.impossible))
    odds = before.odds if before is not None else None
    return Gap(
        number("nats", before.nats_per_reading if before else None),
        number("bias_cm", before.bias_cm if before else None),
        number("spread_ratio", before.spread_ratio if before else None),
        OddsMeasures(
            number("short", odds.short if odds else None),
            number("missed", odds.missed if odds else None),
            number("random", odds.random if odds else None),
            Measure(code_before, None if before is None else code_after, 1.0),
        ),
    )


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
