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

from msp_lab.characterise.estimates import Z, detectable, holm, student
from msp_lab.characterise.experiments import QUESTIONS
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.characterise.question_findings import NAMES, FactorEffect, Metric, Question, Verdict
from msp_lab.characterise.temperature import ROOM_C, ROOM_WITHIN_C

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


class _Raw(NamedTuple):
    """An effect on the scale where it is roughly normal: centimetres, or the logarithm of a ratio."""

    value: float
    error: float
    freedom: float
    n: int
    of: str
    p_value: float
    bound: float
    small_share: bool
    detectable: Callable[[float], float] | None = None


def answer_questions(points: Sequence[PointResult]) -> tuple[Question, ...]:
    """All questions that the points allow, with p-values corrected for all of them together.

    Parameters
    ----------
    points
        Every set-up of the data.
    """
    asked = [each for name in QUESTIONS for each in _compared(name, [p for p in points if p.condition == name], points)]
    raw = {(i, metric): _effect(metric, each) for i, each in enumerate(asked) for metric in NAMES}
    estimated = [key for key, each in raw.items() if each is not None]
    tests = [raw[key] for key in estimated]
    different = dict(zip(estimated, holm([each.p_value for each in tests if each]), strict=True))
    alike = dict(zip(estimated, holm([_p_alike(each) for each in tests if each]), strict=True))
    answered = []
    for i, each in enumerate(asked):
        effects = tuple(
            _effect_found(metric, raw[i, metric], different.get((i, metric)), alike.get((i, metric)), len(estimated))
            for metric in NAMES
        )
        answered.append(_answered(replace(each, effects=effects)))
    return tuple(answered)


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
    if name == "crosstalk_simultaneous":
        waiting = [p for p in everything if p.condition == "crosstalk_sequential" and p.sensor == sensor]
        if waiting:
            return "sequential", waiting
    return "the baseline of another sensor", baseline


def _reference_level(name: str, points: Sequence[PointResult]) -> str | None:
    """The level of the experiment itself that the others are compared with; None: the baseline."""
    levels = list(dict.fromkeys(p.level for p in points))
    if name == "material":
        return next((each for word in ("plywood", "wood") for each in levels if word in each.lower()), None)
    if name == "temperature":
        known = [
            (abs((p.air_temperature_c or 0.0) - ROOM_C), p.level) for p in points if p.air_temperature_c is not None
        ]
        return min(known)[1] if known and min(known)[0] < ROOM_WITHIN_C else None
    if name == "external_interference":
        return "quiet" if "quiet" in levels else None
    if name == "vibration":
        return next((each for each in levels if each in ("0 Hz", "")), None) if len(levels) > 1 else None
    return None


def _effect(metric: Metric, question: Question) -> _Raw | None:
    if metric == "bias":
        return _paired(question, lambda p: None if p.error is None else p.error.value, BIAS_BOUND_CM)
    if metric == "spread":
        return _paired(question, _log_spread, math.log(SPREAD_BOUND))
    if metric == "missed":
        return _odds(question, lambda p: p.no_echo + p.saturated + p.no_answer, lambda p: p.readings)
    return _odds(question, lambda p: p.short + p.long, lambda p: p.readings - p.no_echo - p.saturated - p.no_answer)


def _log_spread(point: PointResult) -> float | None:
    return None if point.spread is None else math.log(math.hypot(point.spread.value, STEP_SPREAD_CM))


def _paired(question: Question, value: Callable[[PointResult], float | None], bound: float) -> _Raw | None:
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
    p_value = 2.0 * float(stats.t.sf(abs(mean) / error, freedom))
    return _Raw(mean, error, freedom, count, "points", p_value, bound, False)


def _by_range(points: Sequence[PointResult], value: Callable[[PointResult], float | None]) -> dict[float, list[float]]:
    found: dict[float, list[float]] = {}
    for point in points:
        one = value(point)
        if one is not None:
            found.setdefault(point.place_cm, []).append(one)
    return found


def _odds(question: Question, count: Callable[[PointResult], int], of: Callable[[PointResult], int]) -> _Raw | None:
    """Logarithm of the odds ratio over all readings at equal ranges, with the variance between points."""
    ranges = {p.place_cm for p in question.reference_points}
    varied = [p for p in question.points if p.place_cm in ranges and of(p)]
    reference = [p for p in question.reference_points if of(p)]
    if not varied or not reference:
        return None
    a, n = sum(map(count, varied)), sum(map(of, varied))
    c, m = sum(map(count, reference)), sum(map(of, reference))
    b, d = n - a, m - c
    value = math.log((a + 0.5) * (d + 0.5) / ((b + 0.5) * (c + 0.5)))
    over, over_reference = _overdispersion(varied, count, of), _overdispersion(reference, count, of)
    if question.name == "external_interference":
        # Its points differ by their dose, which is the effect itself and no reason to doubt it.
        over = over_reference
    error = math.sqrt(over * (1.0 / (a + 0.5) + 1.0 / (b + 0.5)) + over_reference * (1.0 / (c + 0.5) + 1.0 / (d + 0.5)))
    freedom = len(varied) + len(reference) - 2.0
    if max(over, over_reference) > MAX_VARIANCE_RATIO and freedom >= 1.0:
        # By ranks: one point that is unlike all others is no evidence.
        shares = [[count(p) / of(p) for p in each] for each in (varied, reference)]
        p_value = float(stats.mannwhitneyu(*shares, method="asymptotic").pvalue)
    else:
        freedom, p_value = math.inf, float(stats.fisher_exact([[a, b], [c, d]])[1])
    difference = a / n - c / m
    width = 1.645 * math.sqrt(over * (a + 0.5) * (b + 0.5) / n**3 + over_reference * (c + 0.5) * (d + 0.5) / m**3)
    small = abs(difference) + width < SHARE_BOUND
    shown = partial(_detectable_odds, (c + 0.5) / (m + 1.0), n / over, m / over_reference)
    return _Raw(value, error, freedom, n + m, "readings", p_value, math.log(ODDS_BOUND), small, shown)


