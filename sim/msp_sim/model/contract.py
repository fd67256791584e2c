"""Checks of what the simulator and the gap workflow require of an effect; anybody can run them on an own effect.

Each check returns what is wrong with an effect, in words for the author of the effect. Fits use the probabilities and
their slopes, the simulator uses the draws, and both must describe the same distribution. Every effect of the catalogue
passes (`tests/property/test_effects.py`), and ``msp-lab check-effect`` runs the same checks on a file.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
from scipy.stats import chisquare, kstest

from msp_range.arrays import Array, Column, numbered
from msp_range.reading_model.kernel import on_grid
from msp_range.reading_model.rows import FREE, MIN_PROBABILITY, Base
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.sensors.mb1242 import CLOCK_FAULT_BIT
from msp_sim.effects.base import TRUE_RANGE, Channel, Effect
from msp_sim.effects.plain import plain_finding
from msp_sim.model.model import Model
from msp_sim.model.sampler import Sampler
from msp_sim.model.streams import RandomStreams
from msp_sim.model.trial import VISIBLE_NATS, Columns, Trial

UNLIKELY = 1e-4
"""p-value below which draws do not follow the probabilities: a correct effect fails one check in ten thousand."""


def codes(sensor: SensorModel) -> Array:
    """Every number that a sensor or a fault of its bus can send [cm]; probabilities over them sum to one."""
    step_cm = sensor.resolution_cm
    sent = on_grid(np.arange(round(sensor.maximum_cm / step_cm) + 1) * step_cm, step_cm)
    return np.concatenate([sent, CLOCK_FAULT_BIT + sent])


@dataclass(frozen=True)
class Check:
    """A requirement on an effect."""

    title: str
    """The requirement, as it is printed."""
    find: Callable[["Trial"], str | None]
    """Returns what is wrong with an effect; None if nothing is."""
    advice: str
    """How to correct it."""


@dataclass(frozen=True)
class Result:
    """The outcome of a check; ``found`` is None if the effect passes."""

    check: Check
    found: str | None


def _draw(model: Model, given: Columns, seed: int) -> Array:
    return model.sample(given, np.random.default_rng(seed))


def _rows(columns: Columns, rows: Any) -> Columns:
    """Some rows of a table, by a slice or by their places, which may repeat."""
    return {name: column[rows] for name, column in columns.items()}


def _description(trial: Trial) -> str | None:
    return next(_description_faults(trial.effect), None)


def _description_faults(effect: Effect) -> Iterator[str]:
    if not (effect.name.isidentifier() and effect.name == effect.name.lower()):
        yield f"the name is {effect.name!r}"
    if not effect.sentence.endswith("."):
        yield f"the sentence {effect.sentence!r} does not end with a full stop"
    try:
        plain_finding(effect, effect.neutral_values(), "front")
    except (KeyError, ValueError, IndexError) as error:
        yield f"the finding {effect.finding!r} cannot be filled in: {error}"
    for key in ("physics", "source", "experiment"):
        if not getattr(effect, key) or getattr(effect, key).endswith("."):
            yield f"{key} is empty, or ends with a full stop"
    for key in ("requires", "optional", "channels"):
        if isinstance(getattr(effect, key), str):
            yield f'{key} is a text, where a list of one is ("name",) with a comma'
            return
    if not effect.channels or not {*effect.channels} <= {*get_args(Channel)}:
        yield f"the channels are {effect.channels}"
    if not any(parameter.neutral is not None for parameter in effect.parameters):
        yield "no parameter has a neutral value, at which the effect does nothing"
    for parameter in effect.parameters:
        if (parameter.neutral is None) == (parameter.default is None):
            yield f"parameter {parameter.name} does not have exactly one of neutral and default"
        for value in (parameter.neutral, parameter.default, *parameter.grid):
            if value is not None and not parameter.low <= value <= parameter.high:
                bounds = f"{parameter.low:g} to {parameter.high:g}"
                yield f"parameter {parameter.name}: {value:g} is outside its bounds {bounds}"


def _runs(trial: Trial) -> str | None:
    channels = trial.channels()
    trial.model.rows(trial.contexts(100))
    if channels - {*trial.effect.channels}:
        return f"it changes {', '.join(sorted(channels))}, but says {', '.join(trial.effect.channels)}"
    return None


def _shows(trial: Trial) -> str | None:
    gain = trial.gain(trial.strong)
    if not np.isfinite(gain):
        return "some readings that it draws have no probability"
    return None if gain > VISIBLE_NATS else f"the model with it explains its own readings {gain:.1g} nats better"


def _neutral(trial: Trial) -> str | None:
    base, given = trial.neighbour(), trial.contexts(3000)
    neutral = Model(base.sensor, (*base.effects, trial.at(trial.effect.neutral_values())))
    readings_cm = _draw(base, given, 4)
    other = (_draw(neutral, given, 4) != readings_cm).sum()
    if other:
        return f"at its neutral values {other} of 3000 readings differ from those without it"
    off = np.abs(neutral.log_prob(readings_cm, given) - base.log_prob(readings_cm, given)).max()
    return None if off < 1e-8 else f"at its neutral values log probabilities differ by up to {off:.2g}"


def _requires_context(trial: Trial) -> str | None:
    effect, base, given = trial.effect, trial.neighbour(), trial.contexts(3000)
    with_effect = trial.on(base)
    readings_cm = _draw(base, given, 4)
    for column in sorted({*effect.requires, *([effect.per] if effect.per else [])} - {TRUE_RANGE}):
        absent = {key: values for key, values in given.items() if key != column}
        empty = np.full(3000, "" if given[column].dtype.kind == "U" else np.nan)
        for unknown, how in ((absent, "is absent"), ({**given, column: empty}, "is empty")):
            drawn_cm = _draw(with_effect, unknown, 4)
            scores_differ = with_effect.log_prob(readings_cm, unknown) != base.log_prob(readings_cm, unknown)
            if (drawn_cm != readings_cm).any() or scores_differ.any():
                return f"it changes readings although the column {column} {how}"
    return None


def _sums(trial: Trial) -> str | None:
    rows, every = 24, codes(trial.base.sensor)
    each = _rows(trial.contexts(rows, 5), np.repeat(np.arange(rows), every.size))
    p = np.exp(trial.model.log_prob(np.tile(every, rows), each)).reshape(rows, every.size)
    off = np.abs(p.sum(axis=1) - 1.0).max()
    return None if off < 1e-9 else f"the probabilities of all codes sum to 1 {off:+.2g} in some context"


def _slopes(trial: Trial) -> str | None:
    n = 2000
    rows = trial.model.rows(trial.contexts(n, 4))
    rng = np.random.default_rng(6)
    reading_cm = np.where(rng.random(n) < 0.7, rows.sample(RandomStreams(rng)), rng.choice(codes(trial.base.sensor), n))
    reading_cm[:10] += 0.5 * trial.base.sensor.resolution_cm
    log_p, by = rows.scores(reading_cm)
    if np.abs(log_p - np.maximum(rows.log_prob(reading_cm), np.log(MIN_PROBABILITY))).max() > 1e-9:
        return "log probabilities with and without slopes differ"
    can = log_p > np.log(1e-11)
    with np.errstate(invalid="ignore"):
        for j, name in enumerate(FREE):
            step = 1e-4 * (rows.sigma_cm if j == 0 else 1.0)
            more, less = (rows.changed(Base(**{name: h})) for h in (step, -step))
            # A saturated fraction of 0 is not lowered.
            apart = more.saturated_fraction - less.saturated_fraction if name == "saturated" else 2.0 * step
            numeric = ((more.log_prob(reading_cm) - less.log_prob(reading_cm)) / apart)[can]
            # Short readings end at the hit: where a step of it crosses the edge of a code there is a kink.
            close = np.isclose(by[can, j], numeric, rtol=5e-3, atol=2e-2 if j == 0 else 5e-3)
            if not close.all():
                return f"the slope by {name} is off in {(~close).sum()} of {n} readings"
    return None


def _draws(trial: Trial) -> str | None:
    """The randomised probability integral transform is uniform over contexts of all kinds."""
    given = trial.contexts(40_000)
    p_value = uniformity(trial.model, given)
    return None if p_value > UNLIKELY else f"readings drawn in 40,000 contexts do not follow it (p = {p_value:.1g})"


def uniformity(model: Model, given: Columns) -> float:
    """p-value of a model's own draws under its probabilities; 0 where one has none."""
    readings_cm = _draw(model, given, 2)
    rows = model.rows(given)
    p = np.exp(rows.log_prob(readings_cm))
    if not (p > 0.0).all():
        return 0.0
    transformed = np.exp(rows.log_below(readings_cm)) + p * np.random.default_rng(3).random(p.size)
    return float(kstest(transformed, "uniform").pvalue)


