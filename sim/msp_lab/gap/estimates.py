"""Effects, curves and numbers of the base with their intervals, as the records of ``gap.json``.

They are those of the validated terms in the fit of all runs.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.special import stdtrit

from msp_lab.gap import rules
from msp_lab.gap.alternatives import AlternativeTerm, to_tell_apart
from msp_lab.gap.candidates import CandidateEffect, Key, SelectedTerm
from msp_lab.gap.findings import Alternative, CalibrationFinding, FittedValue, FoundEffect, UnknownEffect
from msp_lab.gap.labels import size_label, unit_after, unit_of
from msp_lab.gap.prepared import BASE, CHANNELS, Prepared, templates
from msp_lab.gap.problem import Problem
from msp_lab.gap.refit import JointFit, free_numbers, with_values
from msp_lab.gap.screen import Screen
from msp_lab.gap.validation import Gain, Validated
from msp_range.arrays import Array, Indices
from msp_range.reading_model.rows import Base
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import TRUE_RANGE, Effect
from msp_sim.effects.curve import Ripple, hats, knot_weights
from msp_sim.effects.plain import MOST_TIMES
from msp_sim.effects.range_scale import RANGE_SCALE
from msp_sim.model.model import Term, applies, shifted

NUMBERS = (
    "offset_cm",
    "sigma_cm",
    "weights.short",
    "weights.missed",
    "weights.random",
    "short_rate_per_m",
    "saturated_fraction",
    "correlation",
)
"""What the base's numbers change, in their order, as in a sensor model file."""
UNITS = {"offset_cm": "cm", "sigma_cm": "cm", "short_rate_per_m": "1/m"}
CALIBRATION_SCALE = "calibration.scale"
"""Name of the calibration's scale among the numbers of the base."""
STEP_SHARE = 0.01
"""Two knots that are closer than this share of the column's span are a step, and are written as one."""
AT_BOUND = 1e-3
"""A number within this share of its parameter's range of a bound is at it. Fits end there to 1e-6; larger: numbers that
are near a bound are only suggested."""
FORMULA_SHARE = 0.25
"""A formula may be off at a knot by this share of the curve's size; where all are off by more, the values are listed.
Half of what a line misses at the middle of a step. Larger: formulas with another size than the sentence; smaller: lists
of values in place of formulas that round off their noise."""
RIPPLE_DRAWN, RIPPLE_POINTS = 3, 61
"""Periods of a ripple that are drawn, and points of its curve: it goes on like that."""


@dataclass(frozen=True)
class FinalFit:
    """The fit of all runs, with the half widths of its 95 % intervals."""

    readings: Prepared
    fit: JointFit
    """What was fitted."""
    widened: Array
    """Covariance of its numbers times the square of `width`."""
    width: float
    """Standard errors on each side of a value."""

    @classmethod
    def of(cls, readings: Prepared, fit: JointFit, unit: Indices, by_run: bool) -> "FinalFit":
        """With errors by whole runs, of which there are few, or by readings, and constants as in `with_constants`."""
        covariance = fit.covariance(unit if by_run else None)
        runs = np.unique(unit).size
        width = -float(stdtrit(max(runs - 1, 1), 0.025)) if by_run else 1.959964
        fit, change = with_constants(readings, fit)
        return cls(readings, fit, change @ covariance @ change.T * width**2, width)

    @property
    def half_widths(self) -> Array:
        """Half of the interval of each number; 0 for one that is held at a bound, whose error is not known."""
        return np.asarray(np.sqrt(np.maximum(np.diag(self.widened), 0.0)))


def with_constants(readings: Prepared, fit: JointFit) -> tuple[JointFit, Array]:
    """The same distributions with what curves are on average in the base's own numbers, and the change of the numbers.

    A fit leaves open how much of a constant is a curve's: here its values have mean 0 over the readings, as its formula
    is written. Where its column is not known or is another word a curve is 0, so that its constant stays. For m numbers
    the change is an (m, m) matrix.
    """
    change, scene = np.eye(fit.values.size), shifted(readings.scene, fit.effects)
    place = len(BASE)
    for term in fit.effects:
        own = slice(place, place + len(term.values))
        place = own.stop
        if term.shape is None:
            continue
        channel = CHANNELS.index(term.shape[0])
        higher = term.having({name: value + 1.0 for name, value in term.values.items()})
        own_added, more_added = (
            templates(applies(scene, each), each.change(scene))[channel] for each in (term, higher)
        )
        moved = more_added - own_added
        if np.ptp(moved) > 1e-6:
            continue
        weights = knot_weights(scene, *term.shape[1:]).mean(axis=0)
        change[own, own] -= weights
        # Against the other sensors a constant of the bias moves nothing.
        change[channel, own] = weights * np.round(moved[0])
    values = change @ fit.values
    effects = with_values(fit.effects, free_numbers(fit.effects), values[len(BASE) :])
    return replace(fit, base=Base(*values[: len(BASE)].tolist()), effects=effects, values=values), change


