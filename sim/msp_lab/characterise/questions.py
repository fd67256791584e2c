"""Does it matter? Questions about material, temperature, vibration, crosstalk and external ultrasound.

Points of an experiment and points to compare them with enter, `Question`s leave: four effects each, with an interval,
a p-value corrected for all that was asked (Holm), a verdict that may be 'cannot tell', and the smallest effect that
these data would have shown. Readings of a point share its set-up, so the bias and the spread are compared from point to
point at equal ranges; shares of readings get the variance between points where it exceeds that of independent readings.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.optimize import brentq
from scipy.special import logit

from msp_lab.characterise.estimates import detectable, holm, student
from msp_lab.characterise.experiments import QUESTIONS
from msp_lab.characterise.findings import NAMES, FactorEffect, Metric, Question, Verdict
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.characterise.temperature import ROOM_C, ROOM_WITHIN_C
from msp_range.arrays import Array

LEVEL = 0.05
"""Family-wise false-positive rate over all questions (Holm)."""
BIAS_BOUND_CM = 1.0
"""A smaller change of the mean error does not matter [cm]: the step of a sensor that reports whole centimetres. A
larger bound calls more influences irrelevant."""
SPREAD_BOUND = 1.5
"""Nor does a spread that changes by a smaller factor: a filter's output changes by less than its own error."""
ODDS_BOUND = 2.0
"""Nor odds of a missed reading or an outlier that change by a smaller factor ..."""
SHARE_BOUND = 0.01
"""... or by less than this share of all readings: one second in 100 at any rate."""
STEP_SPREAD_CM = 1.0 / math.sqrt(12.0)
"""Spread of the rounding to whole centimetres; a smaller one counts as this."""
FEW_RANGES = 4
"""With fewer common ranges the scatter between ranges is not known, and that between set-ups is used."""
MAX_VARIANCE_RATIO = 1.5
"""Ratio of the variance between points to that of independent readings above which a share's test counts points and
not readings."""
MAX_CM, MAX_RATIO = 100.0, 1000.0
"""If the smallest detectable effect is larger than this, it is given as unknown [cm, ratio]."""
MIN_SCATTER_CM = 0.05
"""Smallest scatter between set-ups that is assumed [cm]: equal readings at two points do not prove 0."""
CROSSTALK = {"crosstalk_simultaneous": "simultaneous", "crosstalk_sequential": "sequential"}
"""Experiments with two sensors, each with its own question -> name of their level."""


BOUNDS: dict[Metric, float] = {
    "bias": BIAS_BOUND_CM,
    "spread": SPREAD_BOUND,
    "missed": ODDS_BOUND,
    "outliers": ODDS_BOUND,
}


class _Test(NamedTuple):
    """An effect on the scale where it is roughly normal: centimetres, or the logarithm of a ratio."""

    value: float
    error: float
    freedom: float
    n: int
    of: str
    p_value: float
    """p-value of no effect."""
    small_share: bool = False
    """A share that changes by less than `SHARE_BOUND`, by its 90 % interval: small by itself."""
    detectable: Callable[[float], float] | None = None
    """Smallest effect that the data would have shown, by the level of the test; None: a t-test's."""

    def p_alike(self, metric: Metric) -> float:
        """p-value of an effect that is as large as the bound or larger: the greater of two one-sided tests."""
        bound = BOUNDS[metric] if metric == "bias" else math.log(BOUNDS[metric])
        by_value = float(stats.t.sf((bound - abs(self.value)) / self.error, self.freedom))
        return min(by_value, LEVEL / 1e3) if self.small_share else by_value


def answer_questions(points: Sequence[PointResult]) -> tuple[Question, ...]:
    """All questions that every set-up of the data allows, with p-values corrected for all of them together."""
    asked = [each for name in QUESTIONS for each in _compared(name, [p for p in points if p.condition == name], points)]
    tests = [{metric: _test(metric, each) for metric in NAMES} for each in asked]
    done = [(metric, test) for row in tests for metric, test in row.items() if test is not None]
    different = iter(holm([test.p_value for _, test in done]))
    alike = iter(holm([test.p_alike(metric) for metric, test in done]))
    return tuple(
        _answered(
            question,
            tuple(
                FactorEffect(metric, None, None, None, BOUNDS[metric], "cannot tell", None)
                if test is None
                else _effect(metric, test, next(different), next(alike), LEVEL / len(done))
                for metric, test in row.items()
            ),
        )
        for question, row in zip(asked, tests, strict=True)
    )


