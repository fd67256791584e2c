"""What every namer chooses from: each catalogue entry's score, reading by reading.

A table and a base model enter, a matrix leaves: derivatives of each reading's log probability by each entry of the
catalogue, and by the base's own parameters, all by finite differences of `Model.log_prob`. It shares the catalogue with
the gap workflow, and no statistics.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from msp_range.reading_model.sensor_model import MixtureParameters, Weights
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import WORD_COLUMNS, Effect, Parameter
from msp_sim.model.model import Model

Array = NDArray[np.floating[Any]]
LEAST = 1e-12
"""Probability of a reading that the model cannot give."""
LEAST_WEIGHT = 1e-6
"""Of each kind of reading: one that the base does not have may still be there."""
LEAST_SATURATED = 1e-3
MOST_WORDS = 20
ROUNDS = 20
BASE_STEP = 0.02
"""Of the base's parameters, for derivatives."""
DAMPING = 0.5
"""Of a step of the base's fit: what no reading speaks of stays where it is."""


class Entry(NamedTuple):
    """An effect, the word that it concerns, its parameters where it does nothing, and the one that is varied."""

    effect: Effect
    of: str | None
    values: Mapping[str, float]
    parameter: Parameter

    def added_to(self, model: Model, value: float) -> Model:
        """The model with this value of the parameter."""
        return model.adding(self.effect.name, self.of, **{**self.values, self.parameter.name: value})


@dataclass(frozen=True)
class Library:
    """Scores of n readings."""

    base: Array
    """By the base's own parameters, (n, 6): offset, spread, odds of short, missed and random readings, rate of the
    short ones. The saturated share is at its best, and is not among them: where no reading is 255 it has no slope."""
    scores: Array
    """By the entries, (n, k), divided by their root sums of squares."""
    names: tuple[str, ...]
    """Of the entries; one that is tried in several shapes, or for several words, is there several times."""
    one_sided: NDArray[np.bool_]
    """Entries whose number cannot be negative."""
    moves: NDArray[np.bool_]
    """Entries that move or widen the hits, and so are no mixture."""
    log_p: Array
    """log probability of each reading under the base, (n,)."""


BASE_MOVES = np.array([True, True, False, False, False, False])


def library(model: Model, contexts: Mapping[str, Any], reading_cm: Array) -> Library:
    """Scores of all entries that the contexts can show.

    Parameters
    ----------
    model
        The base; its own effects stay. Its own parameters are fitted to the readings first.
    contexts
        Columns of the CSV form.
    reading_cm
        Readings [cm], shape (n,), all known.
    """
    contexts = with_previous(contexts, reading_cm)
    model = fitted(model, contexts, reading_cm)
    base = _base_scores(model, contexts, reading_cm)
    here = log_prob(model, contexts, reading_cm)
    columns, names, one_sided, moves = [], [], [], []
    for entry in entries_of(contexts):
        effect, parameter = entry.effect, entry.parameter
        stepped = entry.added_to(model, (parameter.neutral or 0.0) + parameter.step)
        score = np.expm1(log_prob(stepped, contexts, reading_cm) - here)
        size = np.sqrt(np.sum(score**2))
        if size > 0.0:
            columns.append(score / size)
            names.append(effect.name)
            one_sided.append(parameter.low >= 0.0)
            moves.append({"bias", "spread"} >= set(effect.channels))
    return Library(base[:, :6], np.column_stack(columns), tuple(names), np.array(one_sided), np.array(moves), here)


def with_previous(contexts: Mapping[str, Any], reading_cm: Array) -> dict[str, Any]:
    """The contexts with the reading before, which some effects repeat."""
    return {**contexts, "previous_reading_cm": previous(contexts, reading_cm)}


def previous(contexts: Mapping[str, Any], reading_cm: Array) -> Array:
    """The same sensor's reading before in the run [cm]; NaN for the first."""
    series = np.char.add(np.asarray(contexts["run"], dtype=str), np.asarray(contexts["sensor"], dtype=str))
    order = np.lexsort((np.asarray(contexts["time_s"], dtype=float), series))
    follows = series[order][1:] == series[order][:-1]
    before = np.full(reading_cm.size, np.nan)
    before[order[1:][follows]] = reading_cm[order[:-1][follows]]
    return before


def _base_scores(model: Model, contexts: Mapping[str, Any], reading_cm: Array) -> Array:
    here = log_prob(model, contexts, reading_cm)
    steps = [changed(model, BASE_STEP * unit) for unit in np.eye(7)]
    return np.column_stack([np.expm1(log_prob(each, contexts, reading_cm) - here) for each in steps]) / BASE_STEP


