"""Whether what a fit leaves depends on a column, or on two together: one test for each channel, and ripples.

A curve is tested by the scores at the present fit. Its values are those of a random walk along its column, and
independent of each other over words: the variance of its steps is a variance component (Zhang & Lin 2003, Biostatistics
4, 57; Wood 2013, Biometrika 100, 1005). The first directions of a walk are nearly a line and a parabola; the smaller
its variance, the less the others count. A sum of weighted chi-squared numbers has its tail by the saddle point (Kuonen
1999, Biometrika 86, 929).

A ripple is no walk: a periodogram sees every period. Its power is judged against that of neighbouring frequencies, so
that a slow wander raises both, and by the number of independent frequencies (Baluev 2008, MNRAS 385, 1279).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
from scipy.special import log_ndtr

from msp_lab.gap import rules
from msp_lab.gap.prepared import CHANNELS, ODDS_CHANNELS, ChannelSlopes
from msp_lab.gap.refit import JointFit
from msp_lab.gap.runs import NO_CONTEXT, is_known, known_values, spacing_s
from msp_range.arrays import Array, Column, Indices
from msp_sim.effects.base import REFERENCE_STD, TRUE_RANGE
from msp_sim.effects.curve import CurveChannel, Knots, Ripple, hats

NO_VARIABLES = NO_CONTEXT | {"run", "condition", REFERENCE_STD}
STEP_HALF = 1e-4
"""Half the distance of the two knots of a step, as a share of the column's span: hardly a reading is between them."""
STEP_PLACES = 60
"""A step is placed at one of so many shares of the readings. More: slower, and steps are nearer to where they are."""
RIPPLES_OVER = (TRUE_RANGE, "time_in_run_s", "uptime_s")
"""Columns over which a ripple is asked: standing waves and interference over range, what turns or beats over time."""
RIPPLE_SHORTEST_CM = 4.0
"""Ripples over range are asked down to this period. Whole centimetres average over shorter ones. Smaller: more
independent frequencies, so that each has to be stronger."""
RIPPLE_CELLS = 8
"""Scores are put into cells of this share of the shortest period. With 8 it keeps 97 % of its power."""
RIPPLE_OVERSAMPLED = 16
"""Frequencies in the width of a peak. With 4 a peak between two of them keeps 97 % of its power, with 16 its period is
known to a thirtieth of a cycle over all readings. It affects speed, and that share."""
RIPPLE_TRIMMED = 0.1
"""The largest share of the neighbours is left out: a strong ripple leaks into them where ranges are not even. Higher:
the second of two ripples needs less power, and noise is a ripple more often."""
RIPPLE_TRIMMED_MEAN = (1.0 - RIPPLE_TRIMMED * (1.0 - np.log(RIPPLE_TRIMMED))) / (1.0 - RIPPLE_TRIMMED)
"""Mean of the others where the power is that of noise, which is exponential, with a mean of 1."""


@dataclass(frozen=True)
class CandidateCurve:
    """A curve that may be added."""

    channel: CurveChannel
    variables: tuple[str, ...]
    """What it changes, over which columns."""
    forms: tuple[tuple[Knots, ...], ...]
    """Knots over each column: it is refitted with each of these, the coarse ones first."""
    log_p: float
    """Log of the probability of as much where nothing is missing."""
    log_asked: float
    """Log of the number of curves that were asked like it."""
    start: tuple[float, ...] = ()
    """Values at which its refit starts; empty: 0 at each knot."""

    @property
    def corrected(self) -> float:
        """Log of the probability of as much in any that was asked like it."""
        return self.log_p + self.log_asked


