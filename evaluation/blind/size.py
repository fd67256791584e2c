"""How large a hidden effect is: in standard errors of somebody who knows what it does to each reading.

The same pings are flown with and without the effect, many times, with the same draws of everything else. What differs
in each row, in the mean and the variance of its hits and in the odds of each class of reading, is the effect's own
template. A size of 6 means that the template's coefficient is six times its standard error on the rows counted, with
offset, spread and shares of the base fitted with it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.random import default_rng

from evaluation.blind.flight import Columns, Flight, Habits, fly, land
from evaluation.blind.mechanisms import MECHANISMS, Act
from evaluation.blind.sound import Array

HIT_CM = 8.0
"""About the true range; what is farther off is no hit."""

PLACE_CM = 3.0

REPLICATES = 32

COUNTED = 0.5
"""Share of the rows on which effects are chosen and fitted."""

Hidden = Sequence[tuple[str, float]]
"""Names of mechanisms with their sizes."""


def stage(columns: Columns, ways: Habits, hidden: Hidden, seed: np.random.SeedSequence) -> tuple[Flight, Array]:
    """Fly with something hidden; what is drawn for one mechanism, and for the rest, does not depend on the others."""
    base, hearing, *own = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, 7)).spawn(
        2 + 2 * len(hidden)
    )
    columns = dict(columns)
    for (name, size), stream in zip(hidden, own[::2], strict=True):
        prepare = MECHANISMS[name].prepare
        if prepare is not None:
            prepare(columns, size, default_rng(stream))
    flight = fly(columns, ways, default_rng(base))
    for (name, size), stream in zip(hidden, own[1::2], strict=True):
        MECHANISMS[name].act(flight, size, default_rng(stream))
    return flight, land(flight, default_rng(hearing))


@dataclass(frozen=True)
class Plain:
    """Many flights without the mechanism: contexts, what was staged, and readings."""

    columns: Columns
    flight: Flight
    reading_cm: Array


def fly_plain(
    columns: Columns, ways: Habits, name: str, size: float, seed: int, replicates: int, before: Plain | None = None
) -> Plain:
    """Fly without the mechanism over the contexts that it prepares; what was flown before, if those are the same."""
    mechanism = MECHANISMS[name]
    columns = dict(columns)
    if mechanism.prepare is not None:
        mechanism.prepare(columns, size, default_rng(5))
    if before is not None and all(
        np.array_equal(column, before.columns[key], equal_nan=column.dtype.kind == "f")
        for key, column in columns.items()
    ):
        return before
    return Plain(columns, *fly_once(_repeat(columns, replicates), ways, mechanism.without, size, (seed, 99)))


@dataclass(frozen=True)
class Size:
    """Standard errors of each channel's template; they add in squares."""

    bias: float
    spread: float
    classes: float
    runs: float

    @property
    def total(self) -> float:
        """Of all of them together."""
        return float(np.sqrt(self.bias**2 + self.spread**2 + self.classes**2 + self.runs**2))


def measure(columns: Columns, ways: Habits, name: str, size: float, seed: int, plain: Plain | None = None) -> Size:
    """Size of one mechanism in standard errors.

    Parameters
    ----------
    columns
        Contexts of the table, without what the mechanism prepares.
    ways
        The vehicle.
    name, size
        The mechanism, and its size in its own unit.
    seed
        Of the replicates.
    plain
        Flights without it, of `fly_plain`, if they have been flown.
    """
    mechanism = MECHANISMS[name]
    plain = plain or fly_plain(columns, ways, name, size, seed, REPLICATES)
    replicates = plain.flight.rows // len(plain.columns["run"])
    _, changed = fly_once(_repeat(plain.columns, replicates), ways, mechanism.act, size, (seed, 99))
    shape = (replicates, -1)
    true_cm = plain.flight["true_range_cm"].reshape(shape)
    readings = [reading.reshape(shape) for reading in (plain.reading_cm, changed)]
    errors = [reading - true_cm for reading in readings]
    # A missed echo that reads 255 may be near the range at random.
    hits = [(np.abs(error) < HIT_CM) & (reading != 255.0) for error, reading in zip(errors, readings, strict=True)]
    sigma2 = float(errors[0][hits[0]].var())
    both = hits[0] & hits[1]
    bias2 = _cross(*(_means(error, both) for error in errors)) / sigma2 * both.mean()
    variances = [_variances(error, both) for error in errors]
    # Of the flights with it: a spread is known the worse the larger it is.
    spread2 = _cross(*variances) / (2.0 * float(variances[1].mean()) ** 2) * both.mean()
    place_cm = mechanism.place_cm(plain.flight).reshape(shape) if mechanism.place_cm else None
    classes2 = _classes2(*(_classes(*each, place_cm) for each in zip(readings, errors, strict=True)))
    runs2 = 0.0
    if name == "remounted":
        runs = np.unique(plain.columns["run"]).size
        ratio = size**2 * (true_cm.shape[1] / runs) * both.mean() / sigma2
        # Of the variance of the runs' means, by what the likelihood gains: its standard error grows with it.
        bias2, runs2 = 0.0, runs * (ratio - np.log1p(ratio))
    return Size(*(float(np.sqrt(max(COUNTED * each, 0.0))) for each in (bias2, spread2, classes2, runs2)))


