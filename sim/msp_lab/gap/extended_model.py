"""A fit as a model: the given model with its base changed and with further effects, and as a sensor model file."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from msp_lab.gap.prepared import LEAST_SHARE
from msp_range.reading_model.rows import Base
from msp_range.reading_model.sensor_model import CalibrationKnot, SensorModel
from msp_sim.effects.curve import Ripple
from msp_sim.model.history import MAX_CORRELATION
from msp_sim.model.model import Model, Term

LEAST_READING_CM = 0.01
"""What the first knot of a calibration reads at least: the file format asks for more than 0."""


def extended(model: Model, base: Base, effects: Sequence[Term], spacing_s: float | None) -> Model:
    """The model with its base changed by this much and with these effects after its own.

    The correlation of neighbouring readings is that over `spacing_s`; None: there is none.
    """
    sensor = model.sensor
    mixture = sensor.reading_model
    weights = mixture.weights
    changes = {"hit": 0.0, **{name: getattr(base, f"log_odds_{name}") for name in ("short", "missed", "random")}}
    odds = {
        name: max(getattr(weights, name), LEAST_SHARE if change else 0.0) * float(np.exp(change))
        for name, change in changes.items()
    }
    total = sum(odds.values())
    factor = float(np.exp(base.log_sigma))
    update: dict[str, Any] = {
        "weights": weights.model_copy(update={name: value / total for name, value in odds.items()}).model_dump(),
        "sigma_cm": float(np.clip(mixture.sigma_cm * factor, 0.01, 100.0)),
        "sigma_growth_cm_per_m": min(mixture.sigma_growth_cm_per_m * factor, 100.0),
        "short_rate_per_m": min(mixture.short_rate_per_m * float(np.exp(base.log_rate)), 1000.0),
        "saturated_fraction": float(np.clip(mixture.saturated_fraction + base.saturated, 0.0, 1.0)),
        "correlation": float(np.clip(mixture.correlation + base.correlation, 0.0, MAX_CORRELATION)),
        "correlation_spacing_s": mixture.correlation_spacing_s if spacing_s is None else spacing_s,
    }
    sensor = SensorModel.model_validate(
        {
            **sensor.model_dump(),
            "calibration": [knot.model_dump() for knot in _shifted_knots(sensor, base.offset_cm)],
            "reading_model": {**mixture.model_dump(), **update},
        }
    )
    return Model(sensor, (*model.effects, *effects))


def _shifted_knots(sensor: SensorModel, offset_cm: float) -> tuple[CalibrationKnot, ...]:
    """The calibration's knots with an offset; a knot has to read more than 0, so the first one may move outwards."""
    if offset_cm == 0.0:
        return sensor.calibration
    curve = sensor.calibration_curve
    first_cm = max(curve.inverse(LEAST_READING_CM - offset_cm), 0.0)
    true_cm = [knot.true_cm for knot in sensor.calibration] or [100.0, 500.0]
    if true_cm[0] < first_cm:
        true_cm = [first_cm, *(knot_cm for knot_cm in true_cm if knot_cm > first_cm + 1.0)]
    if len(true_cm) < 2:
        true_cm.append(true_cm[0] + 100.0)
    return tuple(CalibrationKnot(true_cm=knot_cm, reading_cm=curve.forward(knot_cm) + offset_cm) for knot_cm in true_cm)


def entry_of(term: Term) -> dict[str, Any]:
    """An effect as an entry of a model file's ``effects``."""
    entry: dict[str, Any] = {"name": term.effect.name}
    if term.shape is not None:
        channel, variables, knots = term.shape
        places = [{"period": own.period} if isinstance(own, Ripple) else list(own) for own in knots]
        entry |= {"channel": channel, "variables": list(variables), "knots": places}
        return entry | {"values": [float(value) for value in term.values.values()]}
    if term.of is not None:
        entry["of"] = term.of
    return entry | {"parameters": {name: float(value) for name, value in term.values.items()}}


def to_sensor(model: Model) -> SensorModel:
    """The content of a sensor model file for a model, its effects as entries."""
    effects = [entry_of(term) for term in model.effects]
    return SensorModel.model_validate({**model.sensor.model_dump(), "effects": effects})