def _compared(name: str, points: Sequence[PointResult], everything: Sequence[PointResult]) -> Iterable[Question]:
    """One question for each level of an experiment, and for each sensor where two are at work."""
    by_sensor = name in CROSSTALK
    for sensor in sorted({p.sensor for p in points}) if by_sensor else [""]:
        here = [p for p in points if not by_sensor or p.sensor == sensor]
        reference_level = _reference_level(name, here)
        if reference_level is not None:
            reference_name, reference = reference_level, [p for p in here if p.level == reference_level]
        else:
            reference_name, reference = _baseline(name, sensor, everything)
        for level in dict.fromkeys(p.level for p in here if p.level != reference_level):
            varied = [p for p in here if p.level == level]
            ranges = {p.place_cm for p in varied} & {p.place_cm for p in reference}
            yield Question(
                name=name,
                question=QUESTIONS[name].question,
                level=level or CROSSTALK.get(name, name),
                reference=reference_name,
                sensor=sensor,
                pairs=len(ranges),
                effects=(),
                verdict="cannot tell",
                answer="",
                points=tuple(varied),
                reference_points=tuple(p for p in reference if p.place_cm in ranges),
            )


def _baseline(name: str, sensor: str, everything: Sequence[PointResult]) -> tuple[str, list[PointResult]]:
    """What an experiment without a level of reference is compared with: the same sensor's points, where it has some."""
    baseline = [p for p in everything if p.condition == "baseline"]
    own = [p for p in baseline if p.sensor == sensor]
    if own or not sensor:
        return "baseline", own or baseline
    waiting = [p for p in everything if p.condition == "crosstalk_sequential" and p.sensor == sensor]
    if name == "crosstalk_simultaneous" and waiting:
        return "sequential", waiting
    return "the baseline of another sensor", baseline


def _reference_level(name: str, points: Sequence[PointResult]) -> str | None:
    """The level of the experiment itself that the others are compared with; None: the baseline."""
    levels = list(dict.fromkeys(p.level for p in points))
    if name == "material":
        return next((each for word in ("plywood", "wood") for each in levels if word in each.lower()), None)
    if name == "temperature":
        known = [(abs(p.air_temperature_c - ROOM_C), p.level) for p in points if p.air_temperature_c is not None]
        return min(known)[1] if known and min(known)[0] < ROOM_WITHIN_C else None
    if name == "external_interference":
        return "quiet" if "quiet" in levels else None
    if name == "vibration":
        return next((each for each in levels if each in ("0 Hz", "")), None) if len(levels) > 1 else None
    return None


def _test(metric: Metric, question: Question) -> _Test | None:
    if metric == "bias":
        return _paired(question, lambda p: None if p.error is None else p.error.value)
    if metric == "spread":
        return _paired(question, _log_spread)
    if metric == "missed":
        return _odds(question, lambda p: p.missed, lambda p: p.readings)
    return _odds(question, lambda p: p.outliers, lambda p: p.readings - p.missed)


def _log_spread(point: PointResult) -> float | None:
    return None if point.spread is None else math.log(math.hypot(point.spread.value, STEP_SPREAD_CM))