def size_for(columns: Columns, ways: Habits, name: str, wanted: float, seed: int) -> tuple[float, float]:
    """Size in the mechanism's own unit at which it has the wanted number of standard errors, and what it then has.

    It stops at the largest size that is physical.
    """
    mechanism = MECHANISMS[name]
    size = min(mechanism.guess, mechanism.most)
    found: list[tuple[float, float]] = []
    plain: Plain | None = None
    for _ in range(8):
        plain = fly_plain(columns, ways, name, size, seed, REPLICATES, plain)
        has = measure(columns, ways, name, size, seed, plain).total
        found.append((size, has))
        if abs(has / wanted - 1.0) < 0.05 or (size >= mechanism.most and has < wanted):
            break
        size = min(_next(found, wanted), mechanism.most)
    return min(found, key=lambda each: abs(np.log(max(each[1], 1e-3) / wanted)))


def _next(found: list[tuple[float, float]], wanted: float) -> float:
    """Between the nearest below and above on logarithmic axes; in proportion where there are not both."""
    below = max((each for each in found if each[1] < wanted), key=lambda each: each[1], default=None)
    above = min((each for each in found if each[1] >= wanted), key=lambda each: each[1], default=None)
    if below and above and below[1] > 0.0:
        share = np.log(wanted / below[1]) / np.log(above[1] / below[1])
        return float(np.exp(np.log(below[0]) + np.clip(share, 0.1, 0.9) * np.log(above[0] / below[0])))
    last, has = found[-1]
    return float(last * np.clip(wanted / max(has, 1e-3), 0.3, 3.0))


def fly_once(
    columns: Columns, ways: Habits, act: Act | None, size: float, seed: tuple[int, ...]
) -> tuple[Flight, Array]:
    """Fly these contexts as they are, with what a mechanism does to the flights."""
    base, own, hearing = np.random.SeedSequence(seed).spawn(3)
    flight = fly(columns, ways, default_rng(base))
    if act is not None:
        act(flight, size, default_rng(own))
    return flight, land(flight, default_rng(hearing))


def _repeat(columns: Columns, replicates: int) -> Columns:
    many = {name: np.tile(column, replicates) for name, column in columns.items()}
    which = np.repeat(np.arange(replicates), len(columns["run"]))
    many["run"] = np.char.add(np.char.add(np.asarray(many["run"], dtype=str), "-"), which.astype(str))
    return many


def _classes2(plain: list[tuple[Array, bool]], changed: list[tuple[Array, bool]]) -> float:
    """Squared standard errors of the change of all classes' shares."""
    total = 0.0
    for (one, in_base), (other, _) in zip(plain, changed, strict=True):
        pooled = max(0.5 * (one.mean() + other.mean()), 1.0 / one.size)
        deviation: float | Array = float(np.sqrt(pooled * (1.0 - pooled)))
        if not in_base:
            # Rare in the base, so that a row's own share decides; drawn towards that of all rows.
            row = (one.sum(axis=0) + other.sum(axis=0) + 8.0 * pooled) / (2.0 * len(one) + 8.0)
            deviation = np.sqrt(np.maximum(row, pooled) * (1.0 - np.minimum(row, 0.95)))
        total += _cross(_means(one) / deviation, _means(other) / deviation, about_mean=in_base)
    return total


def _means(values: Array, counts: Array | None = None) -> Array:
    """Mean of each row over each half of the replicates, shape (2, rows); of what counts."""
    weights = np.ones(values.shape) if counts is None else counts
    total = _by_halves(values * weights)
    return total / np.maximum(_by_halves(weights), 1)


def _by_halves(values: Array) -> Array:
    """Sum of each row over each half of the replicates, shape (2, rows)."""
    return np.stack([half.sum(axis=0) for half in np.split(values, 2)])


def _variances(values: Array, counts: Array) -> Array:
    """Variance of each row over each half of the replicates, shape (2, rows)."""
    mean = np.repeat(_means(values, counts), len(values) // 2, axis=0)
    return _by_halves(counts * (values - mean) ** 2) / np.maximum(_by_halves(counts) - 1, 1)


def _cross(one: Array, other: Array, *, about_mean: bool = True) -> float:
    """Sum over rows of the squared change; the halves' changes are multiplied, which leaves out the noise.

    A change that is the same in all rows is one of the base's parameters, and does not count.
    """
    first, second = other - one
    if about_mean:
        first, second = first - first.mean(), second - second.mean()
    return float((first * second).sum())


def _classes(reading_cm: Array, error_cm: Array, place_cm: Array | None) -> list[tuple[Array, bool]]:
    """Readings of each class, and whether the base has a parameter for its share."""
    rest = (np.abs(error_cm) >= HIT_CM) & (reading_cm < 765.0)
    classes = [(reading_cm == 765.0, True), (reading_cm > 765.0, False)]
    for there, in_base in (
        (np.abs(reading_cm - (0.0 if place_cm is None else place_cm)) < PLACE_CM, False),
        (reading_cm == 255.0, True),
        (reading_cm == 20.0, False),
        (error_cm < 0.0, True),
        (error_cm > 0.0, True),
    ):
        classes.append((rest & there, in_base))
        rest &= ~there
    return classes
