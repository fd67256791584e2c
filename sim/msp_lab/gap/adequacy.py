"""What no name explains: free curves of every context in every channel, and a short formula for one that is there.

Score vectors at the present fit enter, the curve with the least chance leaves. Five channels by every column, and by
every pair of columns, are asked at once: a curve's score is the channel's score times the weights of its knots.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_matrix
from scipy.special import gammaincc, gammaln

from msp_lab.gap.tangent import CHANNELS
from msp_sim.effects.base import WORD_COLUMNS
from msp_sim.effects.curve import CurveChannel, hats

_Array = NDArray[np.float64]
NO_VARIABLES = frozenset({"time_s", "reading_cm", "run", "previous_reading_cm", "condition"})
KNOTS = (2, 3, 6, 12)
"""How fine curves are: from a straight line on."""
PAIR_KNOTS = (2, 3)
MOST_KNOTS = {"bias": 12, "spread": 12, "short": 6, "missed": 6, "random": 6}
RARE = ("short", "missed", "random")
LEAST_EVENTS = 5.0
"""Information that a curve needs for each of its knots, in events."""
PAIR_COST = 4.0
"""How many times less likely, in nats, a pair of columns has to be than the best single one."""


@dataclass(frozen=True)
class FreeForm:
    """A curve that was asked for.

    Attributes
    ----------
    channel, variables, knots
        Of it.
    gain
        About how much it adds to the log-likelihood [nat].
    degrees
        Of freedom.
    log_p
        log of the chance of as much where nothing is there, not corrected for the number of curves.
    """

    channel: CurveChannel
    variables: tuple[str, ...]
    knots: tuple[tuple[Any, ...], ...]
    gain: float
    degrees: int
    log_p: float


def variables_of(contexts: Mapping[str, Any]) -> dict[str, list[tuple[Any, ...]]]:
    """Columns that vary, with their knots, the coarse ones first."""
    found: dict[str, list[tuple[Any, ...]]] = {}
    for name, column in contexts.items():
        if name in NO_VARIABLES:
            continue
        values = np.asarray(column)
        if name in WORD_COLUMNS:
            words = [str(word) for word in np.unique(values) if word]
            if 2 <= len(words) <= 12:
                found[name] = [tuple(words)]
        elif values.dtype.kind == "f":
            sizes = [knots for count in KNOTS if len(knots := _knots(values, count)) >= 2]
            if sizes:
                found[name] = list(dict.fromkeys(sizes))
    return found


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
class Asked:
    """Curves' variables and knots, and the weights of the knots for each reading."""

    curves: tuple[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]], ...]
    weights: tuple[_Array, ...]


def curves_of(contexts: Mapping[str, Any]) -> Asked:
    """Every column that varies, and every pair of them."""
    places = variables_of(contexts)
    asked: list[tuple[tuple[str, ...], tuple[tuple[Any, ...], ...]]] = [
        ((name,), (knots,)) for name, sizes in places.items() for knots in sizes
    ]
    for count in PAIR_KNOTS:
        coarse = {
            name: sizes[0] if name in WORD_COLUMNS else _knots(np.asarray(contexts[name], dtype=float), count)
            for name, sizes in places.items()
        }
        names = [name for name, knots in coarse.items() if 2 <= len(knots) <= 4]
        asked += [((a, b), (coarse[a], coarse[b])) for a, b in combinations(names, 2)]
    asked = list(dict.fromkeys(asked))
    single: dict[tuple[str, tuple[Any, ...]], _Array] = {}
    weights = []
    for variables, knots in asked:
        weight = np.ones((1, 1))
        for name, its_knots in zip(variables, knots, strict=True):
            if (name, its_knots) not in single:
                column = np.asarray(contexts[name])
                known = (column != "") if name in WORD_COLUMNS else np.isfinite(column)
                single[name, its_knots] = hats(contexts, [name], [its_knots]) * known[:, None]
            own = single[name, its_knots]
            weight = (weight[:, :, None] * own[:, None, :]).reshape(own.shape[0], -1)
        # About their mean where the column is known: that it is known is no dependence on it.
        known = weight.sum(axis=1) > 0.0
        weights.append(np.where(known[:, None], weight - weight[known].mean(axis=0), 0.0))
    return Asked(tuple(asked), tuple(weights))