def places_of(values: Column, count: int) -> tuple[Any, ...]:
    """So many knots over a column; none where it does not vary, is hardly known or has too many words.

    Knots of numbers are between quantiles and even steps, so that rare ends have one too.
    """
    known = known_values(values)
    distinct = np.unique(known) if values.dtype.kind in "Uf" else known[:0]
    if values.dtype.kind == "U":
        return tuple(distinct.tolist()) if 2 <= distinct.size <= rules.KNOTS[-1] else ()
    if known.size < max(20, values.size // 2) or distinct.size < 2:
        return ()
    if distinct.size <= count:
        return tuple(distinct.tolist())
    share = np.linspace(0.0, 1.0, count)
    low, high = np.quantile(known, (0.01, 0.99))
    middle = 0.5 * np.quantile(known, 0.01 + 0.98 * share) + 0.5 * (low + (high - low) * share)
    if not np.all(np.diff(middle) > 0):
        return ()
    # Four digits of the span, not of the value: knots of a column that hardly varies stay apart.
    digits = 3 - int(np.floor(np.log10(high - low)))
    return tuple(round(float(place), digits) for place in middle)


def _walk(knots: Sequence[Any]) -> Array:
    """Values at the knots by the independent steps of a walk along them, or by those of words, (knots, steps)."""
    if isinstance(knots[0], str):
        return np.eye(len(knots))
    at = np.asarray(knots, dtype=np.float64)
    steps: Array = np.tri(at.size, at.size - 1, -1) * np.sqrt(np.diff(at) / np.ptp(at))
    return steps


Asked: TypeAlias = tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]
"""Columns of a curve, and the knots over each with which it may be refitted, the coarse ones first."""


def asked_of(contexts: Mapping[str, Any]) -> tuple[list[Asked], list[Asked]]:
    """Every column that varies, and every pair of them that has no more values than the finest curve over one."""
    knots = {
        name: [places for count in rules.KNOTS if (places := places_of(column, count))]
        for name, column in contexts.items()
        if name not in NO_VARIABLES
    }
    singles: list[Asked] = [
        ((name,), tuple(dict.fromkeys((form,) for form in own))) for name, own in knots.items() if own
    ]
    pairs = []
    for one, other in combinations([name for (name,), _ in singles], 2):
        both = dict.fromkeys(zip(knots[one][:2], knots[other][:2], strict=False))
        pairs.append(((one, other), tuple(form for form in both if values_in(form) <= rules.KNOTS[-1])))
    return singles, [pair for pair in pairs if pair[1]]


def _steps(contexts: Mapping[str, Any], variables: Sequence[str], knots: Sequence[Any]) -> Array:
    """What the independent numbers of a curve change at each reading, (n, numbers)."""
    walk = _walk(knots[0])
    if len(knots) == 2:
        # Each walk alone, and both together.
        alone = [np.column_stack([np.ones(len(own)), _walk(own)]) for own in knots]
        walk = np.asarray(np.kron(alone[0], alone[1])[:, 1:], dtype=np.float64)
    return _about_mean(hats(contexts, variables, knots) @ walk, contexts, variables)


def _about_mean(steps: Array, contexts: Mapping[str, Any], variables: Sequence[str]) -> Array:
    """About their mean where the columns are known, else 0: that they are known is no dependence on them."""
    known = np.all([is_known(contexts[name]) for name in variables], axis=0)
    centred: Array = np.where(known[:, None], steps - steps[known].mean(axis=0), 0.0)
    return centred


