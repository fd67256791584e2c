"""Joint maximum-likelihood refits of the base's parameters and of effects, within their bounds.

Prepared readings and effects enter; values, their information and the log-likelihood leave. Steps are those of Newton
with the outer product of the scores, damped so that none makes the fit worse.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap.tangent import BASE, CHANNELS, Channels, Prepared, channels
from msp_range.reading_model.sensor_model import CalibrationKnot, SensorModel
from msp_sim.effects.base import Parameter, Scene
from msp_sim.effects.curve import FIELDS, hats
from msp_sim.model.model import Active, Model, acts
from msp_sim.model.slopes import log_prob

_Array = NDArray[np.float64]
BASE_BOUND = np.array([20.0, 3.0, 12.0, 12.0, 12.0, 4.0, 1.0])
BASE_DEVIATION = np.array([1.0, 0.15, 1.0, 1.0, 1.0, 0.5, 0.2])
"""About how far a characterised base is off: what readings cannot tell from an effect stays near the file."""
ROUNDS = 12
ENOUGH_NATS = 0.03


@dataclass(frozen=True)
class Fitted:
    """A joint fit.

    Attributes
    ----------
    base
        Change of the base's parameters, in the order of `BASE`.
    effects
        With their values.
    log_likelihood
        Sum over the readings, less what the priors take [nat].
    names
        Of the numbers that were free: ``base.offset_cm``, or ``k.parameter`` of the k-th effect.
    information
        Of them, from the scores; a number at its bound is held and has none.
    scores
        (n, numbers): each reading's derivatives, for errors by runs.
    """

    base: _Array
    effects: tuple[Active, ...]
    log_likelihood: float
    names: tuple[str, ...]
    values: _Array
    information: _Array
    scores: _Array
    held: NDArray[np.bool_]
    here: Channels

    def covariance(self, unit: NDArray[np.intp] | None = None) -> _Array:
        """Of the numbers; with units, of sums over whole units (sandwich)."""
        free = ~self.held
        covariance = np.zeros_like(self.information)
        inverse = np.linalg.pinv(self.information[np.ix_(free, free)], hermitian=True)
        if unit is not None:
            sums = sums_by(unit, self.scores[:, free])
            units = max(sums.shape[0], 2)
            inverse = inverse @ (sums.T @ sums * units / (units - 1)) @ inverse
        covariance[np.ix_(free, free)] = inverse
        return covariance


def sums_by(unit: NDArray[np.intp], scores: _Array) -> _Array:
    """Sums of the scores over units, shape (units, numbers)."""
    count = int(unit.max()) + 1 if unit.size else 0
    return np.stack([np.bincount(unit, column, count) for column in scores.T], axis=1)


def free_numbers(effects: Sequence[Active]) -> list[tuple[int, Parameter]]:
    """Numbers of these effects that a fit may move."""
    return [(k, parameter) for k, each in enumerate(effects) for parameter in each.effect.parameters]


def refit(
    prepared: Prepared,
    effects: Sequence[Active],
    start: _Array | None = None,
    rounds: int = ROUNDS,
    ridge: float = 0.0,
) -> Fitted:
    """Fit base and effects together.

    Parameters
    ----------
    prepared
        Readings.
    effects
        Effects with the values where the search begins.
    start
        Of the base; unchanged unless given.
    rounds
        At most.
    ridge
        Precision of a prior about 0 for the values of curves, which holds values that no reading speaks of.
    """
    base = np.zeros(len(BASE)) if start is None else start.copy()
    effects = [_off_null(each) for each in effects]
    numbers = free_numbers(effects)
    nb = len(BASE)
    low = np.concatenate([-BASE_BOUND, [p.low for _, p in numbers]])
    high = np.concatenate([BASE_BOUND, [p.high for _, p in numbers]])
    saturated = prepared.rows.saturated_fraction
    low[6], high[6] = min(1e-4 - saturated, 0.0), max(1.0 - 1e-4 - saturated, 0.0)
    scale = np.concatenate([np.zeros(nb), [ridge if effects[k].shape is not None else 0.0 for k, _ in numbers]])
    scale[:nb] = 1.0 / BASE_DEVIATION**2
    theta = np.concatenate([base, [effects[k].values[p.name] for k, p in numbers]])

    def placed(at: _Array) -> tuple[Active, ...]:
        values: list[dict[str, float]] = [dict(each.values) for each in effects]
        for (k, p), value in zip(numbers, at[nb:], strict=True):
            values[k][p.name] = float(value)
        return tuple(replace(each, values=own) for each, own in zip(effects, values, strict=True))

    def total(at: _Array) -> tuple[float, Channels]:
        here = channels(prepared.at(at[:nb], placed(at)), prepared.reading_cm)
        return float(here.log_p.sum()) - 0.5 * float(scale @ at**2), here

    best, here = total(theta)
    scores = _scores(prepared, theta[:nb], placed(theta), numbers, here)
    damping = 1e-3
    held = np.zeros(theta.size, dtype=bool)
    for _ in range(rounds):
        gradient = scores.sum(axis=0) - scale * theta
        information = scores.T @ scores + np.diag(scale)
        held = (
            ((theta <= low) & (gradient < 0.0)) | ((theta >= high) & (gradient > 0.0)) | (np.diag(information) < 1e-9)
        )
        free = ~held
        if not free.any():
            break
        own = information[np.ix_(free, free)]
        improved = False
        gained = 0.0
        for _ in range(8):
            step = np.zeros(theta.size)
            step[free] = np.linalg.lstsq(own + damping * np.diag(np.diag(own)), gradient[free], rcond=1e-10)[0]
            there = np.clip(theta + step, low, high)
            value, there_too = total(there)
            if value > best:
                gained, best, theta, here, improved = value - best, value, there, there_too, True
                damping = max(damping / 10.0, 1e-6)
                break
            damping = max(damping * 10.0, 1e-2)
        if not improved:
            break
        scores = _scores(prepared, theta[:nb], placed(theta), numbers, here)
        if gained < ENOUGH_NATS:
            break
    gradient = scores.sum(axis=0) - scale * theta
    information = scores.T @ scores + np.diag(scale)
    held = ((theta <= low) & (gradient < 0.0)) | ((theta >= high) & (gradient > 0.0)) | (np.diag(information) < 1e-9)
    names = tuple([f"base.{name}" for name in BASE] + [f"{k}.{p.name}" for k, p in numbers])
    return Fitted(theta[:nb], placed(theta), best, names, theta, information, scores, held, here)


def _off_null(each: Active) -> Active:
    """A share of exactly nothing has no shape: begin a little beside it."""
    values = dict(each.values)
    for parameter in each.effect.parameters:
        if parameter.null is not None and values[parameter.name] == parameter.null and each.shape is None:
            values[parameter.name] = parameter.null + parameter.step
    return replace(each, values=values)


def _scores(
    prepared: Prepared,
    base: _Array,
    effects: Sequence[Active],
    numbers: Sequence[tuple[int, Parameter]],
    here: Channels,
) -> _Array:
    columns = [_slope(prepared, base, effects, k, p, here) for k, p in numbers]
    return np.column_stack([here.by, *columns]) if columns else here.by


def _slope(
    prepared: Prepared, base: _Array, effects: Sequence[Active], k: int, parameter: Parameter, here: Channels
) -> _Array:
    """Derivative by one number of the k-th effect."""
    each = effects[k]
    value = each.values[parameter.name]
    step = parameter.step * (1.0 if parameter.null is not None else max(abs(value), 1.0))
    if value + step > parameter.high:
        step = -step
    there = replace(each, values={**each.values, parameter.name: value + step})
    if {"component", "code"} & set(each.effect.channels) or each.effect.name == "run_offsets":
        moved = log_prob(prepared.at(base, [*effects[:k], there, *effects[k + 1 :]]), prepared.reading_cm)
        return (moved - here.log_p) / step
    known = acts(prepared.scene, each)
    if known is False:
        return np.zeros(len(prepared))
    if each.shape is not None:
        # Linear in its values: the weights of this knot.
        weights = hats_of(prepared.scene, each.shape)[:, int(parameter.name.removeprefix("value_"))]
        return np.where(known, weights, 0.0) * here.by[:, CHANNELS.index(each.shape[0])]
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        one = each.effect.act(prepared.scene, each.values)
        other = each.effect.act(prepared.scene, there.values)
    slope = np.zeros(len(prepared))
    for i, channel in enumerate(CHANNELS):
        after = getattr(other, FIELDS[channel])
        if after is not None:
            template = np.where(known, after - getattr(one, FIELDS[channel]), 0.0) / step
            slope += here.by[:, i] * np.nan_to_num(template)
    return slope


def hats_of(scene: Scene, shape: tuple[str, tuple[str, ...], tuple[tuple[Any, ...], ...]]) -> _Array:
    """Weights of a curve's knots, worked out once for a scene."""
    key = shape[1:]
    if key not in scene.kept:
        scene.kept[key] = hats(scene, shape[1], shape[2])
    weights: _Array = scene.kept[key]
    return weights


