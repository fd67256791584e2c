"""The gap before naming, by slices of context, and what is left of it after: the steps compare and add.

`GapFindings` have the verdict on a comparison with its models. Both gaps are measured on the same half of the runs, the
second one with a fit of the other half alone.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.age import reading_age
from msp_lab.gap.causes import possible_causes
from msp_lab.gap.findings import Gap, GapFindings, Measure, OddsMeasures, PathStep
from msp_lab.gap.intake import Comparison
from msp_lab.gap.measures import Measures, log_score, measure, replicates, usable
from msp_lab.gap.naming import ExtendedModels
from msp_lab.gap.problem import Progress
from msp_lab.gap.slices import ranked, remeasured
from msp_lab.gap.verdict import verdict
from msp_lab.gap.where import located
from msp_lab.mixture_fit.parameters import MIN_WEIGHT
from msp_sim.model.model import Model


def compare(comparison: Comparison, date: str, report: Progress) -> GapFindings:
    """Where readings and model disagree, on the held-out runs; `date` is recorded."""
    settings = comparison.settings
    rng = np.random.default_rng([settings.seed, 1])
    report("simulating replicates of the readings", 0.05)
    before, _ = _measured(comparison.model, comparison, rng)
    report("comparing slices of context", 0.15)
    return GapFindings(
        verdict=None,
        rows=len(comparison.readings.data),
        runs=np.unique(comparison.data["run"]).size,
        gap=_gap(before, comparison.impossible),
        calibration=comparison.readings.calibration,
        slices=ranked(before, rng),
        training_runs=comparison.splits.training_runs,
        held_out_runs=comparison.splits.held_out_runs,
        splits=len(comparison.splits),
        sources=comparison.readings.sources,
        settings=settings,
        messages=comparison.messages,
        date=date,
        selection_path=(PathStep("", before.numbers["nats_per_reading"].value, before.log_score),),
    )


def add(comparison: Comparison, findings: GapFindings, models: ExtendedModels, report: Progress) -> GapFindings:
    """Measure the gap that is left with what was named, and reach a verdict."""
    report("measuring what is left of the gap", 0.82)
    model = models.training_fit
    comparison = comparison.known_to(model)
    after, impossible = _measured(model, comparison, np.random.default_rng([comparison.settings.seed, 3]))
    report("measuring the gap after each step", 0.95)
    scores = [(step.added, log_score(step.model, comparison.held_out)) for step in models.path if step.added]
    left, given = after.numbers["nats_per_reading"].value, findings.nats.before or 0.0
    findings = replace(
        findings,
        gap=_gap(after, impossible, findings.gap),
        selection_path=(*findings.selection_path, *later_steps(given, left, scores)),
        slices=remeasured(findings.slices, after),
    )
    findings = replace(findings, verdict=verdict(findings, comparison.model))
    return replace(
        located(findings, model, len(comparison.model.effects), after),
        age=reading_age(findings, model, after.readings),
        causes=possible_causes(findings.calibration, comparison.model, comparison.data),
    )


def later_steps(given: float, left: float, scores: Sequence[tuple[str, float]]) -> Iterator[PathStep]:
    """The selection path after the given model: what was added, and the gap and the log score with it.

    The last step is the gap that was measured; one before it had what the later ones gain, and no more than the given
    model: slices do not show all that a score does.
    """
    for added, score in scores:
        yield PathStep(added, min(max(left + scores[-1][1] - score, 0.0), max(given, left)), score)


def _measured(model: Model, comparison: Comparison, rng: np.random.Generator) -> tuple[Measures, float]:
    """The gap of a model on the held-out readings that it can give, and the share of those that it cannot."""
    can = usable(model, comparison.held_out)
    held_out, parts = comparison.held_out.take(can), [each.take(can) for each in comparison.partitions]
    drawn = replicates(model, held_out, parts, rules.REPLICATES, rng)
    return measure(model, held_out, parts, drawn), float(1.0 - can.mean())


def _gap(measured: Measures, impossible: float, before: Gap | None = None) -> Gap:
    """The gap of the given model, or with `before` that of the extended one; `impossible` is the share it cannot give.

    As long as nothing was added, the interval is that of the gap itself.
    """

    def number(name: str) -> Measure:
        now = measured.numbers[name]
        value, low, high, floor = map(_known, (now.value, now.low, now.high, measured.noise_floor[name]))
        if before is None:
            return Measure(value, None, floor, low, high)
        return Measure(before.measures[name].before, value, floor, low, high)

    odds_of_code = 1.0 + impossible / MIN_WEIGHT
    code = Measure(odds_of_code, None, 1.0) if before is None else replace(before.odds.code, after=odds_of_code)
    odds = OddsMeasures(number("odds_short"), number("odds_missed"), number("odds_random"), code)
    return Gap(number("nats_per_reading"), number("bias_cm"), number("spread_ratio"), odds)


def _known(value: float) -> float | None:
    return None if np.isnan(value) else float(value)