def _draws_of_one(trial: Trial) -> str | None:
    """Chi-square, code by code, in four contexts in which the effect acts."""
    model, n, every = trial.model, 20_000, codes(trial.base.sensor)
    few = trial.contexts(500, 8)
    before_cm = few["previous_reading_cm"].astype(float)
    acting = np.flatnonzero(model.log_prob(before_cm, few) != trial.base.log_prob(before_cm, few))[:4]
    for row in acting:
        given = _rows(few, np.repeat(row, n))
        given["run"] = np.arange(n).astype(str) if trial.effect.per is None else given["run"]
        readings_cm = _draw(model, given, int(row))
        expected = n * np.exp(model.log_prob(every, _rows(few, np.repeat(row, every.size))))
        observed = np.bincount(np.searchsorted(every, readings_cm), minlength=every.size)
        where = ", ".join(f"{column} {few[column][row]}" for column in sorted(trial.effect.columns))
        if observed[expected == 0.0].any():
            return f"with {where} it draws readings that have no probability"
        sums = _grouped(observed[expected > 0.0], expected[expected > 0.0])
        if sums[0].size > 1 and chisquare(*sums).pvalue < UNLIKELY:
            return f"with {where} readings do not come as often as their probabilities say"
    return None


def _grouped(observed: Column, expected: Column) -> tuple[Column, Column]:
    """Counts of neighbouring codes together, ten or more expected in each group."""
    group = np.floor(np.cumsum(expected) / 10.0).astype(int)
    group = numbered(group)
    group[group == group.max()] = max(group.max() - 1, 0)
    return np.bincount(group, observed), np.bincount(group, expected)