def _paired(question: Question, value: Callable[[PointResult], float | None]) -> _Test | None:
    """Mean difference at equal ranges. Its error is the scatter from range to range or, with few of them, that of
    set-ups at one range, of both sides alike: the set-ups of the reference have it too."""
    varied, reference = _by_range(question.points, value), _by_range(question.reference_points, value)
    common = sorted(varied.keys() & reference.keys())
    differences = np.array([np.mean(varied[each]) - np.mean(reference[each]) for each in common])
    count, freedom = len(common), len(common) - 1
    variance = float(differences.var(ddof=1)) / count if freedom > 0 else 0.0
    sides = [np.array(side[each]) for each in common for side in (varied, reference)]
    of_set_ups = sum(side.size - 1 for side in sides)
    if len(common) < FEW_RANGES and of_set_ups > freedom:
        count, freedom = sum(len(varied[each]) for each in common), of_set_ups
        scatter = sum(float(((side - side.mean()) ** 2).sum()) for side in sides) / freedom
        variance = scatter * sum(1.0 / side.size for side in sides) / len(common) ** 2
    if freedom < 1:
        return None
    error = math.sqrt(variance + MIN_SCATTER_CM**2 / count)
    mean = float(differences.mean())
    return _Test(mean, error, freedom, count, "points", 2.0 * float(stats.t.sf(abs(mean) / error, freedom)))


def _by_range(points: Sequence[PointResult], value: Callable[[PointResult], float | None]) -> dict[float, list[float]]:
    found: dict[float, list[float]] = {}
    for point in points:
        one = value(point)
        if one is not None:
            found.setdefault(point.place_cm, []).append(one)
    return found


class _Counts(NamedTuple):
    """Readings at some points of which something is true, and all readings there."""

    counts: Array
    of: Array

    @classmethod
    def at(
        cls, points: Iterable[PointResult], count: Callable[[PointResult], int], of: Callable[[PointResult], int]
    ) -> "_Counts":
        rows = np.array([(count(p), of(p)) for p in points if of(p)], dtype=float).reshape(-1, 2)
        return cls(rows[:, 0], rows[:, 1])

    @property
    def table(self) -> tuple[int, int]:
        """How many are, and how many are not."""
        true = int(self.counts.sum())
        return true, int(self.of.sum()) - true

    @property
    def share(self) -> float:
        return float(self.counts.sum() / self.of.sum())

    @property
    def overdispersion(self) -> float:
        """Variance of the points' counts over that of independent readings, at least 1."""
        if self.of.size < 2 or not 0.0 < self.share < 1.0:
            return 1.0
        expected = self.share * self.of
        squares = float(((self.counts - expected) ** 2 / (expected * (1.0 - self.share))).sum())
        return max(squares / (self.of.size - 1), 1.0)


def _odds(question: Question, count: Callable[[PointResult], int], of: Callable[[PointResult], int]) -> _Test | None:
    """Logarithm of the odds ratio over all readings at equal ranges, with the variance between points."""
    ranges = {p.place_cm for p in question.reference_points}
    varied = _Counts.at((p for p in question.points if p.place_cm in ranges), count, of)
    reference = _Counts.at(question.reference_points, count, of)
    if not varied.of.size or not reference.of.size:
        return None
    over_reference = reference.overdispersion
    # The points of an external source differ by their dose, which is the effect itself and no reason to doubt it.
    over = over_reference if question.name == "external_interference" else varied.overdispersion
    (a, b), (c, d) = varied.table, reference.table
    n, m = a + b, c + d
    value = math.log((a + 0.5) * (d + 0.5) / ((b + 0.5) * (c + 0.5)))
    error = math.sqrt(over * (1.0 / (a + 0.5) + 1.0 / (b + 0.5)) + over_reference * (1.0 / (c + 0.5) + 1.0 / (d + 0.5)))
    freedom = varied.of.size + reference.of.size - 2.0
    if max(over, over_reference) > MAX_VARIANCE_RATIO and freedom >= 1.0:
        # By ranks: one point that is unlike all others is no evidence.
        shares = varied.counts / varied.of, reference.counts / reference.of
        p_value = float(stats.mannwhitneyu(*shares, method="asymptotic").pvalue)
    else:
        freedom, p_value = math.inf, float(stats.fisher_exact([[a, b], [c, d]])[1])
    width = 1.645 * math.sqrt(over * (a + 0.5) * (b + 0.5) / n**3 + over_reference * (c + 0.5) * (d + 0.5) / m**3)
    small = abs(varied.share - reference.share) + width < SHARE_BOUND
    shown = partial(_detectable_odds, (c + 0.5) / (m + 1.0), n / over, m / over_reference)
    return _Test(value, error, freedom, n + m, "readings", p_value, small, shown)


