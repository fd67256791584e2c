"""Free curves of every context in every channel, asked all at once.

Score vectors at the present fit enter, curves by their probability under random variation leave. Five channels by every
column, and by every pair of columns: a curve's score is the channel's score times the weights of its knots.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.special import gammaincc, gammaln

from msp_lab.gap import rules
from msp_lab.gap.prepared import CHANNELS, ChannelSlopes
from msp_sim.effects.base import REFERENCE_STD
from msp_sim.effects.curve import CurveChannel, Knots, Ripple, hats

_Array = NDArray[np.float64]
NO_VARIABLES = frozenset({"time_s", "reading_cm", "run", "previous_reading_cm", "condition", REFERENCE_STD})
STEP_HALF = 1e-4
"""Half the distance of the two knots of a step, as a share of the column's span: hardly a reading is between them."""
ODDS_CHANNELS = ("short", "missed", "random")


@dataclass(frozen=True)
class CandidateCurve:
    """A curve that may be added.

    Attributes
    ----------
    channel, variables, knots
        What it changes, over which columns, with which knots.
    gain
        About how much it adds to the log-likelihood [nat].
    degrees
        Degrees of freedom.
    log_p
        log of the probability of as much where nothing is missing, not corrected for the number of curves.
    search_nats
        What the search over periods gains by random variation [nat].
    """

    channel: CurveChannel
    variables: tuple[str, ...]
    knots: tuple[Knots, ...]
    gain: float
    degrees: int
    log_p: float
    search_nats: float = 0.0

    @property
    def cost_nats(self) -> float:
        """What a ripple, or a curve over two variables, has to be less likely [nat]."""
        return self.search_nats + (rules.PAIR_COST_NATS if len(self.variables) > 1 else 0.0)


def variables_of(contexts: Mapping[str, Any], unit: NDArray[np.intp] | None = None) -> dict[str, list[tuple[Any, ...]]]:
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
            if unit is not None and _share_between(values, unit) > rules.BETWEEN_RUNS_SHARE:
                sizes = [knots for knots in sizes if len(knots) - 1 <= max(runs // rules.CURVE_RUNS_PER_DEGREE, 1)]
            if sizes:
                found[name] = list(dict.fromkeys(sizes))
    return found


def _share_between(values: _Array, unit: NDArray[np.intp]) -> float:
    """Share of a column's variance that lies between runs."""
    known = np.isfinite(values)
    values, unit = values[known], unit[known]
    if not values.size:
        return 0.0
    counts = np.maximum(np.bincount(unit), 1)
    inside = values - (np.bincount(unit, values) / counts)[unit]
    return 1.0 - float(inside.var()) / max(float(values.var()), 1e-300)


def steps_of(values: _Array, low: float = 0.0, high: float = 1.0) -> list[tuple[float, float]]:
    """Pairs of knots so close to each other that the curve steps from one value to another between them.

    They are at even shares of the readings, between two shares.
    """
    known = values[np.isfinite(values)]
    if np.unique(known).size < 2 * rules.STEPS:
        return []
    places = np.unique(np.quantile(known, np.linspace(low, high, rules.STEPS + 2)[1:-1]))
    half = STEP_HALF * float(np.ptp(known))
    digits = 1 - int(np.floor(np.log10(half)))
    return [(round(float(each) - half, digits), round(float(each) + half, digits)) for each in places]


def is_step(form: CandidateCurve, values: _Array) -> bool:
    """Whether a curve steps from one value to another over these values."""
    (knots,) = form.knots if len(form.knots) == 1 else ((),)
    if isinstance(knots, Ripple) or len(knots) != 2 or isinstance(knots[0], str):
        return False
    return bool(knots[1] - knots[0] < 4.0 * STEP_HALF * np.nanmax(np.abs(values - np.nanmin(values))))


def _knots(values: _Array, count: int) -> tuple[float, ...]:
    """Knots between quantiles and even steps, so that rare ends have one too."""
    known = values[np.isfinite(values)]
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


@dataclass(frozen=True)
class CurveWeights:
    """Variables and knots of the curves that can be asked for, and the weights of the knots for each reading.

    Weights have single precision, as a scan takes as long as it takes to read them: sums of 20,000 are then off by less
    than a thousandth of their standard error.
    """

    curves: tuple[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]], ...]
    weights: tuple[NDArray[np.float32], ...]


def curves_of(contexts: Mapping[str, Any], unit: NDArray[np.intp] | None = None) -> CurveWeights:
    """Every column that varies, as a curve and as a step, and every pair of them; `unit` numbers the runs."""
    places = variables_of(contexts, unit)
    asked: list[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]] = [
        ((name,), (knots,)) for name, sizes in places.items() for knots in sizes
    ]
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


def weights_of(
    contexts: Mapping[str, Any], asked: Sequence[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]]
) -> CurveWeights:
    """Curves over these variables with these knots, and the weights of the knots for each reading."""
    single: dict[tuple[str, tuple[Any, ...]], _Array] = {}
    weights = []
    for variables, knots in asked:
        weight = np.ones((1, 1))
        for name, its_knots in zip(variables, knots, strict=True):
            if (name, its_knots) not in single:
                column = np.asarray(contexts[name])
                known = (column != "") if column.dtype.kind == "U" else np.isfinite(column)
                single[name, its_knots] = hats(contexts, [name], [its_knots]) * known[:, None]
            own = single[name, its_knots]
            weight = (weight[:, :, None] * own[:, None, :]).reshape(own.shape[0], -1)
        # About their mean where the column is known: that it is known is no dependence on it.
        known = weight.sum(axis=1) > 0.0
        weights.append(np.where(known[:, None], weight - weight[known].mean(axis=0), 0.0).astype(np.float32))
    return CurveWeights(tuple(asked), tuple(weights))


