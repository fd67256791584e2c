"""What naming and the confirming runs found, as the records of ``gap.json``: effects, curves and numbers of the base.

Items that were kept and the fit of the confirming runs enter, `findings` records leave. Values and intervals are those
of the confirming runs: on the runs that chose an effect it looks larger than it is.
"""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import adequacy, experiment
from msp_lab.gap.findings import Calibration, FoundEffect, Rival, Unknown, Value
from msp_lab.gap.prove import Gain
from msp_lab.gap.refit import Fitted, hats_of
from msp_lab.gap.rivals import RivalOf
from msp_lab.gap.search import Item, Search
from msp_lab.gap.tangent import BASE, Prepared
from msp_sim.model.model import Active, Model

_Array = NDArray[np.float64]
SURE_Z = 4.0
"""Standard errors by which a base parameter has to move to be told as calibration."""
UNITS = {"offset_cm": "cm", "sigma_cm": "cm", "short_rate_per_m": "1/m"}


def told(
    search: Search,
    items: Sequence[Item],
    rivals: Mapping[tuple[str, str | None], tuple[RivalOf, ...]],
    gains: Mapping[tuple[str, str | None], Gain],
    quoted: Fitted,
    widened: _Array,
    confirming: Prepared,
) -> tuple[list[FoundEffect], list[Unknown], list[Calibration]]:
    named: list[FoundEffect] = []
    unknown: list[Unknown] = []
    as_base: list[Calibration] = []
    place = len(BASE)
    half_width = np.sqrt(np.maximum(np.diag(widened), 0.0))
    for item, active in zip(items, quoted.effects, strict=True):
        if active.shape is not None:
            own = slice(place, place + len(active.values))
            unknown.append(_unknown(active, widened[own, own], gains[item.key], confirming))
            place = own.stop
            continue
        parameters = {}
        for parameter in active.effect.parameters:
            value, width = active.values[parameter.name], float(half_width[place])
            # At its bound a number is held there, and how sure it is is not known.
            low = max(value - width, parameter.low) if width > 0.0 else None
            high = min(value + width, parameter.high) if width > 0.0 else None
            parameters[parameter.name] = Value(value, low, high, parameter.unit)
            place += 1
        proof = gains[item.key]
        base = active.effect.base
        if base is not None and not rivals.get(item.key):
            number = next(iter(parameters.values()))
            if number.low is not None and number.high is not None and not number.low <= 0.0 <= number.high:
                as_base.append(_calibration(base, 0.0, number.value, number.low, number.high, number.unit))
            continue
        near = tuple(
            Rival(each.active.effect.name, each.loss, each.correlation, each.active.of)
            for each in rivals.get(item.key, ())
        )
        named.append(
            FoundEffect(
                active.effect.name,
                "indistinguishable" if near else "named",
                parameters,
                proof.nats_per_reading,
                proof.z or None,
                near,
                experiment.to_tell_apart(search, item, rivals[item.key]) if near else active.effect.experiment,
                active.of,
            )
        )
    return named, unknown, as_base


def _unknown(active: Active, widened: _Array, proof: Gain, confirming: Prepared) -> Unknown:
    """A curve about its mean, which it shares with the base; `widened` is its covariance times the width squared."""
    assert active.shape is not None
    channel, variables, knots = active.shape
    weights = hats_of(confirming.scene, active.shape).mean(axis=0)
    about_mean = np.eye(weights.size) - weights / max(weights.sum(), 1e-12)
    values = about_mean @ np.array(list(active.values.values()))
    half = np.sqrt(np.maximum(np.diag(about_mean @ widened @ about_mean.T), 0.0))
    low, high = values - half, values + half
    text = ""
    if len(variables) == 1 and not isinstance(knots[0][0], str):
        text = adequacy.formula(variables[0], np.array(knots[0], dtype=float), values, half / 2.0)
    elif len(variables) == 1:
        text = ", ".join(f"{knot}: {value:.3g}" for knot, value in zip(knots[0], values, strict=True))
    points: tuple[tuple[float, float, float, float], ...] = ()
    if len(variables) == 1 and not isinstance(knots[0][0], str):
        points = tuple(
            zip(*(np.asarray(each, dtype=float).tolist() for each in (knots[0], values, low, high)), strict=True)
        )
    return Unknown(channel, variables, text, proof.nats_per_reading, points)


def calibrated(
    model: Model, search: Search, last: Fitted, quoted: Fitted, deviation: _Array, width: float
) -> tuple[Calibration, ...]:
    """Base parameters that both halves say are others."""
    mixture = model.sensor.reading_model
    shares = mixture.weights
    covariance = last.covariance(search.some_unit if search.by_run else None)
    # Of the shares' sum, which is 1 again in the file.
    total = shares.hit + float(np.array([shares.short, shares.missed, shares.random]) @ np.exp(quoted.base[2:5]))
    found = []
    names = ("offset_cm", "sigma_cm", "weights.short", "weights.missed", "weights.random", "short_rate_per_m")
    starts = (0.0, mixture.sigma_cm, shares.short, shares.missed, shares.random, mixture.short_rate_per_m)
    for k, (key, start) in enumerate(zip(names, starts, strict=True)):
        error = float(np.sqrt(max(covariance[k, k], 0.0) / search.scale))
        z = float(last.base[k] / error) if error > 0.0 else 0.0
        if abs(z) < SURE_Z or np.sign(last.base[k]) != np.sign(quoted.base[k]):
            continue
        value, half = quoted.base[k], deviation[k] * width
        turn: Callable[[float], float] = (
            float if k == 0 else _times(start / total if key.startswith("weights") else start)
        )
        low, high = turn(float(value - half)), turn(float(value + half))
        # What the confirming runs leave open is not said.
        if not low <= start <= high:
            found.append(_calibration(key, start, turn(float(value)), low, high, UNITS.get(key, "1")))
    return tuple(found)


def _times(start: float) -> Callable[[float], float]:
    def times(log_factor: float) -> float:
        return max(start, 1e-6) * float(np.exp(min(log_factor, 30.0)))

    return times


def _calibration(name: str, before: float, after: float, low: float, high: float, unit: str) -> Calibration:
    of = "" if unit == "1" else f" {unit}"
    text = f"{name} is {after:.4g}{of} ({low:.4g} to {high:.4g}) and not {before:.4g}"
    return Calibration(name, text, before, after, low, high, unit)