def _one_at_a_time(trial: Trial) -> str | None:
    model, few, n = trial.model, trial.contexts(150), 150
    sampler, streams = Sampler(model, np.random.default_rng(7)), RandomStreams(np.random.default_rng(7))
    for i in range(n):
        one = {column: values[i].item() for column, values in few.items()}
        unknown_as_none = {key: None if value != value else value for key, value in one.items()}
        many = model.sample(_rows(few, slice(i, i + 1)), streams)
        alone = sampler.sample_one(unknown_as_none)
        if alone != many[0]:
            return f"reading {i + 1} drawn alone is {alone}, and {many[0]:.0f} drawn with others"
    return None


def _alone(trial: Trial) -> str | None:
    """Probabilities of parts of a table equal those of the whole table."""
    model, given, n = trial.model, trial.contexts(600), 600
    readings_cm = _draw(model, given, 4)
    together = model.log_prob(readings_cm, given)
    parts = [slice(i, i + 60) for i in range(0, n, 60)]
    apart = [model.log_prob(readings_cm[part], _rows(given, part)) for part in parts]
    differ = int((np.concatenate(apart) != together).sum())
    return f"{differ} of {n} probabilities depend on the other readings of the table" if differ else None


def _leaves_others(trial: Trial) -> str | None:
    n, effect = 3000, trial.effect
    given = trial.contexts(n)
    inactive = np.zeros(n, dtype=bool)
    for column in effect.requires:
        here = given[column]
        inactive |= (here == "") if here.dtype.kind == "U" else np.isnan(here)
    others: dict[str, dict[str, Any]] = {
        "multipath": {"share": 0.3},
        "range_scale": {"scale_pct": 3.0},
        "or_ed_bytes": {"share": 0.5},
    }
    for name, values in others.items():
        if name == effect.name:
            continue
        other = trial.base.adding(name, **values)
        readings_cm = _draw(other, given, 9)
        for both in (trial.on(other), Model(other.sensor, (trial.strong, *other.effects))):
            same = _draw(both, given, 9) == readings_cm
            if not same[inactive].all():
                return f"next to {name}, readings change where it has no effect"
    return None


