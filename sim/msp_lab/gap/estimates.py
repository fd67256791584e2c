"""Effects, curves and numbers of the base with their intervals, as the records of ``gap.json``.

Validated terms and the fit of the held-out runs enter, records leave. Values and intervals are those of the held-out
runs: on the runs on which an effect was selected it looks larger than it is.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from msp_lab.gap import experiment, rules
from msp_lab.gap.candidates import Key
from msp_lab.gap.exchange import AlternativeTerm
from msp_lab.gap.findings import Alternative, CalibrationFinding, FittedValue, FoundEffect, UnknownEffect
from msp_lab.gap.formula import formula
from msp_lab.gap.prepared import BASE, Prepared
from msp_lab.gap.problem import Problem, State
from msp_lab.gap.refit import JointFit, knot_weights
from msp_lab.gap.screen import Screen
from msp_lab.gap.validation import Gain, Validated
from msp_sim.model.model import Term

_Array = NDArray[np.float64]
UNITS = {"offset_cm": "cm", "sigma_cm": "cm", "short_rate_per_m": "1/m"}


@dataclass(frozen=True)
class HeldOutFit:
    """The fit of the held-out readings, with the half widths of its 95 % intervals.

    Attributes
    ----------
    readings, fit
        What was fitted.
    widened
        Covariance of its numbers times the square of `width`.
    width
        Standard errors on each side of a value.
    """

    readings: Prepared
    fit: JointFit
    widened: _Array
    width: float

    @classmethod
    def of(cls, readings: Prepared, fit: JointFit, unit: NDArray[np.intp], by_run: bool) -> "HeldOutFit":
        """With errors by whole runs, of which there are few, or by readings."""
        covariance = fit.covariance(unit if by_run else None)
        runs = int(np.unique(unit).size)
        width = float(student.isf(0.025, max(runs - 1, 1))) if by_run else 1.959964
        return cls(readings, fit, covariance * width**2, width)

    @property
    def half_widths(self) -> _Array:
        """Of each number; 0 for one that is held at a bound, whose error is not known."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.widened), 0.0)))


def found_terms(
    problem: Problem,
    base_fit: JointFit,
    validated: Validated,
    alternatives: Mapping[Key, tuple[AlternativeTerm, ...]],
    held_out: HeldOutFit,
) -> tuple[list[FoundEffect], list[UnknownEffect], list[CalibrationFinding]]:
    """Each term as an effect, an unknown effect, or the calibration of a number of the base.

    `base_fit` is the fit before any term, `held_out` the one that gives the values.
    """
    effects: list[FoundEffect] = []
    unknown: list[UnknownEffect] = []
    calibration: list[CalibrationFinding] = []
    place = len(BASE)
    for term, active in zip(validated.state.terms, held_out.fit.effects, strict=True):
        own = slice(place, place + len(active.effect.parameters))
        place = own.stop
        gained = validated.gains[term.key]
        if active.shape is not None:
            unknown.append(_unknown_effect(active, held_out.widened[own, own], gained, held_out.readings))
            continue
        near = alternatives.get(term.key, ())
        values = _values(active, held_out.half_widths[own])
        base = active.effect.base
        if base is not None and not near:
            number = next(iter(values.values()))
            if number.low is not None and number.high is not None and not number.low <= 0.0 <= number.high:
                calibration.append(_calibration(base, 0.0, number.value, number.low, number.high, number.unit))
            continue
        effects.append(
            FoundEffect(
                active.effect.name,
                "indistinguishable" if near else "named",
                values,
                gained.nats_per_reading,
                gained.z or None,
                tuple(
                    Alternative(each.active.effect.name, each.loss_nats, each.correlation, each.active.of)
                    for each in near
                ),
                experiment.to_tell_apart(problem, base_fit, term, near) if near else active.effect.experiment,
                active.of,
            )
        )
    return effects, unknown, calibration


def _values(active: Term, half_widths: _Array) -> dict[str, FittedValue]:
    values = {}
    for parameter, half in zip(active.effect.parameters, half_widths.tolist(), strict=True):
        value = active.values[parameter.name]
        low = max(value - half, parameter.low) if half > 0.0 else None
        high = min(value + half, parameter.high) if half > 0.0 else None
        values[parameter.name] = FittedValue(value, low, high, parameter.unit)
    return values


