"""The gap before naming, by slices of context, and what is left of it after: the steps compare and add.

`GapFindings` have the verdict on a comparison with its models. Both gaps are measured on the same half of the runs, the
second one with a fit of the other half alone.

How old a reading is when it is used follows: latency and repeated readings are two effects with two numbers, but what
flies feels their sum. And why a number of the base may be another one, where the readings cannot say: the effects that
would change it, with the column that did not vary. A gap that calibration closes is absorbed, not explained: more
scatter over a throttle that never changes is rotor noise or is not.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.alternatives import SPANS
from msp_lab.gap.findings import (
    CalibrationFinding,
    Gap,
    GapFindings,
    Measure,
    OddsMeasures,
    PathStep,
    PossibleCause,
    ReadingAge,
)
from msp_lab.gap.intake import Comparison
from msp_lab.gap.measures import HeldOutReadings, Measures, log_score, measure, replicates, usable
from msp_lab.gap.naming import ExtendedModels
from msp_lab.gap.problem import Progress
from msp_lab.gap.runs import known_values, reading_before
from msp_lab.gap.slices import located, ranked, remeasured
from msp_lab.gap.verdict import verdict
from msp_lab.mixture_fit.parameters import MIN_WEIGHT
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import TRUE_RANGE, WORD_COLUMNS, Channel, Effect
from msp_sim.effects.latency import LATENCY
from msp_sim.effects.range_scale import RANGE_SCALE
from msp_sim.effects.stale import STALE
from msp_sim.model.model import Model

CHANNELS: Mapping[str, Channel] = {
    "offset_cm": "bias",
    "sigma_cm": "spread",
    "short": "short",
    "missed": "missed",
    "random": "random",
}
"""What a number of the base changes; the last part of its name. Other numbers (correlation, tails) have no such causes.
"""
VARIED_SHARE = 1.0 / 3.0
"""A column has varied enough to show an effect if nine of ten readings spread over this share of what can reasonably be
varied (`SPANS`); below that a change of the base's number fits as well. With 1/4 to 1/2 the recorded flights of the
tests read the same."""


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
    held_out, parts = comparison.held_out.take(can), [part.take(can) for part in comparison.partitions]
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


def reading_age(findings: GapFindings, model: Model, readings: HeldOutReadings) -> ReadingAge | None:
    """Add the mean hold to the latency; None where not both were found.

    Parameters
    ----------
    findings
        With the effects.
    model
        With what was added.
    readings
        With times, on which the hold is measured.
    """
    found: Mapping[str, float] = {
        effect.name: next(iter(effect.parameters.values())).value for effect in findings.confirmed if effect.parameters
    }
    if not {LATENCY.name, STALE.name} <= found.keys() or "time_s" not in readings.contexts:
        return None
    return ReadingAge(found[LATENCY.name] / 1000.0, mean_hold_s(model, readings))


def mean_hold_s(model: Model, readings: HeldOutReadings) -> float:
    """Mean time since a reading's value was new [s].

    A reading is a repeat with the probability p that it has under the model with repeats and without, so that a value
    that comes twice by itself does not count as held: h_i = p_i (h_before + t_i - t_before).

    Parameters
    ----------
    model
        With `stale`.
    readings
        With times.
    """
    fresh = replace(model, effects=tuple(term for term in model.effects if term.effect is not STALE))
    log_share = np.log1p(-_share(model)) + fresh.log_prob(readings.reading_cm, readings.contexts)
    repeat = -np.expm1(np.minimum(log_share - model.log_prob(readings.reading_cm, readings.contexts), 0.0))
    n = len(readings)
    before, elapsed_s = reading_before(readings.contexts, n)
    hold_s = np.zeros(n)
    for i in np.argsort(readings.contexts["time_s"], kind="stable").tolist():
        j = int(before[i])
        if j >= 0 and readings.reading_cm[i] == readings.reading_cm[j]:
            hold_s[i] = repeat[i] * (hold_s[j] + elapsed_s[i])
    return float(hold_s.mean())


def _share(model: Model) -> float:
    return next(term.values["share"] for term in model.effects if term.effect is STALE)


def possible_causes(
    calibration: Sequence[CalibrationFinding], model: Model, contexts: Mapping[str, Any]
) -> tuple[PossibleCause, ...]:
    """Effects that calibration may have absorbed, those first whose column explains most numbers.

    A scale, which the range would show, comes before all others: it is the plainest.

    Parameters
    ----------
    calibration
        Numbers of the base that were found to be others.
    model
        The given model.
    contexts
        Columns of the readings, (n,) each.
    """
    found = [cause for number in calibration for cause in _causes_of(number, model, contexts)]
    columns = [cause.column for cause in found]
    found.sort(key=lambda cause: (not cause.recorded, -columns.count(cause.column)))
    offset_cm = next((number.after for number in calibration if number.name == "offset_cm"), None)
    if offset_cm is not None and _may_be_a_scale(offset_cm, model, contexts):
        found.insert(0, PossibleCause("offset_cm", RANGE_SCALE.name, TRUE_RANGE, True, RANGE_SCALE.experiment))
    return tuple(found)


def _may_be_a_scale(offset_cm: float, model: Model, contexts: Mapping[str, Any]) -> bool:
    """Whether a scale that is the offset at the mean range would have been an alternative to it."""
    if any(term.effect is RANGE_SCALE for term in model.effects) or TRUE_RANGE not in contexts:
        return False
    range_cm = known_values(contexts[TRUE_RANGE])
    differ_cm = offset_cm * (range_cm / range_cm.mean() - 1.0)
    nats = 0.5 * float((differ_cm**2).sum()) / model.sensor.reading_model.sigma_cm**2
    return nats < rules.ALTERNATIVE_NATS


def _causes_of(number: CalibrationFinding, model: Model, contexts: Mapping[str, Any]) -> Iterator[PossibleCause]:
    channel = CHANNELS.get(number.name.rpartition(".")[2])
    if channel == "spread" and (number.after or 0.0) < (number.before or 0.0):
        # Effects add to the scatter.
        return
    known = {term.effect.name for term in model.effects}
    for effect in CATALOGUE.values():
        if channel not in effect.channels or effect.name in known or not effect.happens_to(model.sensor):
            continue
        lacking = [column for column in _special(effect) if not _varied(column, contexts)]
        if len(lacking) == 1:
            yield PossibleCause(number.name, effect.name, lacking[0], lacking[0] in contexts, effect.experiment)


def _special(effect: Effect) -> list[str]:
    """Columns that show the effect; a word cannot be varied, and the range always is."""
    return [column for column in effect.requires if column not in WORD_COLUMNS and column != TRUE_RANGE]


def _varied(column: str, contexts: Mapping[str, Any]) -> bool:
    if column not in contexts:
        return False
    values = known_values(contexts[column])
    if not values.size:
        return False
    spread = float(np.ptp(np.quantile(values, [0.05, 0.95])))
    if column not in SPANS:
        return spread > 0.0
    low, high = SPANS[column]
    return spread >= VARIED_SHARE * (high - low)