def found_terms(
    problem: Problem,
    base_fit: JointFit,
    validated: Validated,
    alternatives: Mapping[Key, tuple[AlternativeTerm, ...]],
    final: FinalFit,
) -> tuple[list[FoundEffect], list[UnknownEffect], list[CalibrationFinding]]:
    """Each term as an effect, an unknown effect, or the calibration of a number of the base.

    `base_fit` is the fit before any term, `final` the one that gives the values.
    """
    effects: list[FoundEffect] = []
    unknown: list[UnknownEffect] = []
    calibration: list[CalibrationFinding] = []
    place = len(BASE)
    for term, active in zip(validated.state.terms, final.fit.effects, strict=True):
        own = slice(place, place + len(active.effect.parameters))
        place = own.stop
        agreement = validated.agreement[term.key]
        gained = agreement.gain
        if active.shape is not None:
            found = _unknown_effect(active, final.widened[own, own], gained, final.readings)
            causes = _likely_causes(problem, found)
            unknown.append(replace(found, likely_causes=causes, splits_agree=agreement.share))
            continue
        near = alternatives.get(term.key, ())
        values = _values(active, final.half_widths[own])
        if term.candidate is not None:
            name, neutral = term.candidate.parameter.name, term.candidate.neutral
            if values[name].may_be(neutral) or _is_of_all(term.candidate, values[name].value):
                values[name] = _by_likelihood(term, active, final)
        number = next(iter(values.values()))
        base = _number_of_base(problem, active.effect, number, final.width, bool(near))
        if base:
            if number.low is not None and number.high is not None and not number.may_be(0.0):
                calibration.append(_calibration(base, 0.0, number.value, number.low, number.high, number.unit))
            continue
        doubt = _doubt(term, values)
        effects.append(
            FoundEffect(
                active.effect.name,
                "suggested" if doubt else "indistinguishable" if near else "named",
                values,
                gained.nats_per_reading,
                gained.z or None,
                tuple(
                    Alternative(other.active.effect.name, other.loss_nats, other.correlation, other.active.of)
                    for other in near
                ),
                to_tell_apart(problem, base_fit, term, near) if near else active.effect.experiment,
                active.of,
                doubt,
                splits_agree=agreement.share,
                in_model=any(
                    (given.effect.name, given.of) == (active.effect.name, active.of) for given in problem.model.effects
                ),
            )
        )
    return effects, unknown, calibration


def _number_of_base(problem: Problem, effect: Effect, number: FittedValue, width: float, has_alternatives: bool) -> str:
    """The number of the base that an effect calibrates; empty where it differs by more than the bench leaves open.

    The bench's scale stands for all that does as well. Growth that is less than the model's is calibration.
    """
    is_scale, bench_error = effect is RANGE_SCALE, problem.bench_error(effect)
    base = effect.base if bench_error is None or not is_scale else CALIBRATION_SCALE
    if base is None or (has_alternatives and not is_scale):
        return ""
    if bench_error is None or number.low is None or number.high is None:
        return base
    error = np.hypot((number.high - number.low) / (2.0 * width), bench_error)
    is_beyond = (abs(number.value) if is_scale else number.value) > rules.SURE_Z * error
    return "" if is_beyond else base


def _by_likelihood(term: SelectedTerm, active: Term, final: FinalFit) -> FittedValue:
    """A strength with the interval in which the likelihood falls by no more than that of 95 %, all else held.

    For a strength whose standard error says nothing: odds that are as good as 0 or 1 do not change with it any more,
    and a share of all readings is at its bound.
    """
    assert term.candidate is not None
    parameter, neutral = term.candidate.parameter, term.candidate.neutral
    value = active.values[parameter.name]
    parts = np.concatenate([[0.0], np.geomspace(0.01, 10.0, 40), 1.0 - np.geomspace(1e-5, 0.1, 40)])
    grid = np.unique(np.clip(neutral + (value - neutral) * parts, parameter.low, parameter.high))
    k = final.fit.effects.index(active)
    heights = []
    for strength in grid:
        changed = active.having({parameter.name: float(strength)})
        effects = [*final.fit.effects[:k], changed, *final.fit.effects[k + 1 :]]
        heights.append(final.readings.log_likelihood(final.fit.base, effects))
    inside = grid[np.array(heights) > max(heights) - 0.5 * final.width**2]
    return FittedValue(value, float(min(inside.min(), value)), float(max(inside.max(), value)), parameter.unit)