def _unknown_effect(active: Term, widened: _Array, gained: Gain, readings: Prepared) -> UnknownEffect:
    """A curve about its mean, which it shares with the base; `widened` is its covariance times the width squared."""
    assert active.shape is not None
    channel, variables, knots = active.shape
    weights = knot_weights(readings.scene, active.shape).mean(axis=0)
    about_mean = np.eye(weights.size) - weights / max(weights.sum(), 1e-12)
    values = about_mean @ np.array(list(active.values.values()))
    half = np.sqrt(np.maximum(np.diag(about_mean @ widened @ about_mean.T), 0.0))
    if len(variables) > 1:
        return UnknownEffect(channel, variables, "", gained.nats_per_reading)
    if isinstance(knots[0][0], str):
        text = ", ".join(f"{knot}: {value:.3g}" for knot, value in zip(knots[0], values, strict=True))
        return UnknownEffect(channel, variables, text, gained.nats_per_reading)
    at = np.array(knots[0], dtype=float)
    points = np.column_stack([at, values, values - half, values + half]).tolist()
    text = formula(variables[0], at, values, half / 2.0)
    return UnknownEffect(
        channel, variables, text, gained.nats_per_reading, tuple((x, y, low, high) for x, y, low, high in points)
    )


def calibrated(problem: Problem, state: State, training: JointFit, held_out: HeldOutFit) -> list[CalibrationFinding]:
    """Numbers of the base that both halves of the readings say are others."""
    mixture, base = problem.model.sensor.reading_model, held_out.fit.base
    shares = mixture.weights
    covariance = training.covariance(problem.some_unit if state.by_run else None)
    # The shares' sum, which is 1 again in the file.
    total = shares.hit + float(np.array([shares.short, shares.missed, shares.random]) @ np.exp(base[2:5]))
    found = []
    names = ("offset_cm", "sigma_cm", "weights.short", "weights.missed", "weights.random", "short_rate_per_m")
    given = (0.0, mixture.sigma_cm, shares.short, shares.missed, shares.random, mixture.short_rate_per_m)
    numbers = [
        *enumerate(zip(names, given, strict=True)),
        (BASE.index("correlation"), ("correlation", mixture.correlation)),
    ]
    for k, (name, before) in numbers:
        error = float(np.sqrt(max(covariance[k, k], 0.0) / problem.scale))
        z = float(training.base[k] / error) if error > 0.0 else 0.0
        if abs(z) < rules.CALIBRATION_Z or np.sign(training.base[k]) != np.sign(base[k]):
            continue
        half = held_out.half_widths[k]
        number = _times(before / total if name.startswith("weights") else before)
        if name in ("offset_cm", "correlation"):
            number = before.__add__
        value, low, high = (number(float(each)) for each in (base[k], base[k] - half, base[k] + half))
        if not low <= before <= high:
            found.append(_calibration(name, before, value, low, high, UNITS.get(name, "1")))
    return found


def _times(before: float) -> Callable[[float], float]:
    def times(log_factor: float) -> float:
        return max(before, 1e-6) * float(np.exp(min(log_factor, 30.0)))

    return times


def _calibration(name: str, before: float, after: float, low: float, high: float, unit: str) -> CalibrationFinding:
    of = "" if unit == "1" else f" {unit}"
    text = f"{name} is {after:.4g}{of} ({low:.4g} to {high:.4g}) and not {before:.4g}"
    return CalibrationFinding(name, text, before, after, low, high, unit)


def detectable(problem: Problem, first: Screen) -> str:
    """The smallest effects that would have been found, in words, from the first screen."""
    least: dict[tuple[str, str], tuple[float, str]] = {}
    for candidate, error in zip(problem.candidates, first.deviation, strict=True):
        parameter = candidate.parameter
        smallest = ((first.critical + rules.POWER_Z) * float(error)) ** (1.0 / parameter.power)
        key = candidate.effect.name, parameter.name
        if smallest < parameter.high - parameter.low and (key not in least or smallest < least[key][0]):
            least[key] = smallest, parameter.unit
    return "; ".join(
        f"{effect} above {size:.2g} {'' if unit == '1' else unit}".rstrip()
        for (effect, _), (size, unit) in least.items()
    )