def scan(
    contexts: Mapping[str, Any], asked: Sequence[Asked], fit: JointFit, channels: Sequence[CurveChannel] = CHANNELS
) -> list[CandidateCurve]:
    """Curves by their probability under random variation at a fit, the least first.

    What is fitted and not held at a bound is nuisance, with the information of its prior: of a class of readings that
    never came only the prior is known, and its scores would stand for any channel's.
    """
    events = {channel: float((fit.here.by[:, CHANNELS.index(channel)] ** 2).sum()) for channel in channels}
    most = {channel: number / rules.FEW_READINGS for channel, number in events.items()}
    all_scores = {channel: _Scores.of(fit, channel) for channel in channels if most[channel] >= 1.0}
    tests, weights, sums = [], [], []
    for variables, forms in asked:
        steps = _steps(contexts, variables, forms[-1])
        for channel, scores in all_scores.items():
            information, squares = scores.along(steps)
            for degrees in sorted({*rules.SMOOTHNESS, information.size} - {0}):
                if degrees <= min(most[channel], information.size):
                    # So large a variance that the scores tell as many directions from nothing; at last, any.
                    shrinks = information[degrees - 1] if degrees < information.size else 0.0
                    tests.append((channel, variables, forms, degrees))
                    weights.append(information / (information + shrinks))
                    sums.append(float(weights[-1] @ squares))
    found: dict[Any, CandidateCurve] = {}
    for (channel, variables, forms, degrees), log_p in zip(tests, log_p_of_sums(sums, weights).tolist(), strict=True):
        key = channel, variables
        if key not in found or log_p < found[key].log_p:
            some = tuple(form for form in forms if degrees_of(form) <= 2 * degrees + 1) or forms[:1]
            found[key] = CandidateCurve(channel, variables, some, log_p, float(np.log(len(tests))))
    return sorted(found.values(), key=lambda curve: curve.log_p)


def values_in(knots: Sequence[Knots]) -> int:
    """How many values a curve with these knots has."""
    return int(np.prod([len(own) for own in knots]))


def degrees_of(knots: Sequence[Knots]) -> int:
    """Degrees of freedom of a curve, without its mean; a ripple has none."""
    return values_in(knots) - (not isinstance(knots[0], Ripple))


@dataclass(frozen=True)
class _Scores:
    """A channel's scores of all readings, and what is fitted with it."""

    totals: Array
    """Each score, and its products with the scores of what is fitted, (n, 1 + numbers)."""
    squares: Array
    """What its square is where nothing is missing, (n,)."""
    expected: Array | None
    """For an odds' scores, what the fit expects of their products with the odds' own number, over its deviation,
    (n,)."""
    crossed: Array | None
    before: Indices
    """Product of what is a reading's own with what it carries over from the reading before, and which one that is."""
    inner: Array
    left_over: Array
    """Inverse of the information of what is fitted, and the sums of its scores, (numbers, numbers) and (numbers,)."""

    @classmethod
    def of(cls, fit: JointFit, channel: CurveChannel) -> "_Scores":
        """At a fit."""
        here, at = fit.here, fit.at
        free = ~at.held & (np.sqrt(np.mean(at.scores**2, axis=0)) > 1e-9)
        norm = np.sqrt((at.scores[:, free] ** 2).sum(axis=0))
        fitted = at.scores[:, free] / norm
        scaled = at.information[np.ix_(free, free)] / np.outer(norm, norm)
        inner: Array = np.asarray(np.linalg.pinv(scaled, rcond=1e-8, hermitian=True), dtype=np.float64)
        own, carried = here.parts(CHANNELS.index(channel))
        totals, squares, by_share = np.column_stack([own, fitted * own[:, None]]), own**2, None
        if channel in ODDS_CHANNELS:
            share = here.shares[:, ODDS_CHANNELS.index(channel)]
            expected = share * (1.0 - share) * float(squares.sum()) / float((share * (1.0 - share)).sum())
            # What is rare varies as the fit says where it never came, and as it came where it came more often.
            squares = 0.5 * (squares + expected)
            by_share = expected / np.sqrt(expected.sum())
        crossed, before, n = None, np.arange(own.size), own.size
        if carried is not None and here.carry is not None:
            before = here.carry.before
            of_before = carried[:, None] * np.column_stack([np.ones(n), fitted])
            totals -= np.column_stack([np.bincount(before, column, n) for column in of_before.T])
            squares = squares + np.bincount(before, carried**2, n)
            crossed = own * carried
        return cls(totals, squares, by_share, crossed, before, inner, at.gradient[free] / norm)

    def efficient(self, steps: Array) -> tuple[Array, Array, float]:
        """Sums of the scores by some numbers, less what is fitted takes, their information, (numbers,) and (numbers,
        numbers), and the least that counts: what is less is collinear with what is fitted."""
        sums = steps.T @ self.totals
        carried = sums[:, 1:] @ self.inner
        taken = carried @ sums[:, 1:].T
        if self.expected is not None:
            # Each projected by itself: what came leaves less than nothing of what was expected elsewhere.
            shares = steps.T @ self.expected
            taken = 0.5 * (taken + np.outer(shares, shares))
        whole = steps.T @ (steps * self.squares[:, None])
        if self.crossed is not None:
            both = steps.T @ (steps[self.before] * self.crossed[:, None])
            whole = whole - both - both.T
        return sums[:, 0] - carried @ self.left_over, whole - taken, rules.COLLINEAR * float(np.diag(whole).max())

    def along(self, steps: Array) -> tuple[Array, Array]:
        """Information of the directions in which the scores by some numbers are independent, the largest first, and
        squares of their sums over their deviations, (directions,)."""
        total, information, least = self.efficient(steps)
        values, vectors = np.linalg.eigh(information)
        clear = values > least
        values, vectors = values[clear][::-1], vectors[:, clear][:, ::-1]
        return values, (total @ vectors) ** 2 / values


