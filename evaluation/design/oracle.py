"""Whether an experiment would decide between the two effects of a pair, worked out from the physics of `pairs` alone.

A pair and which of its effects is true enter; the nats by which the other one fails leave, in the readings that a
person takes in some two hours. It knows nothing of `msp-lab design`.
"""

from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from evaluation.design.pairs import FALSE_CM, Columns, Floats, Hidden, Pair
from tests.support.measured import sensor

READINGS = 18_000
"""In all: those of half an hour."""
VISITS = 4
"""How often each placement of a bench is repeated."""
FLIGHTS = 12
PLACED_CM = {"bench": 0.2, "flight": 0.5}
"""Standard deviation of the true range's error, common to a placement or a flight."""
ENOUGH_NATS = 13.6
"""With so many a likelihood ratio leads by 5 nats in 95 % of the cases: it is normal, its variance twice its mean."""
USUAL = {"true_range_cm": 200.0, "air_temperature_c": 22.5, "throttle": 0.0, "vibration_hz": 0.0, "incidence_deg": 0.0}
CELLS_CM = np.arange(20.0, 766.0)


def decidable_nats(pair: Pair, hidden: Hidden, size: float) -> float:
    """Nats between the true effect and the other one, with the other's size and the sensor's own numbers free.

    Where the true one is a number of the sensor itself, the other effect is true at its least size: nothing else
    could be seen.
    """
    if not hidden.name:
        hidden = next(each for each in pair.effects if each.name)
        size = hidden.least
    (other,) = (each for each in pair.effects if each is not hidden)
    runs = [dict(zip(pair.between, levels, strict=True)) for levels in product(*pair.between.values())]
    runs = runs * (max(FLIGHTS // len(runs), 1) if pair.within else VISITS)
    placed_cm = PLACED_CM["flight" if pair.within else "bench"]
    inside = [dict(zip(pair.within, levels, strict=True)) for levels in product(*pair.within.values())]
    each_of = READINGS / (len(runs) * len(inside))
    points = [USUAL | run | point for run in runs for point in inside]
    columns = {name: np.array([each[name] for each in points]) for name in points[0]}
    columns.setdefault("neighbour_lag_ms", np.full(len(points), 0.4))
    run = np.repeat(np.arange(len(runs)), len(inside))
    true_bias = np.broadcast_to(hidden.bias(columns, size), run.shape)
    if np.any(true_bias):
        return _of_biases(columns, true_bias, other, run, each_of, placed_cm)
    return _of_readings(columns, hidden, size, other, each_of)


def _of_biases(
    columns: Columns, true_bias: Floats, other: Hidden, run: NDArray[np.intp], each_of: float, placed_cm: float
) -> float:
    """Half the squares that the other effect and an offset leave, in units of the errors of points and runs."""
    usual = sensor()
    of_point = usual.sigma_cm**2 / (each_of * usual.hit)
    together = run[:, None] == run[None, :]
    whitened = np.linalg.cholesky(np.linalg.inv(of_point * np.eye(run.size) + placed_cm**2 * together)).T

    def left(size: float) -> float:
        shift = true_bias - np.broadcast_to(other.bias(columns, size), run.shape)
        offset = whitened @ np.ones(run.size)
        rest = whitened @ shift
        rest = rest - offset * (offset @ rest) / (offset @ offset)
        return 0.5 * float(rest @ rest)

    sizes = np.linspace(-3.0 * other.most, 3.0 * other.most, 61)
    start = sizes[int(np.argmin([left(size) for size in sizes]))]
    return float(minimize(lambda value: left(float(value[0])), [start], method="Nelder-Mead").fun)


def _shares(columns: Columns, hidden: Hidden, size: float, wider: float = 1.0, more: float = 1.0) -> Floats:
    """Probability of each whole centimetre at each point, (points, cells)."""
    usual = sensor()
    true_cm = np.asarray(columns["true_range_cm"])[:, None]

    def column(values: object) -> Floats:
        return np.broadcast_to(np.asarray(values, dtype=np.float64), true_cm.shape[:1])[:, None]

    def normal(centre: Floats, sigma: Floats | float) -> Floats:
        height = np.exp(-0.5 * ((CELLS_CM - centre) / sigma) ** 2)
        found: Floats = height / np.maximum(height.sum(axis=1, keepdims=True), 1e-300)
        return found

    short = usual.short * more * column(hidden.shorts(columns, size))
    nearer = np.where(true_cm > CELLS_CM, np.exp(-usual.short_rate_per_m * CELLS_CM / 100.0), 0.0)
    own = usual.hit * normal(true_cm, usual.sigma_cm * wider * column(hidden.spread(columns, size)))
    own = own + short * nearer / nearer.sum(axis=1, keepdims=True) + usual.random / CELLS_CM.size
    share, seen_cm = (column(each) for each in hidden.false(columns, size))
    found: Floats = (1.0 - share) * own / own.sum(axis=1, keepdims=True) + share * normal(seen_cm, FALSE_CM)
    return found


def _of_readings(columns: Columns, hidden: Hidden, size: float, other: Hidden, each_of: float) -> float:
    """Kullback-Leibler divergence of what is read, the other effect's and the sensor's numbers free."""
    right = _shares(columns, hidden, size)

    def left(numbers: Floats) -> float:
        wrong = _shares(columns, other, float(np.exp(numbers[0])), float(np.exp(numbers[1])), float(np.exp(numbers[2])))
        return float(each_of * (right * (np.log(right + 1e-12) - np.log(wrong + 1e-12))).sum())

    start = min(
        (
            [np.log(size), wider, more]
            for size in (0.02, 0.2, other.least, other.most)
            for wider in (0.0, 0.5)
            for more in (0.0, 1.0)
        ),
        key=lambda numbers: left(np.array(numbers)),
    )
    return float(minimize(left, start, method="Nelder-Mead", options={"maxiter": 600}).fun)
