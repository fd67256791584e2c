"""Free curves of every context in every channel, asked all at once.

Score vectors at the present fit enter, curves by their probability under random variation leave. Five channels by every
column, and by every pair of columns: a curve's score is the channel's score times the weights of its knots.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
from scipy.special import gammaincc, gammaln

from msp_lab.gap import rules
from msp_lab.gap.curve_sums import KnotWeights, Variables
from msp_lab.gap.prepared import CHANNELS, ODDS_CHANNELS, ChannelSlopes
from msp_lab.gap.refit import JointFit, sums_by
from msp_lab.gap.runs import known_values, share_between
from msp_range.arrays import Array, Indices
from msp_sim.effects.base import REFERENCE_STD
from msp_sim.effects.curve import CurveChannel, Knots, Ripple

NO_VARIABLES = frozenset({"time_s", "reading_cm", "run", "previous_reading_cm", "condition", REFERENCE_STD})
STEP_HALF = 1e-4
"""Half the distance of the two knots of a step, as a share of the column's span: hardly a reading is between them."""


@dataclass(frozen=True)
class CandidateCurve:
    """A curve that may be added."""

    channel: CurveChannel
    variables: tuple[str, ...]
    knots: tuple[Knots, ...]
    """What it changes, over which columns, with which knots."""
    gain: float
    """About how much it adds to the log-likelihood [nat]."""
    degrees: int
    """Degrees of freedom."""
    log_p: float
    """Log of the probability of as much where nothing is missing, not corrected for the number of curves."""
    search_nats: float = 0.0
    """What the search over periods gains by random variation [nat]."""
    start: tuple[float, ...] = ()
    """Values at which its refit starts; empty: 0 at each knot."""

    @property
    def cost_nats(self) -> float:
        """What a ripple, or a curve over two variables, has to be less likely [nat]."""
        return self.search_nats + (rules.PAIR_COST_NATS if len(self.variables) > 1 else 0.0)