def _rare(trial: Trial) -> str | None:
    if "share" not in trial.effect.neutral_values() or not {"component", "code"} & {*trial.effect.channels}:
        return None
    n = 20_000
    given = trial.contexts(n)
    readings_cm = _draw(trial.base, given, 9)
    rare = Model(trial.base.sensor, (trial.at(dict(trial.strong.values) | {"share": 0.01}),))
    changed = float((_draw(rare, given, 9) != readings_cm).mean())
    return None if changed < 0.0125 else f"with a share of 1 % it changes {100 * changed:.1f} % of the readings"


CHECKS = (
    Check(
        "it is described, and its values lie within its bounds",
        _description,
        "fill in every field of Effect and Parameter; a parameter has a neutral value (no effect) or a default",
    ),
    Check(
        "it runs, and changes the channels that it states",
        _runs,
        "channels must list what the Contribution of apply changes, and requires or optional every column that it uses",
    ),
    Check(
        "it is visible",
        _shows,
        "check that apply uses every parameter and that requires names the columns it depends on; widen the bounds",
    ),
    Check(
        "at its neutral values it does nothing",
        _neutral,
        "at the neutral values apply must return zero shifts and shares",
    ),
    Check(
        "it does nothing if a required column is unknown",
        _requires_context,
        "list every column that apply uses in requires, or in optional if it can do without it",
    ),
    Check(
        "probabilities sum to one",
        _sums,
        "return shares from 0 to 1 and finite shifts; a component's probabilities must sum to one on their own",
    ),
    Check(
        "slopes are the derivatives of the probabilities", _slopes, "check the component's or the code fault's slopes"
    ),
    Check(
        "draws follow the probabilities",
        _draws,
        "check that the component or code fault draws from the distribution whose probabilities it gives",
    ),
    Check(
        "draws follow the probabilities, code by code",
        _draws_of_one,
        "check that the component or code fault draws from the distribution whose probabilities it gives",
    ),
    Check(
        "a single reading is drawn like many",
        _one_at_a_time,
        "apply is called with plain numbers too: use numpy functions (np.maximum, np.where), not array methods",
    ),
    Check(
        "a reading depends on its own context only",
        _alone,
        "apply must not use a mean, minimum or maximum over a column, nor keep anything from one call to the next",
    ),
    Check(
        "the draws of other effects are unchanged",
        _leaves_others,
        "list every column that apply depends on in requires, and draw no random numbers in apply",
    ),
    Check("a share is a share of the readings", _rare, "the parameter share is the share of readings that it changes"),
)


def run_checks(effect: Effect, sensor: SensorModel) -> Iterator[Result]:
    """Run all checks of an effect on a sensor; if one of the first two fails, the others are omitted."""
    trial = Trial(effect, sensor)
    for i, check in enumerate(CHECKS):
        try:
            found = check.find(trial)
        except Exception as error:  # Any exception of the author's code is the finding.
            found = f"it raises {type(error).__name__}: {error}"
        yield Result(check, found)
        if found is not None and i < 2:
            return