def log_p_of(statistic: float, degrees: int) -> float:
    """log of the probability that a chi-squared number is larger."""
    return float(log_p_of_sums([statistic], [np.ones(degrees)])[0])


def log_p_of_sums(sums: Sequence[float] | Array, weights: Sequence[Array]) -> Array:
    """log of the probability that a sum of squares of normal numbers with these weights is larger, (n,)."""
    size = max((of_sum.size for of_sum in weights), default=1)
    largest = np.array([of_sum.max() for of_sum in weights])
    w = np.array([np.pad(of_sum / of_sum.max(), (0, size - of_sum.size)) for of_sum in weights]).reshape(-1, size)
    q = np.maximum(np.array(sums) / largest, 1e-9)
    low, high = -0.5 * size / q, np.full(q.size, 0.5)
    for _ in range(60):
        t = 0.5 * (low + high)
        above = (w / (1.0 - 2.0 * t[:, None] * w)).sum(axis=1) > q
        low, high = np.where(above, low, t), np.where(above, t, high)
    rest = 1.0 - 2.0 * t[:, None] * w
    root = np.sign(t) * np.sqrt(np.maximum(2.0 * t * q + np.log(rest).sum(axis=1), 1e-12))
    curved = t * np.sqrt(2.0 * ((w / rest) ** 2).sum(axis=1))
    near = np.abs(root) < 1e-3
    shift = np.where(near, 0.0, np.log(np.where(near, 1.0, curved / root)) / np.where(near, 1.0, root))
    found: Array = log_ndtr(-(root + shift))
    return found


def step_of(contexts: Mapping[str, Any], name: str, channel: CurveChannel, fit: JointFit) -> tuple[float, float]:
    """Two knots so close to each other that a curve steps from one value to another between them, where it gains most
    by its score."""
    column = contexts[name]
    known = known_values(column)
    at = np.unique(np.quantile(known, np.linspace(0.0, 1.0, STEP_PLACES)))[:-1]
    above = _about_mean(np.asarray(column[:, None] > at, dtype=np.float64), contexts, (name,))
    total, information, least = _Scores.of(fit, channel).efficient(above)
    own = np.diag(information)
    middle = float(at[np.argmax(np.where(own > least, total**2 / np.maximum(own, 1e-300), 0.0))])
    half = STEP_HALF * float(np.ptp(known))
    digits = 1 - int(np.floor(np.log10(half)))
    return round(middle - half, digits), round(middle + half, digits)