def _is_of_all(candidate: CandidateEffect, value: float) -> bool:
    """Whether all readings have it, a bound at which its strength may well be: a fault of the code, or certain odds."""
    if candidate.odds is not None and candidate.parameter.unit == "1":
        return value > math.log(MOST_TIMES)
    return "code" in candidate.effect.channels and value > candidate.parameter.high - AT_BOUND


def _doubt(term: SelectedTerm, values: Mapping[str, FittedValue]) -> str:
    """Why an effect is only suggested; empty where it is a finding."""
    assert term.candidate is not None
    parameter = term.candidate.parameter
    found = values[parameter.name]
    neutral = term.candidate.neutral
    near = AT_BOUND * (parameter.high - parameter.low)
    at_bound = min(found.value - parameter.low, parameter.high - found.value) < near
    at_bound = at_bound and not _is_of_all(term.candidate, found.value)
    if found.low is None or found.high is None or (at_bound and abs(found.value - neutral) > near):
        return f"{parameter.name} is at its bound, {found.value:.3g}"
    if found.may_be(neutral):
        return f"{parameter.name} may be {neutral:g} ({found.low:.3g} to {found.high:.3g})"
    for shape in term.active.effect.parameters if term.candidate.linear else ():
        if shape.unit == "cm" and shape.high - values[shape.name].value < 1e-3 * (shape.high - shape.low):
            # An echo that is nowhere in particular is no echo: its place or width explains what others leave.
            return f"{shape.name} is at its bound, {values[shape.name].value:.3g} cm"
    return ""


def _likely_causes(problem: Problem, unknown: UnknownEffect) -> tuple[tuple[str, str], ...]:
    """Effects that lack one column and depend on the variables of an unknown effect, with that column."""
    found = []
    for name, absent in problem.untestable:
        effect = CATALOGUE[name]
        reaches = unknown.channel in effect.channels or (
            "component" in effect.channels and unknown.channel in ("short", "random")
        )
        special = set(unknown.variables) - {TRUE_RANGE}
        if len(absent) == 1 and reaches and special and special <= effect.columns:
            found.append((name, absent[0]))
    return tuple(found)


def _values(active: Term, half_widths: Array) -> dict[str, FittedValue]:
    values = {}
    for parameter, half in zip(active.effect.parameters, half_widths.tolist(), strict=True):
        value = active.values[parameter.name]
        low = max(value - half, parameter.low) if half > 0.0 else None
        high = min(value + half, parameter.high) if half > 0.0 else None
        values[parameter.name] = FittedValue(value, low, high, parameter.unit)
    return values


def _unknown_effect(active: Term, widened: Array, gained: Gain, readings: Prepared) -> UnknownEffect:
    """A curve; `widened` is its covariance times the width squared."""
    assert active.shape is not None
    channel, variables, knots = active.shape
    values = np.array(list(active.values.values()))
    half = np.sqrt(np.maximum(np.diag(widened), 0.0))
    at, period, (first, *_) = np.zeros(0), None, knots
    if len(variables) > 1:
        text = (
            f"a table of {len(values)} values over {' and '.join(variables)}, {values.min():.3g} to {values.max():.3g}"
        )
    elif isinstance(first, Ripple):
        period = first.period
        # That of the readings: of a period of two readings they say the phase badly, and so the height between them.
        most_cm = float(np.abs(knot_weights(readings.scene, variables, knots) @ values).max())
        text = f"ripple of {period:.3g} {unit_of(variables[0])} over {variables[0]}, amplitude {most_cm:.2g} cm"
        # Some periods of it in the middle of the readings, where its phase is known best.
        middle = float(np.nanmedian(readings.scene[variables[0]]))
        at = middle + period * np.linspace(-0.5 * RIPPLE_DRAWN, 0.5 * RIPPLE_DRAWN, RIPPLE_POINTS)
        waves = hats({variables[0]: at}, variables, knots)
        values, half = waves @ values, np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", waves, widened, waves), 0.0))
    elif isinstance(first[0], str):
        text = _listed(first, values)
    else:
        at = np.array(first, dtype=float)
        place = readings.scene[variables[0]]
        low, high = float(np.nanmin(place)), float(np.nanmax(place))
        if at.size == 2 and at[1] - at[0] < STEP_SHARE * (high - low):
            rise = values[1] - values[0]
            text = f"{values[0]:.3g} + {rise:.3g} [{variables[0]} > {at.mean():.4g}]".replace("+ -", "- ")
            at, values, half = np.array([low, *at, high]), np.repeat(values, 2), np.repeat(half, 2)
        else:
            text = formula(variables[0], at, values, half / 2.0)
    points = zip(at.tolist(), values.tolist(), (values - half).tolist(), (values + half).tolist(), strict=False)
    return UnknownEffect(
        channel, variables, text, gained.nats_per_reading, tuple(points), period=period, z=gained.z or None
    )