def extended(model: Model, base: _Array, effects: Sequence[Active]) -> Model:
    """The model with its base changed by this much, and with these effects beside its own."""
    sensor = model.sensor
    mixture = sensor.reading_model
    weights = mixture.weights
    factors = {"hit": 1.0, "short": np.exp(base[2]), "missed": np.exp(base[3]), "random": np.exp(base[4])}
    least = dict(zip(factors, (0.0, *np.where(base[2:5] != 0.0, 1e-6, 0.0)), strict=True))
    odds = {name: max(getattr(weights, name), least[name]) * float(factor) for name, factor in factors.items()}
    total = sum(odds.values())
    knots = sensor.calibration
    if base[0] != 0.0:
        # A reading below nothing is none: what lies there is said by the line through the next two knots.
        before = [(knot.true_cm, knot.reading_cm) for knot in knots] or [(100.0, 100.0), (500.0, 500.0)]
        after = [(true, reading + float(base[0])) for true, reading in before]
        after = [each for each in after if each[1] > 0.0] if len(after) > 2 else [(t, max(r, 1e-3)) for t, r in after]
        knots = tuple(CalibrationKnot(true_cm=true, reading_cm=reading) for true, reading in after)
    factor = float(np.exp(base[1]))
    update: dict[str, Any] = {
        "weights": weights.model_copy(update={name: value / total for name, value in odds.items()}),
        "sigma_cm": mixture.sigma_cm * factor,
        "sigma_growth_cm_per_m": mixture.sigma_growth_cm_per_m * factor,
        "short_rate_per_m": mixture.short_rate_per_m * float(np.exp(base[5])),
        "saturated_fraction": float(np.clip(mixture.saturated_fraction + base[6], 0.0, 1.0)),
    }
    sensor = SensorModel.model_validate(
        {
            **sensor.model_dump(),
            "calibration": [knot.model_dump() for knot in knots],
            "reading_model": {**mixture.model_dump(), **update, "weights": update["weights"].model_dump()},
        }
    )
    return Model(sensor, (*model.effects, *effects))


def to_sensor(model: Model, evidence: Mapping[int, Mapping[str, Any]] | None = None) -> SensorModel:
    """A sensor model file's content for a model: its effects as entries, with the evidence of some of them."""
    listed: list[dict[str, Any]] = []
    for k, each in enumerate(model.effects):
        entry: dict[str, Any] = {"name": each.effect.name}
        if each.shape is not None:
            channel, variables, knots = each.shape
            entry |= {"channel": channel, "variables": list(variables), "knots": [list(own) for own in knots]}
            entry["values"] = [float(value) for value in each.values.values()]
        else:
            if each.of is not None:
                entry["of"] = each.of
            entry["parameters"] = {name: float(value) for name, value in each.values.items()}
        if evidence and k in evidence:
            entry["evidence"] = dict(evidence[k])
        listed.append(entry)
    return SensorModel.model_validate({**model.sensor.model_dump(), "effects": listed})