def ripples(contexts: Mapping[str, Any], here: ChannelSlopes) -> list[CandidateCurve]:
    """The likeliest ripple of the bias over each of some columns, the least likely by random variation first."""
    score = here.own_centre
    if here.carry is not None:
        # What moves a hit moves the centre of the hit after it, which carries its error over.
        score = score - np.bincount(here.carry.before, here.carry.factor * here.own_centre, score.size)
    found = []
    for name in RIPPLES_OVER:
        at = np.asarray(contexts.get(name, np.nan), dtype=np.float64)
        known = np.isfinite(at) & (score != 0.0)
        if not known.any():
            continue
        at = at[known]
        cell = RIPPLE_SHORTEST_CM / RIPPLE_CELLS
        places = np.unique(np.rint(at / cell)).size
        # Closer ripples have another one's values where there are readings.
        spacing = np.ptp(at) / max(places - 1, 1) if name == TRUE_RANGE else spacing_s(contexts)
        shortest = max(RIPPLE_SHORTEST_CM if name == TRUE_RANGE else 0.0, 2.0 * float(spacing))
        found.extend(_ripple(name, at - at.min(), score[known], shortest))
    return sorted(found, key=lambda curve: curve.corrected)


def _ripple(name: str, at: Array, score: Array, shortest: float) -> list[CandidateCurve]:
    """The likeliest ripple that is longer than this, if the readings hold some of its cycles."""
    span, cell = float(at.max()), shortest / RIPPLE_CELLS
    longest = span / rules.RIPPLE_CYCLES
    if not 0.0 < shortest < longest:
        return []
    left, size = np.floor(at / cell).astype(np.intp), int(np.ceil(RIPPLE_OVERSAMPLED * span / cell)) + 2
    share = at / cell - left
    cells = np.bincount(left, score * (1.0 - share), size) + np.bincount(left + 1, score * share, size)
    step = 1.0 / (size * cell)
    # The lowest frequency is that of an offset and a slope.
    power = np.abs(np.fft.rfft(cells))[RIPPLE_OVERSAMPLED : int(1.0 / (shortest * step)) + 1] ** 2
    first, half = int(np.ceil(1.0 / (longest * step))) - RIPPLE_OVERSAMPLED, RIPPLE_OVERSAMPLED // 2
    degrees = min(rules.RIPPLE_NEIGHBOURS, (power.size - 6 * half) // RIPPLE_OVERSAMPLED)
    if degrees < 1:
        return []
    # A slow wander has the more power the lower the frequency, so a mean over both sides would be too small.
    ratio = (power / np.maximum(_level_below(power), _level_below(power[::-1])[::-1]))[first:]
    largest, best = float(ratio.max()), first + int(ratio.argmax())
    if best == first:
        # What is stronger the slower it is, is no ripple of this period.
        return []
    best += int(power[best - half : best + half].argmax()) - half
    period = 1.0 / ((best + RIPPLE_OVERSAMPLED) * step)
    independent = span * (1.0 / shortest - 1.0 / longest)
    # Power of noise over the mean of `degrees` others: both have two degrees of freedom.
    log_p = -degrees * float(np.log1p(largest / degrees))
    log_asked = float(np.log(max(independent, 1.0)) + 0.5 * np.log(max(largest, 1.0)))
    return [CandidateCurve("bias", (name,), ((Ripple(float(f"{period:.4g}")),),), log_p, log_asked)]


def _level_below(power: Array) -> Array:
    """Mean power of independent frequencies below each, by all but the largest; 0 where there are none."""
    steps = RIPPLE_OVERSAMPLED * (np.arange(rules.RIPPLE_NEIGHBOURS) + 1.5)
    place = np.arange(power.size)[:, None] - steps.astype(np.intp)
    near = np.sort(np.where(place >= 0, power[np.maximum(place, 0)], np.inf), axis=1)
    kept = np.ceil((1.0 - RIPPLE_TRIMMED) * (place >= 0).sum(axis=1))
    lower = np.where(np.arange(near.shape[1]) < kept[:, None], near, 0.0)
    level: Array = lower.sum(axis=1) / np.maximum(kept, 1.0) / RIPPLE_TRIMMED_MEAN
    return np.maximum(level, 1e-300)