def scan(
    asked: Asked,
    nuisance: _Array,
    shares: _Array,
    unit: NDArray[np.intp] | None,
    channels_asked: Sequence[CurveChannel] = CHANNELS,
) -> list[FreeForm]:
    """Curves by their chance, the least first.

    Parameters
    ----------
    asked
        Curves, on n readings.
    nuisance
        Scores of all that is fitted, (n, numbers), the channels first as in `BASE`.
    shares
        Of short, missed and random readings as the fit has them, (n, 3).
    unit
        Runs, where they are the unit.
    channels_asked
        Of the five.
    """
    own = nuisance[:, np.sqrt(np.mean(nuisance**2, axis=0)) > 1e-9]
    own = own / np.sqrt((own**2).sum(axis=0))
    inner = np.linalg.pinv(own.T @ own, rcond=1e-8, hermitian=True)
    sums = own.sum(axis=0)
    units = None if unit is None else _ones(unit)
    own_of_units = None if units is None else units @ own
    found = []
    for channel in channels_asked:
        slope = nuisance[:, CHANNELS.index(channel)]
        if not np.any(slope):
            continue
        told = float(slope @ slope)
        expected = slope**2
        if channel in RARE:
            share = shares[:, RARE.index(channel)]
            expected = share * (1.0 - share) * told / float((share * (1.0 - share)).sum())
        # What is rare varies as the fit says where it never came, and as it came where it came more often.
        variance = 0.5 * (slope**2 + expected)
        sloped = np.column_stack([slope, own * slope[:, None]])
        of_units = None if units is None else units.multiply(slope[None, :]).tocsr()
        for (variables, knots), weight in zip(asked.curves, asked.weights, strict=True):
            if weight.shape[1] > MOST_KNOTS[channel] or told < LEAST_EVENTS * weight.shape[1]:
                continue
            total, *cross = sloped.T @ weight
            carried = inner @ np.array(cross)
            squares = (weight * variance[:, None]).T @ weight
            by_unit = None if of_units is None else of_units @ weight - own_of_units @ carried
            statistic, degrees = _judged(
                total - carried.T @ sums, squares, squares - np.array(cross).T @ carried, by_unit
            )
            chance = log_chance(statistic, degrees) if degrees else 0.0
            found.append(FreeForm(channel, variables, knots, 0.5 * statistic, degrees, chance))
    return sorted(found, key=lambda each: each.log_p + (PAIR_COST if len(each.variables) > 1 else 0.0))


def _ones(unit: NDArray[np.intp]) -> csr_matrix:
    """(units, n): which readings are of which."""
    return csr_matrix((np.ones(unit.size), (unit, np.arange(unit.size))))


def _judged(total: _Array, squares: _Array, efficient: _Array, by_unit: _Array | None) -> tuple[float, int]:
    """A curve's statistic, and how many directions of it the nuisance leaves.

    Parameters
    ----------
    total
        Of the knots' scores without what the nuisance says of them, (k,).
    squares, efficient
        Their variance with and without that, (k, k).
    by_unit
        Their sums over runs, (units, k), where those are the unit.
    """
    scale = np.sqrt(np.maximum(np.diag(squares), 1e-300))
    values, vectors = np.linalg.eigh(efficient / np.outer(scale, scale))
    clear = values > 0.02
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


def log_chance(statistic: float, degrees: int) -> float:
    """log of the chance that a chi-squared number is larger."""
    half, shape = 0.5 * statistic, 0.5 * degrees
    chance = float(gammaincc(shape, half))
    if chance > 1e-280:
        return float(np.log(chance))
    return float(-half + (shape - 1.0) * np.log(half) - gammaln(shape))


def formula(variable: str, at: _Array, values: _Array, deviation: _Array) -> str:
    """The shortest form of a small grammar that goes through a curve, with its numbers.

    Parameters
    ----------
    variable
        Its name.
    at, values, deviation
        Knots, values there and their standard errors, (k,).
    """
    weight = 1.0 / np.maximum(deviation, 1e-9 + 1e-3 * np.abs(values).max(initial=0.0)) ** 2
    span = float(at[-1] - at[0]) or 1.0
    best: tuple[float, str] | None = None
    for text, columns, shapes in _grammar(variable, at, span):
        design = np.column_stack([np.ones(at.size), *columns])
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        misfit = float((weight * (values - design @ solution) ** 2).sum())
        cost = misfit + 2.0 * (design.shape[1] + shapes)
        if best is None or cost < best[0] - 1e-9:
            best = (cost, text.format(*(f"{each:.3g}" for each in solution)))
    return best[1].replace("+ -", "- ") if best else ""


def _grammar(variable: str, at: _Array, span: float) -> list[tuple[str, list[_Array], int]]:
    forms: list[tuple[str, list[_Array], int]] = [(f"{{0}} + {{1}} {variable}", [at], 0)]
    forms.append((f"{{0}} + {{1}} {variable} + {{2}} {variable}^2", [at, at**2], 0))
    for cycles in (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0):
        wave = 2.0 * np.pi * cycles / span
        forms.append(
            (
                f"{{0}} + {{1}} sin({wave:.3g} {variable}) + {{2}} cos({wave:.3g} {variable})",
                [np.sin(wave * at), np.cos(wave * at)],
                1,
            )
        )
    for middle in (at[:-1] + at[1:]) / 2.0:
        forms.append((f"{{0}} + {{1}} [{variable} > {middle:.3g}]", [(at > middle).astype(float)], 1))
        forms.append(
            (
                f"{{0}} + {{1}} tanh(({variable} - {middle:.3g}) / {span / 8:.3g})",
                [np.tanh((at - middle) / (span / 8))],
                2,
            )
        )
    for length in (span / 8, span / 4, span / 2):
        forms.append(
            (
                f"{{0}} + {{1}} exp(-{variable} / {length:.3g})",
                [np.exp(-(at - at[0]) / length) * np.exp(-at[0] / length)],
                1,
            )
        )
    if variable.endswith("_deg") and np.all(np.abs(at) < 80.0):
        forms.append((f"{{0}} + {{1}} / cos({variable})", [1.0 / np.cos(np.radians(at))], 0))
    return forms