def log_prob(model: Model, contexts: Mapping[str, Any], reading_cm: Array) -> Array:
    """Log probability of each reading, with a floor for one that cannot be, (n,)."""
    return np.maximum(model.log_prob(reading_cm, contexts), np.log(LEAST))


def _some_of_each(model: Model) -> Model:
    """With a little of every kind of reading: what the base has none of may still be there."""
    sensor, mixture = model.sensor, model.sensor.reading_model
    shares = {name: max(share, LEAST_WEIGHT) for name, share in mixture.weights.model_dump().items()}
    saturated = min(max(mixture.saturated_fraction, LEAST_SATURATED), 1.0 - LEAST_SATURATED)
    update = {"weights": _sum_to_one(mixture, shares), "saturated_fraction": saturated}
    return Model(sensor.model_copy(update={"reading_model": mixture.model_copy(update=update)}), model.effects)


def fitted(model: Model, contexts: Mapping[str, Any], reading_cm: Array) -> Model:
    """With the base's parameters at the readings' maximum of the likelihood, by damped steps of Gauss and Newton."""
    model = _some_of_each(model)
    best = log_prob(model, contexts, reading_cm).sum()
    for _ in range(ROUNDS):
        base = _base_scores(model, contexts, reading_cm)
        step = np.linalg.solve(base.T @ base + DAMPING * np.eye(base.shape[1]), base.sum(axis=0))
        for _ in range(6):
            tried = changed(model, step)
            reached = log_prob(tried, contexts, reading_cm).sum()
            if reached > best:
                break
            step = 0.3 * step
        if reached <= best + 1e-3:
            break
        model, best = tried, reached
    return model


def _sum_to_one(mixture: MixtureParameters, shares: Mapping[str, float]) -> Weights:
    total = sum(shares.values())
    return mixture.weights.model_copy(update={name: share / total for name, share in shares.items()})


def changed(model: Model, by: Array) -> Model:
    """The model with its base's parameters changed by so much: the offset [cm], logarithms of the rest."""
    sensor, mixture = model.sensor, model.sensor.reading_model
    factors = dict(zip(("hit", "short", "missed", "random"), np.exp([0.0, *by[2:5]]), strict=True))
    shares = {name: share * factors[name] for name, share in mixture.weights.model_dump().items()}
    saturated = expit(logit(mixture.saturated_fraction) + by[6])
    update = {
        "weights": _sum_to_one(mixture, shares),
        "sigma_cm": mixture.sigma_cm * np.exp(by[1]),
        "sigma_growth_cm_per_m": mixture.sigma_growth_cm_per_m * np.exp(by[1]),
        "short_rate_per_m": min(max(mixture.short_rate_per_m * np.exp(by[5]), 1e-4), 1000.0),
        "saturated_fraction": min(max(saturated, LEAST_SATURATED), 1.0 - LEAST_SATURATED),
    }
    knots = [(knot.true_cm, knot.reading_cm) for knot in sensor.calibration] or [(100.0, 100.0), (200.0, 200.0)]
    moved = [{"true_cm": true_cm, "reading_cm": reading_cm + by[0]} for true_cm, reading_cm in knots]
    # The sensor keeps its calibration's curve, so that one with another calibration is made anew.
    sensor = type(sensor).model_validate({**sensor.model_dump(), "calibration": moved})
    return Model(sensor.model_copy(update={"reading_model": mixture.model_copy(update=update)}), model.effects)


def entries_of(contexts: Mapping[str, Any]) -> Iterator[Entry]:
    """Entries of the catalogue whose columns are there, in each shape that it is to be tried in."""
    for effect in CATALOGUE.values():
        if not all(_says(contexts, name) for name in (*effect.requires, *([effect.per] if effect.per else []))):
            continue
        words: list[str | None] = [None]
        if effect.per is not None:
            words = [str(word) for word in np.unique(np.asarray(contexts[effect.per])) if word]
            if not 1 < len(words) <= MOST_WORDS:
                continue
        shapes = [parameter for parameter in effect.parameters if parameter.neutral is None]
        numbers = [parameter for parameter in effect.parameters if parameter.neutral is not None]
        for word in words:
            for tried in product(*(shape.grid or (shape.default,) for shape in shapes)):
                held = {shape.name: float(value or 0.0) for shape, value in zip(shapes, tried, strict=True)}
                held |= {number.name: number.neutral or 0.0 for number in numbers}
                for number in numbers:
                    yield Entry(effect, word, held, number)


def _says(contexts: Mapping[str, Any], name: str) -> bool:
    if name not in contexts:
        return False
    column = np.asarray(contexts[name])
    return bool((column != "").any() if name in WORD_COLUMNS else np.isfinite(column).any())