def variables_of(contexts: Mapping[str, Any], unit: Indices | None = None) -> dict[str, list[tuple[Any, ...]]]:
    """Columns that vary, with their knots, the coarse ones first.

    A column that hardly varies inside runs (`unit` numbers them) has as many values as there are runs, so fewer knots.
    """
    runs = 0 if unit is None else int(np.unique(unit).size)
    found: dict[str, list[tuple[Any, ...]]] = {}
    for name, column in contexts.items():
        if name in NO_VARIABLES:
            continue
        values = np.asarray(column)
        if values.dtype.kind == "U":
            words = [str(word) for word in np.unique(values) if word]
            if 2 <= len(words) <= max(rules.MAX_KNOTS.values()):
                found[name] = [tuple(words)]
        elif values.dtype.kind == "f":
            sizes = [knots for count in rules.KNOTS if len(knots := _knots(values, count)) >= 2]
            known = np.isfinite(values)
            if sizes and unit is not None and share_between(values[known], unit[known]) > rules.BETWEEN_RUNS_SHARE:
                sizes = [knots for knots in sizes if len(knots) - 1 <= max(runs // rules.CURVE_RUNS_PER_DEGREE, 1)]
            if sizes:
                found[name] = list(dict.fromkeys(sizes))
    return found


def steps_of(values: Array, low: float = 0.0, high: float = 1.0) -> list[tuple[float, float]]:
    """Pairs of knots so close to each other that the curve steps from one value to another between them.

    They are at even shares of the readings, between two shares.
    """
    known = known_values(values)
    if np.unique(known).size < 2 * rules.STEPS:
        return []
    places = np.unique(np.quantile(known, np.linspace(low, high, rules.STEPS + 2)[1:-1]))
    half = STEP_HALF * float(np.ptp(known))
    digits = 1 - int(np.floor(np.log10(half)))
    return [(round(float(each) - half, digits), round(float(each) + half, digits)) for each in places]


def is_step(form: CandidateCurve, values: Array) -> bool:
    """Whether a curve steps from one value to another over these values."""
    (knots,) = form.knots if len(form.knots) == 1 else ((),)
    if isinstance(knots, Ripple) or len(knots) != 2 or isinstance(knots[0], str):
        return False
    return bool(knots[1] - knots[0] < 4.0 * STEP_HALF * np.nanmax(np.abs(values - np.nanmin(values))))


def _knots(values: Array, count: int) -> tuple[float, ...]:
    """Knots between quantiles and even steps, so that rare ends have one too."""
    known = known_values(values)
    if known.size < max(20, values.size // 2):
        return ()
    distinct = np.unique(known)
    if distinct.size <= count:
        return tuple(float(each) for each in distinct)
    share = np.linspace(0.0, 1.0, count)
    low, high = np.quantile(known, (0.01, 0.99))
    if not high > low:
        return ()
    middle = 0.5 * np.quantile(known, 0.01 + 0.98 * share) + 0.5 * (low + (high - low) * share)
    if not np.all(np.diff(middle) > 0):
        return ()
    # Four digits of the span, not of the value: knots of a column that hardly varies stay apart.
    digits = 3 - int(np.floor(np.log10(high - low)))
    return tuple(round(float(each), digits) for each in middle)


Asked: TypeAlias = tuple[Variables, tuple[tuple[Any, ...], ...]]
"""Variables of a curve, and its knots over each."""


@dataclass(frozen=True)
class CurveWeights:
    """Curves that can be asked for, and the weights of their knots for each reading."""

    curves: tuple[Asked, ...]
    """Variables and knots of each."""
    forms: tuple[Array, ...]
    """For each curve its knots' weights at all knots of its columns, about their mean over the readings of which the
    columns are known, (knots of its columns, its knots): that they are known is no dependence on them."""
    weights: Mapping[Variables, KnotWeights]
    """Weights of all knots, by the variables of the curves."""


def curves_of(contexts: Mapping[str, Any], unit: Indices | None = None) -> CurveWeights:
    """Every column that varies, as a curve and as a step, and every pair of them; `unit` numbers the runs."""
    places = variables_of(contexts, unit)
    asked: list[Asked] = [((name,), (knots,)) for name, sizes in places.items() for knots in sizes]
    for name in places:
        column = np.asarray(contexts[name])
        asked += [((name,), (pair,)) for pair in (steps_of(column) if column.dtype.kind == "f" else [])]
    for count in rules.PAIR_KNOTS:
        coarse = {
            name: sizes[0] if isinstance(sizes[0][0], str) else _knots(np.asarray(contexts[name], dtype=float), count)
            for name, sizes in places.items()
        }
        names = [name for name, knots in coarse.items() if 2 <= len(knots) <= 4]
        asked += [((a, b), (coarse[a], coarse[b])) for a, b in combinations(names, 2)]
    return weights_of(contexts, list(dict.fromkeys(asked)))


def weights_of(contexts: Mapping[str, Any], asked: Sequence[Asked]) -> CurveWeights:
    """Curves over these variables with these knots, and the weights of the knots for each reading."""
    knots: dict[Variables, list[tuple[Any, ...]]] = {}
    for names, own in asked:
        knots.setdefault(names, []).append(own)
    weights = {names: KnotWeights.of(contexts, names, some) for names, some in knots.items()}
    readings = {names: each.sums(np.ones(each.matrix.shape[1])) for names, each in weights.items()}
    forms = []
    for names, own in asked:
        form = weights[names].curve(own)
        mean = form.T @ readings[names]
        forms.append(form - mean / max(mean.sum(), 1e-300))
    return CurveWeights(tuple(asked), tuple(forms), weights)


def scan(
    asked: CurveWeights,
    fit: JointFit,
    unit: Indices | None,
    channels_asked: Sequence[CurveChannel] = CHANNELS,
) -> list[CandidateCurve]:
    """Curves by their probability under random variation, the least first.

    Parameters
    ----------
    asked
        Curves that can be asked for, on n readings.
    fit
        Of n readings. What is fitted and not held at a bound is nuisance, with the information of its prior: of a class
        of readings that never came only the prior is known, and its scores would stand for any channel's.
    unit
        Run of each reading, where the run is the unit of evidence.
    channels_asked
        Which of the five channels.
    """
    here = fit.here
    at = fit.at
    free = ~at.held & (np.sqrt(np.mean(at.scores**2, axis=0)) > 1e-9)
    norm = np.sqrt((at.scores[:, free] ** 2).sum(axis=0))
    own, left_over = at.scores[:, free] / norm, at.gradient[free] / norm
    inner = np.linalg.pinv(at.information[np.ix_(free, free)] / np.outer(norm, norm), rcond=1e-8, hermitian=True)
    found = []
    for channel in channels_asked:
        slope = here.by[:, CHANNELS.index(channel)]
        if not np.any(slope):
            continue
        events = float(slope @ slope)
        sizes = {k: form.shape[1] for k, form in enumerate(asked.forms)}
        most = min(rules.MAX_KNOTS[channel], events / rules.MIN_EVENTS_PER_KNOT)
        wanted = [k for k, size in sizes.items() if size <= most]
        scores = _Scores.of(here, channel, own)
        sums = {names: _Sums.of(asked.weights[names], scores, unit) for names in {asked.curves[k][0] for k in wanted}}
        of_channel: dict[int, tuple[float, int]] = {}
        for size in dict.fromkeys(sizes[k] for k in wanted):
            these = [k for k in wanted if sizes[k] == size]
            forms = [(asked.forms[k], asked.curves[k][0]) for k in these]
            totals = np.array([form.T @ sums[names].totals for form, names in forms])
            squares = np.array([form.T @ sums[names].squares @ form for form, names in forms])
            cross = totals[:, :, 1:]
            carried = cross @ inner
            total = totals[:, :, 0] - carried @ left_over
            taken = carried @ np.swapaxes(cross, 1, 2)
            if scores.expected is not None:
                # Each projected by itself: what came leaves less than nothing of what was expected elsewhere.
                shares = np.array([form.T @ sums[names].expected for form, names in forms])
                taken = 0.5 * (taken + shares[:, :, None] * shares[:, None, :])
            efficient = squares - taken
            by_unit = None
            if unit is not None:
                by_unit = np.array([sums[names].by_unit @ form for form, names in forms])
                by_unit -= sums_by(unit, own) @ np.swapaxes(carried, 1, 2)
            of_channel |= zip(these, _statistics(total, squares, efficient, by_unit), strict=True)
        for k in wanted:
            statistic, degrees = of_channel[k]
            log_p = log_p_of(statistic, degrees) if degrees else 0.0
            found.append(CandidateCurve(channel, *asked.curves[k], 0.5 * statistic, degrees, log_p))
    return sorted(found, key=lambda each: each.log_p + each.cost_nats)


@dataclass(frozen=True)
class _Scores:
    """A channel's scores of all readings."""

    totals: Array
    """Each score, and its products with what is fitted, (n, 1 + numbers)."""
    squares: Array
    """What its square is where nothing is missing, (n,)."""
    expected: Array | None
    """For an odds' scores, what the fit expects of their products with the odds' own number, over its deviation,
    (n,)."""
    crossed: Array | None
    before: Indices | slice
    """Product of what is a reading's own with what it carries over from the reading before, and which one that is."""

    @classmethod
    def of(cls, here: ChannelSlopes, channel: CurveChannel, fitted: Array) -> "_Scores":
        """At a fit; `fitted` are the scores of its numbers."""
        own, carried = here.parts(CHANNELS.index(channel))
        totals, squares, by_share = np.column_stack([own, fitted * own[:, None]]), own**2, None
        if channel in ODDS_CHANNELS:
            share = here.shares[:, ODDS_CHANNELS.index(channel)]
            expected = share * (1.0 - share) * float(squares.sum()) / float((share * (1.0 - share)).sum())
            # What is rare varies as the fit says where it never came, and as it came where it came more often.
            squares = 0.5 * (squares + expected)
            by_share = expected / np.sqrt(expected.sum())
        if carried is None or here.carry is None:
            return cls(totals, squares, by_share, None, slice(None))
        before, n = here.carry.before, own.size
        of_before = carried[:, None] * np.column_stack([np.ones(n), fitted])
        totals -= np.column_stack([np.bincount(before, each, n) for each in of_before.T])
        return cls(totals, squares + np.bincount(before, carried**2, n), by_share, own * carried, before)


@dataclass(frozen=True)
class _Sums:
    """Sums of a channel's scores at all knots over the same variables."""

    totals: Array
    """Of the scores, and of their products with what is fitted, (knots, 1 + numbers)."""
    squares: Array
    """Of their products two by two, as they vary where nothing is missing, (knots, knots)."""
    by_unit: Array
    """Of the scores over runs, (runs, knots); empty where readings are the unit of evidence."""
    expected: Array
    """Of `_Scores.expected`, (knots,); empty for other channels."""

    @classmethod
    def of(cls, weights: KnotWeights, scores: _Scores, unit: Indices | None) -> "_Sums":
        """Of all readings."""
        squares = weights.products(scores.squares)
        if scores.crossed is not None:
            both = weights.products(scores.crossed, scores.before)
            squares = squares - both - both.T
        by_unit = np.zeros(0) if unit is None else weights.by_unit(scores.totals[:, 0], unit)
        expected = np.zeros(0) if scores.expected is None else weights.sums(scores.expected)
        return cls(weights.sums(scores.totals), squares, by_unit, expected)


def _statistics(total: Array, squares: Array, efficient: Array, by_unit: Array | None) -> list[tuple[float, int]]:
    """Chi-squared of each curve, and how many directions of it the nuisance leaves.

    Parameters
    ----------
    total
        Sums of the knots' scores, less their projection on the nuisance, (curves, k).
    squares, efficient
        Their variance before and after that projection, (curves, k, k).
    by_unit
        Their sums over runs, (curves, units, k), where those are the unit.
    """
    scale = np.sqrt(np.maximum(np.diagonal(squares, axis1=1, axis2=2), 1e-300))
    values, vectors = np.linalg.eigh(efficient / (scale[:, :, None] * scale[:, None, :]))
    clear = values > rules.CLEAR_DIRECTION
    degrees = clear.sum(axis=1)
    turned = np.where(clear, 1.0 / np.sqrt(np.where(clear, values, 1.0)), 0.0)[:, None, :] * vectors
    z = np.einsum("cij,ci->cj", turned, total / scale)
    if by_unit is not None:
        of_runs = (by_unit / scale[:, None, :]) @ turned
        of_runs = of_runs - of_runs.mean(axis=1, keepdims=True)
        units = of_runs.shape[1]
        variance = (of_runs**2).sum(axis=1) * units / max(units - 1, 1)
        # Pooled over the curve's directions: with few runs each alone is known too badly.
        pooled = variance.sum(axis=1) / np.maximum(degrees, 1)
        z = z / np.sqrt(np.maximum(np.maximum(variance, pooled[:, None]), 1.0))
        z = z * np.sqrt(np.maximum(units - 1 - degrees, 1) / units)[:, None]
    return list(zip((z**2).sum(axis=1).tolist(), degrees.tolist(), strict=True))


def log_p_of(statistic: float, degrees: int) -> float:
    """log of the probability that a chi-squared number is larger."""
    half, shape = 0.5 * statistic, 0.5 * degrees
    probability = float(gammaincc(shape, half))
    if probability > 1e-280:
        return float(np.log(probability))
    return float(-half + (shape - 1.0) * np.log(half) - gammaln(shape))
