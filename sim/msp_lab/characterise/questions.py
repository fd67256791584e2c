"""Does it matter? Questions about material, temperature, vibration, crosstalk and external ultrasound.

Points of an experiment are compared with others; each `Question` has four effects with an interval, a p-value corrected
for all that was asked (Holm), a verdict that may be 'cannot tell', and the smallest effect that these data would have
shown. Readings of a point share its set-up, so the bias and the spread are compared from point to point at equal
ranges; shares of readings get the variance between points where it exceeds that of independent readings.
"""

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
from scipy import stats
from scipy.special import logit

from msp_lab.characterise.experiments import QUESTIONS
from msp_lab.characterise.findings import NAMES, VERDICTS, FactorEffect, Metric, Question
from msp_lab.characterise.point_findings import PointResult
from msp_lab.characterise.points import usual_target
from msp_lab.characterise.temperature import ROOM_C, ROOM_WITHIN_C
from msp_lab.estimates import IntervalEstimate, detectable, holm, student
from msp_range.arrays import Array

LEVEL = 0.05
"""Family-wise false-positive rate over all questions (Holm)."""
BOUNDS: dict[Metric, float] = {"bias": 1.0, "spread": 1.5, "missed": 2.0, "outliers": 2.0}
"""A smaller change does not matter: of the mean error [cm], the step of a sensor that reports whole centimetres; a
smaller factor of the spread, by which a filter's output changes by less than its own error; a smaller factor of the
odds of a missed reading or an outlier. Larger bounds call more influences irrelevant."""
SHARE_BOUND = 0.01
"""Nor do missed readings or outliers that change by less than this share of all readings: one second in 100."""
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
UNVARIED = {"vibration": ("0 Hz", ""), "external_interference": ("quiet",)}
"""Levels of an experiment at which nothing is varied, and with which the others are compared."""
CROSSTALK = {"crosstalk_simultaneous": "simultaneous", "crosstalk_sequential": "sequential"}
"""Experiments with two sensors, each with its own question -> name of their level."""


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
    asked = [question for name in QUESTIONS for question in _compared(name, points)]
    kinds = {"bias": _paired, "spread": _paired, "missed": _odds, "outliers": _odds}
    tests = [[(metric, kinds[metric](metric, question)) for metric in NAMES] for question in asked]
    done = [(metric, test) for results in tests for metric, test in results if test is not None]
    different = iter(holm([test.p_value for _, test in done]))
    alike = iter(holm([test.p_alike(metric) for metric, test in done]))

    def effect(metric: Metric, test: _Test | None) -> FactorEffect:
        if test is None:
            return FactorEffect(metric, None, None, None, BOUNDS[metric], "cannot tell", None)
        return _effect(metric, test, next(different), next(alike), LEVEL / len(done))

    return tuple(
        _answered(question, [effect(*each) for each in of_question])
        for question, of_question in zip(asked, tests, strict=True)
    )