def _detectable_odds(share: float, n: float, m: float, level: float) -> float:
    """Logarithm of the smallest odds ratio above 1 that these many readings show with 80 % probability."""
    z = detectable(1.0, math.inf, level)

    def excess(other: float) -> float:
        return other - share - z * math.sqrt(other * (1.0 - other) / n + share * (1.0 - share) / m)

    if excess(1.0) <= 0.0:
        return math.inf
    other = min(float(brentq(excess, share, 1.0)), 1.0 - 1e-9)
    return float(logit(other) - logit(share))


def _effect(metric: Metric, test: _Test, different: float, alike: float, level: float) -> FactorEffect:
    """What was found of an effect, by the p-values after Holm."""
    shown = detectable(test.error, test.freedom, level) if test.detectable is None else test.detectable(level)
    estimate = IntervalEstimate.about(test.value, student(test.error, test.freedom), "cm", test.n, test.of)
    largest = MAX_CM
    if metric != "bias":
        estimate, shown, largest = replace(estimate.mapped(_exp), unit=""), _exp(shown), MAX_RATIO
    return FactorEffect(
        metric=metric,
        estimate=estimate,
        p_value=test.p_value,
        p_adjusted=different,
        bound=BOUNDS[metric],
        verdict="does not matter" if alike < LEVEL else "matters" if different < LEVEL else "cannot tell",
        # What is so large that the data show nothing is not known.
        smallest_detectable=shown if shown < largest else None,
    )


def _exp(value: float) -> float:
    """A ratio from its logarithm; e^500 is a number still, and 'anything' enough."""
    return math.exp(min(max(value, -500.0), 500.0))


def _answered(question: Question, effects: tuple[FactorEffect, ...]) -> Question:
    by: dict[Verdict, list[FactorEffect]] = {"matters": [], "does not matter": [], "cannot tell": []}
    for each in effects:
        by[each.verdict].append(each)
    verdict: Verdict = "matters" if by["matters"] else "cannot tell" if by["cannot tell"] else "does not matter"
    who = f" for {question.sensor}" if question.sensor else ""
    answer = f"{question.level} against {question.reference}{who}: {verdict}"
    if verdict == "matters":
        answer += f": {'; '.join(map(_size, by['matters']))}"
    elif verdict == "does not matter":
        answer += (
            f" beyond {BIAS_BOUND_CM:g} cm of bias, a factor {SPREAD_BOUND:g} of spread and {ODDS_BOUND:g} of the odds "
            f"(or {SHARE_BOUND:.0%} of the readings) of missed and outliers"
        )
        seen = [_size(each) for each in effects if each.p_adjusted is not None and each.p_adjusted < LEVEL]
        answer += f"; within that there is {'; '.join(seen)}" if seen else ""
    else:
        answer += f": {'; '.join(map(_doubt, by['cannot tell']))}"
        settled = ", ".join(each.metric for each in by["does not matter"])
        answer += f"; {settled}: does not matter" if settled else ""
    return replace(question, effects=effects, verdict=verdict, answer=answer)


def _size(effect: FactorEffect) -> str:
    estimate = effect.estimate
    assert estimate is not None
    low, high = estimate.low, estimate.high
    if effect.metric == "bias":
        return f"bias {estimate.value:+.2f} cm ({low:+.2f} to {high:+.2f})"
    return f"{NAMES[effect.metric]} times {estimate.value:.3g} ({low:.3g} to {high:.3g})"


def _doubt(effect: FactorEffect) -> str:
    if effect.estimate is None:
        return f"{effect.metric}: no two points to compare"
    if effect.smallest_detectable is None:
        return f"{_size(effect)}; these data could show nothing"
    unit = "times" if effect.is_ratio else "cm"
    return f"{_size(effect)}; these data would have shown {effect.smallest_detectable:.2g} {unit} or more"