def _detectable_odds(share: float, n: float, m: float, level: float) -> float:
    """Logarithm of the smallest odds ratio above 1 that these many readings show with 80 % probability."""
    z = float(stats.norm.ppf(1.0 - level / 2.0) + stats.norm.ppf(0.8))

    def excess(other: float) -> float:
        return other - share - z * math.sqrt(other * (1.0 - other) / n + share * (1.0 - share) / m)

    if excess(1.0) <= 0.0:
        return math.inf
    other = min(float(brentq(excess, share, 1.0)), 1.0 - 1e-9)
    return math.log(other / (1.0 - other)) - math.log(share / (1.0 - share))


def _overdispersion(
    points: Sequence[PointResult], count: Callable[[PointResult], int], of: Callable[[PointResult], int]
) -> float:
    """Variance of the points' counts over that of independent readings, at least 1."""
    share = sum(map(count, points)) / sum(map(of, points))
    if len(points) < 2 or not 0.0 < share < 1.0:
        return 1.0
    squares = sum((count(p) - share * of(p)) ** 2 / (share * (1.0 - share) * of(p)) for p in points)
    return max(squares / (len(points) - 1), 1.0)


def _p_alike(raw: _Raw) -> float:
    """Of an effect that is as large as the bound or larger: the greater of two one-sided tests."""
    by_value = float(stats.t.sf((raw.bound - abs(raw.value)) / raw.error, raw.freedom))
    # A share that may change by a hundredth at most is small by itself; its interval is a 90 % one as well.
    return min(by_value, LEVEL / 1e3) if raw.small_share else by_value


def _effect_found(
    metric: Metric, raw: _Raw | None, different: float | None, alike: float | None, tests: int
) -> FactorEffect:
    is_ratio = metric != "bias"
    bound = {"bias": BIAS_BOUND_CM, "spread": SPREAD_BOUND}.get(metric, ODDS_BOUND)
    if raw is None or different is None or alike is None:
        return FactorEffect(metric, None, None, None, bound, "cannot tell", None)
    half = student(raw.error, raw.freedom) if math.isfinite(raw.freedom) else Z * raw.error
    ends = (raw.value, raw.value - half, raw.value + half)
    # e^500 is a number still, and 'anything' enough.
    value, low, high = (math.exp(min(max(each, -500.0), 500.0)) for each in ends) if is_ratio else ends
    verdict: Verdict = "does not matter" if alike < LEVEL else "matters" if different < LEVEL else "cannot tell"
    level = LEVEL / tests
    shown = detectable(raw.error, raw.freedom, level) if raw.detectable is None else raw.detectable(level)
    return FactorEffect(
        metric=metric,
        estimate=IntervalEstimate(value, low, high, "" if is_ratio else "cm", raw.n, raw.of),
        p_value=raw.p_value,
        p_adjusted=different,
        bound=bound,
        verdict=verdict,
        smallest_detectable=_known_size(shown, is_ratio),
    )


def _known_size(shown: float, is_ratio: bool) -> float | None:
    """None where it is so large that the data show nothing."""
    if is_ratio:
        return math.exp(shown) if shown < math.log(MAX_RATIO) else None
    return shown if shown < MAX_CM else None


def _answered(question: Question) -> Question:
    verdicts = [each.verdict for each in question.effects]
    verdict: Verdict = (
        "matters"
        if "matters" in verdicts
        else "does not matter"
        if all(each == "does not matter" for each in verdicts)
        else "cannot tell"
    )
    who = f" for {question.sensor}" if question.sensor else ""
    subject = f"{question.level} against {question.reference}{who}"
    if verdict == "matters":
        sizes = "; ".join(_size(each) for each in question.effects if each.verdict == "matters")
        answer = f"{subject}: matters: {sizes}"
    elif verdict == "does not matter":
        answer = (
            f"{subject}: does not matter beyond {BIAS_BOUND_CM:g} cm of bias, a factor {SPREAD_BOUND:g} of spread and "
            f"{ODDS_BOUND:g} of the odds (or {SHARE_BOUND:.0%} of the readings) of missed and outliers"
        )
        seen = [_size(each) for each in question.effects if each.p_adjusted is not None and each.p_adjusted < LEVEL]
        answer += f"; within that there is {'; '.join(seen)}" if seen else ""
    else:
        open_ = [each for each in question.effects if each.verdict == "cannot tell"]
        answer = f"{subject}: cannot tell: " + "; ".join(_doubt(each) for each in open_)
        settled = [each.metric for each in question.effects if each.verdict == "does not matter"]
        answer += f"; {', '.join(settled)}: does not matter" if settled else ""
    return replace(question, verdict=verdict, answer=answer)


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
    return f"{_size(effect)}; these data would have shown {_amount(effect)} or more"


def _amount(effect: FactorEffect) -> str:
    assert effect.smallest_detectable is not None
    return (
        f"{effect.smallest_detectable:.2g} cm" if effect.metric == "bias" else f"{effect.smallest_detectable:.2g} times"
    )