def scan(
    asked: CurveWeights,
    here: ChannelSlopes,
    nuisance: _Array,
    unit: NDArray[np.intp] | None,
    channels_asked: Sequence[CurveChannel] = CHANNELS,
) -> list[CandidateCurve]:
    """Curves by their probability under random variation, the least first.

    Parameters
    ----------
    asked
        Curves that can be asked for, on n readings.
    here
        Slopes of n readings by the channels at the fit.
    nuisance
        Scores of all that is fitted and not held at a bound, (n, numbers).
    unit
        Run of each reading, where the run is the unit of evidence.
    channels_asked
        Which of the five channels.
    """
    own = nuisance[:, np.sqrt(np.mean(nuisance**2, axis=0)) > 1e-9]
    own = own / np.sqrt((own**2).sum(axis=0))
    inner = np.linalg.pinv(own.T @ own, rcond=1e-8, hermitian=True)
    sums = own.sum(axis=0)
    carries = here.carry is not None
    units = None if unit is None else _ones(unit)
    own_of_units = None if units is None else units @ own
    found = []
    for channel in channels_asked:
        slope = here.by[:, CHANNELS.index(channel)]
        if not np.any(slope):
            continue
        events = float(slope @ slope)
        expected = slope**2
        if channel in ODDS_CHANNELS:
            share = here.shares[:, ODDS_CHANNELS.index(channel)]
            expected = share * (1.0 - share) * events / float((share * (1.0 - share)).sum())
        # What is rare varies as the fit says where it never came, and as it came where it came more often.
        deviation = np.sqrt(0.5 * (slope**2 + expected)).astype(np.float32)
        sloped = np.column_stack([slope, own * slope[:, None]]).astype(np.float32)
        of_units = None if units is None else units.multiply(slope[None, :]).tocsr()
        for (variables, knots), weight in zip(asked.curves, asked.weights, strict=True):
            if weight.shape[1] > rules.MAX_KNOTS[channel] or events < rules.MIN_EVENTS_PER_KNOT * weight.shape[1]:
                continue
            if carries and channel in ("bias", "spread"):
                score = np.column_stack([here.score(CHANNELS.index(channel), each) for each in weight.T])
                total, cross = score.sum(axis=0), own.T @ score
                squares, sums_of_units = score.T @ score, None if units is None else units @ score
            else:
                total, *cross = (sloped.T @ weight).astype(np.float64)
                scattered = weight * deviation[:, None]
                squares = (scattered.T @ scattered).astype(np.float64)
                sums_of_units = None if of_units is None else of_units @ weight
            carried = inner @ np.array(cross)
            by_unit = None if sums_of_units is None else sums_of_units - own_of_units @ carried
            statistic, degrees = _statistic(
                total - carried.T @ sums, squares, squares - np.array(cross).T @ carried, by_unit
            )
            log_p = log_p_of(statistic, degrees) if degrees else 0.0
            found.append(CandidateCurve(channel, variables, knots, 0.5 * statistic, degrees, log_p))
    return sorted(found, key=lambda each: each.log_p + each.cost_nats)


def _ones(unit: NDArray[np.intp]) -> csr_matrix:
    """(units, n): which readings are of which."""
    return csr_matrix((np.ones(unit.size), (unit, np.arange(unit.size))))


def _statistic(total: _Array, squares: _Array, efficient: _Array, by_unit: _Array | None) -> tuple[float, int]:
    """A curve's chi-squared, and how many directions of it the nuisance leaves.

    Parameters
    ----------
    total
        Sums of the knots' scores, less their projection on the nuisance, (k,).
    squares, efficient
        Their variance before and after that projection, (k, k).
    by_unit
        Their sums over runs, (units, k), where those are the unit.
    """
    scale = np.sqrt(np.maximum(np.diag(squares), 1e-300))
    values, vectors = np.linalg.eigh(efficient / np.outer(scale, scale))
    clear = values > rules.CLEAR_DIRECTION
    degrees = int(clear.sum())
    if degrees == 0:
        return 0.0, 0
    turned = vectors[:, clear] / np.sqrt(values[clear])
    z = turned.T @ (total / scale)
    if by_unit is not None:
        of_runs = (by_unit / scale) @ turned
        of_runs = of_runs - of_runs.mean(axis=0)
        units = of_runs.shape[0]
        variance = (of_runs**2).sum(axis=0) * units / max(units - 1, 1)
        # Pooled over the curve's directions: with few runs each alone is known too badly.
        z = z / np.sqrt(np.maximum(np.maximum(variance, variance.mean()), 1.0))
        z = z * np.sqrt(max(units - 1 - degrees, 1) / units)
    return float(z @ z), degrees


def log_p_of(statistic: float, degrees: int) -> float:
    """log of the probability that a chi-squared number is larger."""
    half, shape = 0.5 * statistic, 0.5 * degrees
    probability = float(gammaincc(shape, half))
    if probability > 1e-280:
        return float(np.log(probability))
    return float(-half + (shape - 1.0) * np.log(half) - gammaln(shape))
