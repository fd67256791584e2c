"""The gap before naming, by slices of context, and what is left of it after: the steps compare and add.

A comparison and models enter; `GapFindings` with the verdict leave. Both gaps are measured on the same half of the
runs, the second one with a fit of the other half alone.
"""

from dataclasses import dataclass, replace

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.age import reading_age
from msp_lab.gap.causes import possible_causes
from msp_lab.gap.cells import Partition
from msp_lab.gap.findings import Gap, GapFindings, Measure, OddsMeasures, PathStep
from msp_lab.gap.intake import Comparison
from msp_lab.gap.measures import HeldOutReadings, Measures, Replicates, measure, replicates, usable
from msp_lab.gap.naming import ExtendedModels
from msp_lab.gap.problem import Progress
from msp_lab.gap.slices import ranked, remeasured
from msp_lab.gap.verdict import verdict
from msp_sim.model.model import Model


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