def calibrated(problem: Problem, final: FinalFit, training: JointFit) -> list[CalibrationFinding]:
    """Numbers of the base that all runs, and the training runs alone, say are others."""
    mixture, base = problem.model.sensor.reading_model, final.fit.base
    shares = mixture.weights
    # The shares' sum, which is 1 again in the file.
    total = shares.hit + float(np.array([shares.short, shares.missed, shares.random]) @ np.exp(base[2:5]))
    found = []
    for k, name in enumerate(NUMBERS):
        before, half = attrgetter(name)(mixture) if k else 0.0, final.half_widths[k]
        z = float(base[k] * final.width / half) if half > 0.0 else 0.0
        if abs(z) < rules.CALIBRATION_Z or np.sign(training.base[k]) != np.sign(base[k]):
            continue
        change = base[k] + half * np.array([0.0, -1.0, 1.0])
        if name in ("offset_cm", "saturated_fraction", "correlation"):
            numbers = before + change
        else:
            given_share = before / total if name.startswith("weights") else before
            numbers = max(given_share, 1e-6) * np.exp(np.minimum(change, 30.0))
        value, low, high = numbers.tolist()
        # What rounds to the given value is that value.
        if not low <= before <= high and f"{value:.2g}" != f"{before:.2g}":
            found.append(_calibration(name, before, value, low, high, UNITS.get(name, "1")))
    return found


def _calibration(name: str, before: float, after: float, low: float, high: float, unit: str) -> CalibrationFinding:
    text = f"{name} is {after:.4g}{unit_after(unit)} ({low:.4g} to {high:.4g}) and not {before:.4g}"
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
    return "; ".join(f"{effect} above {size_label(name, *size)}" for (effect, name), size in least.items())


def _listed(knots: Sequence[Any], values: Array) -> str:
    return ", ".join(f"{knot}: {value:.3g}" for knot, value in zip(knots, values, strict=True))


def formula(variable: str, at: Array, values: Array, deviation: Array) -> str:
    """The shortest form of a small grammar that goes through a curve, with its numbers; its values where none does.

    Parameters
    ----------
    variable
        Its name.
    at, values, deviation
        Knots, values there and their standard errors, (k,).
    """
    largest = float(np.abs(values).max(initial=0.0))
    weight = 1.0 / np.maximum(deviation, 1e-9 + 1e-3 * largest) ** 2
    most_off = max(FORMULA_SHARE * float(np.ptp(values)), 1e-9 * largest)
    span = float(at[-1] - at[0]) or 1.0
    best = np.inf, _listed([f"{knot:.4g}" for knot in at], values)
    for text, columns, shapes in _grammar(variable, at, span):
        design = np.column_stack([np.ones(at.size), *columns])
        root = np.sqrt(weight)
        solution = np.linalg.lstsq(design * root[:, None], values * root, rcond=None)[0]
        off = values - design @ solution
        cost = float((weight * off**2).sum()) + 2.0 * (design.shape[1] + shapes)
        if cost < best[0] - 1e-9 and np.abs(off).max() <= most_off:
            best = cost, text.format(*(f"{number:.3g}" for number in solution))
    return best[1].replace("+ -", "- ")


def _grammar(variable: str, at: Array, span: float) -> Iterator[tuple[str, list[Array], int]]:
    yield f"{{0}} + {{1}} {variable}", [at], 0
    yield f"{{0}} + {{1}} {variable} + {{2}} {variable}^2", [at, at**2], 0
    for cycles in (0.5, 0.75, 1.0, 1.5, 2.0, 2.5, 3.0):
        wave = 2.0 * np.pi * cycles / span
        yield (
            f"{{0}} + {{1}} sin({wave:.3g} {variable}) + {{2}} cos({wave:.3g} {variable})",
            [np.sin(wave * at), np.cos(wave * at)],
            1,
        )
    for middle in (at[:-1] + at[1:]) / 2.0:
        yield f"{{0}} + {{1}} [{variable} > {middle:.3g}]", [(at > middle).astype(float)], 1
        yield (
            f"{{0}} + {{1}} tanh(({variable} - {middle:.3g}) / {span / 8:.3g})",
            [np.tanh((at - middle) / (span / 8))],
            2,
        )
    for length in (span / 8, span / 4, span / 2):
        yield (
            f"{{0}} + {{1}} exp(-{variable} / {length:.3g})",
            [np.exp(-(at - at[0]) / length) * np.exp(-at[0] / length)],
            1,
        )
    if variable.endswith("_deg") and np.all(np.abs(at) < 80.0):
        yield f"{{0}} + {{1}} / cos({variable})", [1.0 / np.cos(np.radians(at))], 0