def _compared(name: str, everything: Sequence[PointResult]) -> Iterable[Question]:
    """One question for each level of an experiment, and for each sensor where two are at work."""
    points = [p for p in everything if p.condition == name]
    for sensor in sorted({p.sensor for p in points}) if name in CROSSTALK else [""]:
        here = [p for p in points if sensor in ("", p.sensor)]
        own_level = _reference_level(name, here)
        if own_level is not None:
            called, reference = own_level, [p for p in here if p.level == own_level]
        else:
            called, reference = _baseline(name, sensor, everything)
        for level in dict.fromkeys(p.level for p in here if p.level != own_level):
            varied = [p for p in here if p.level == level]
            ranges = {p.place_cm for p in varied} & {p.place_cm for p in reference}
            yield Question(
                name=name,
                question=QUESTIONS[name].question,
                level=level or CROSSTALK.get(name, name),
                reference=called,
                sensor=sensor,
                pairs=len(ranges),
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
    if name == "temperature":
        known = [(abs(p.air_temperature_c - ROOM_C), p.level) for p in points if p.air_temperature_c is not None]
        distance_c, level = min(known, default=(math.inf, ""))
        return level if distance_c < ROOM_WITHIN_C else None
    if name == "material":
        return usual_target(levels)
    if name == "vibration" and len(levels) == 1:
        return None
    return next((level for level in levels if level in UNVARIED.get(name, ())), None)


def _paired(metric: Metric, question: Question) -> _Test | None:
    """Mean difference at equal ranges. Its error is the scatter from range to range or, with few of them, that of
    set-ups at one range, of both sides alike: the set-ups of the reference have it too."""
    varied, reference = _by_range(question.points, metric), _by_range(question.reference_points, metric)
    common = sorted(varied.keys() & reference.keys())
    if not common:
        return None
    sides = [np.array(side[place]) for place in common for side in (varied, reference)]
    means = np.array([side.mean() for side in sides])
    differences = means[::2] - means[1::2]
    count, freedom = len(common), len(common) - 1
    variance = float(differences.var(ddof=1)) / count if freedom else 0.0
    of_set_ups = sum(side.size - 1 for side in sides)
    if len(common) < FEW_RANGES and of_set_ups > freedom:
        count, freedom = sum(side.size for side in sides[::2]), of_set_ups
        scatter = sum(side.size * float(side.var()) for side in sides) / freedom
        variance = scatter * sum(1.0 / side.size for side in sides) / len(common) ** 2
    if not freedom:
        return None
    error = math.sqrt(variance + MIN_SCATTER_CM**2 / count)
    mean = float(differences.mean())
    return _Test(mean, error, freedom, count, "points", 2.0 * float(stats.t.sf(abs(mean) / error, freedom)))


def _by_range(points: Sequence[PointResult], metric: Metric) -> dict[float, list[float]]:
    """Mean errors, or logarithms of spreads, of the points at each range."""
    found = defaultdict(list)
    for point in points:
        if metric == "bias" and point.error is not None:
            found[point.place_cm].append(point.error.value)
        elif metric == "spread" and point.spread is not None:
            found[point.place_cm].append(math.log(math.hypot(point.spread.value, STEP_SPREAD_CM)))
    return found


def _counts(points: Iterable[PointResult], metric: Metric) -> tuple[Array, Array]:
    """Readings of which something is true, and all that can be, at each point that has any, (points,) each."""
    rows = [(p.missed, p.readings) if metric == "missed" else (p.outliers, p.readings - p.missed) for p in points]
    counts, of = np.array([row for row in rows if row[1]], dtype=float).reshape(-1, 2).T
    return counts, of


def _overdispersion(counts: Array, of: Array) -> float:
    """Variance of the points' counts over that of independent readings, at least 1."""
    share = counts.sum() / of.sum()
    if of.size < 2 or not 0.0 < share < 1.0:
        return 1.0
    squares = ((counts - share * of) ** 2 / (share * of * (1.0 - share))).sum()
    return max(float(squares) / (of.size - 1), 1.0)


def _odds(metric: Metric, question: Question) -> _Test | None:
    """Logarithm of the odds ratio over all readings at equal ranges, with the variance between points."""
    ranges = {p.place_cm for p in question.reference_points}
    counts, of = _counts((p for p in question.points if p.place_cm in ranges), metric)
    reference_counts, reference_of = _counts(question.reference_points, metric)
    if not of.size or not reference_of.size:
        return None
    over_reference = _overdispersion(reference_counts, reference_of)
    # The points of an external source differ by their dose, which is the effect itself and no reason to doubt it.
    over = over_reference if question.name == "external_interference" else _overdispersion(counts, of)
    n, m, true, reference_true = (int(each.sum()) for each in (of, reference_of, counts, reference_counts))
    table = np.array([[true, n - true], [reference_true, m - reference_true]])
    # Half a reading more of each kind: none of a kind is no certainty.
    (a, b), (c, d) = (table + 0.5).tolist()
    error = math.sqrt(over * (1.0 / a + 1.0 / b) + over_reference * (1.0 / c + 1.0 / d))
    freedom = of.size + reference_of.size - 2.0
    if max(over, over_reference) > MAX_VARIANCE_RATIO and freedom >= 1.0:
        # By ranks: one point that is unlike all others is no evidence.
        p_value = stats.mannwhitneyu(counts / of, reference_counts / reference_of, method="asymptotic")[1]
    else:
        freedom, p_value = math.inf, stats.fisher_exact(table)[1]
    width = 1.645 * math.sqrt(over * a * b / n**3 + over_reference * c * d / m**3)
    small = abs(true / n - reference_true / m) + width < SHARE_BOUND
    shown = partial(_detectable_odds, c / (m + 1.0), n / over, m / over_reference)
    return _Test(math.log(a * d / (b * c)), error, freedom, n + m, "readings", float(p_value), small, shown)


def _detectable_odds(share: float, n: float, m: float, level: float) -> float:
    """Logarithm of the smallest odds ratio above 1 that these many readings show with 80 % probability.

    The other share x is where (x - share)^2 = z^2 (x (1 - x) / n + share (1 - share) / m).
    """
    z2 = detectable(1.0, math.inf, level) ** 2
    half = share + z2 / n / 2.0
    root = math.sqrt(half**2 - (1.0 + z2 / n) * (share**2 - z2 * share * (1.0 - share) / m))
    other = (half + root) / (1.0 + z2 / n)
    return float(logit(min(other, 1.0 - 1e-9)) - logit(share)) if other < 1.0 else math.inf


def _effect(metric: Metric, test: _Test, different: float, alike: float, level: float) -> FactorEffect:
    """What was found of an effect, by the p-values after Holm."""
    shown = detectable(test.error, test.freedom, level) if test.detectable is None else test.detectable(level)
    estimate = IntervalEstimate.about(test.value, student(test.error, test.freedom), test.n, test.of)
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


def _answered(question: Question, effects: Sequence[FactorEffect]) -> Question:
    verdict = next(possible for possible in VERDICTS if any(effect.verdict == possible for effect in effects))
    decisive = [effect for effect in effects if effect.verdict == verdict]
    who = f" for {question.sensor}" if question.sensor else ""
    answer = f"{question.compared}{who}: {verdict}"
    if verdict == "matters":
        answer += f": {'; '.join(map(_size, decisive))}"
    elif verdict == "does not matter":
        answer += (
            f" beyond {BOUNDS['bias']:g} cm of mean error, a factor {BOUNDS['spread']:g} of spread and "
            f"{BOUNDS['missed']:g} of the odds (or {SHARE_BOUND:.0%} of the readings) of missed and outliers"
        )
        seen = [_size(effect) for effect in effects if effect.p_adjusted is not None and effect.p_adjusted < LEVEL]
        answer += f"; within that there is {'; '.join(seen)}" if seen else ""
    else:
        answer += f": {'; '.join(map(_doubt, decisive))}"
        settled = ", ".join(NAMES[effect.metric] for effect in effects if effect.verdict == "does not matter")
        answer += f"; {settled}: does not matter" if settled else ""
    return replace(question, effects=tuple(effects), verdict=verdict, answer=answer)


def _size(effect: FactorEffect) -> str:
    return f"{NAMES[effect.metric]}{' times' if effect.is_ratio else ''} {effect.estimate}"


def _doubt(effect: FactorEffect) -> str:
    if effect.estimate is None:
        return f"{NAMES[effect.metric]}: no two points to compare"
    if effect.smallest_detectable is None:
        return f"{_size(effect)}; these data could show nothing"
    unit = "times" if effect.is_ratio else "cm"
    return f"{_size(effect)}; these data would have shown {effect.smallest_detectable:.2g} {unit} or more"
