"""An effect at a strength at which it is visible, and contexts for it: what the checks of an effect work on."""

from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import TypeAlias

import numpy as np

from msp_range.arrays import Column
from msp_range.reading_model.rows import MIN_PROBABILITY
from msp_range.reading_model.sensor_model import SensorModel
from msp_sim.effects.base import TRUE_RANGE, WORD_COLUMNS, Effect, Scene
from msp_sim.effects.curve import FIELDS
from msp_sim.model.model import Model, Term

Columns: TypeAlias = dict[str, Column]
STRENGTHS = (0.3, 0.6, 1.0)
"""Fractions of the way from the neutral value to the farther bound; an effect is checked at the first one at which it
is visible. Weaker effects hide errors in the noise; at the bound itself some effects saturate."""
VISIBLE_NATS = 1e-3
"""An effect that improves the log probability of its own readings by less than this (nats per reading) is not visible:
of 40,000 readings random variation alone gives about 1e-5."""
WORDS = {"sensor": "left", "run": "3", "target": "grass"}
"""The sensor, run or target to which an effect of one of them is applied."""
_CHANGES = {field: channel for channel, field in FIELDS.items()} | {
    "run_offset_cm": "spread",
    "component": "component",
    "fault": "code",
}
"""Channel that a field of a `Contribution` changes."""


class Trial:
    """An effect at a strength at which it is visible, with contexts for the checks.

    Parameters
    ----------
    effect
        The effect to check.
    sensor
        The sensor model that it changes; its own effects are left out.
    """

    def __init__(self, effect: Effect, sensor: SensorModel) -> None:
        self.effect = effect
        self.base = Model(sensor.model_copy(update={"effects": ()}))

    @cached_property
    def strong(self) -> Term:
        """The effect at the first of `STRENGTHS` at which it is visible, or at the last."""
        for strength in STRENGTHS:
            term = self.at(strong_values(self.effect, strength))
            if self.gain(term) > VISIBLE_NATS:
                break
        return term

    @cached_property
    def model(self) -> Model:
        """The base model with the strong effect."""
        return self.on(self.base)

    def at(self, values: Mapping[str, float]) -> Term:
        """The effect with these values, applied to one sensor, run or target if it is per one of them."""
        return Term(self.effect, dict(values), WORDS[self.effect.per] if self.effect.per else None)

    def on(self, model: Model) -> Model:
        """A model with the strong effect on top."""
        return Model(model.sensor, (*model.effects, self.strong))

    def neighbour(self) -> Model:
        """The base model with another effect, which this one must not change."""
        return self.base.adding("clutter" if self.effect.name != "clutter" else "multipath", share=0.3)

    def contexts(self, n: int, seed: int = 1) -> Columns:
        """Contexts including the columns of this effect; with run offsets each reading is its own run."""
        columns = contexts(n, seed, self.effect.columns)
        if "run_offset_cm" in self._changed():
            columns["run"] = np.arange(n).astype(str)
        return columns

    def gain(self, term: Term) -> float:
        """Mean gain in log probability of the effect's own readings over the base model [nats per reading]."""
        given, model = self.contexts(10_000, 9), Model(self.base.sensor, (term,))
        readings_cm = model.sample(given, np.random.default_rng(2))
        with np.errstate(divide="ignore", invalid="ignore"):
            own, base = model.log_prob(readings_cm, given), self.base.log_prob(readings_cm, given)
        return float(np.mean(own - np.maximum(base, np.log(MIN_PROBABILITY))))

    def _changed(self) -> set[str]:
        """Names of the fields of `Contribution` that the effect changes."""
        scene = Scene(self.base.sensor, contexts(200, 1, self.effect.columns))
        with np.errstate(all="ignore"):
            change = self.effect.apply(scene, strong_values(self.effect, STRENGTHS[0]))
        return {name for name, value in change._asdict().items() if value is not None}

    def channels(self) -> set[str]:
        """Channels that the effect changes."""
        return {_CHANGES[name] for name in self._changed() if name in _CHANGES}


def strong_values(effect: Effect, strength: float) -> dict[str, float]:
    """Values at a fraction of the way from the neutral value to the farther bound (the upper one if equally far); shape
    parameters at their defaults."""
    values = effect.neutral_values()
    for parameter in effect.parameters:
        if parameter.neutral is not None:
            bound = max(parameter.high, parameter.low, key=lambda each: abs(each - values[parameter.name]))
            values[parameter.name] += strength * (bound - values[parameter.name])
    return values


def contexts(n: int, seed: int = 1, extra: Sequence[str] | frozenset[str] = ()) -> Columns:
    """Contexts of all kinds, each column unknown in a tenth of the rows.

    Parameters
    ----------
    n
        Number of rows.
    seed
        Random seed.
    extra
        Columns of an own effect; those that are not known here get numbers from 0 to 1.
    """
    # A separate random stream: a check with the same seed must not draw the same numbers.
    rng = np.random.default_rng((seed, 17))
    near = rng.random(n) < 0.5
    columns: Columns = {
        TRUE_RANGE: np.where(near, rng.uniform(10.0, 120.0, n), rng.uniform(20.0, 800.0, n)),
        "air_temperature_c": rng.uniform(-10.0, 45.0, n),
        "target_temperature_c": rng.uniform(0.0, 60.0, n),
        "humidity_pct": rng.uniform(0.0, 100.0, n),
        "incidence_deg": rng.uniform(-30.0, 30.0, n),
        "range_rate_cm_s": rng.normal(0.0, 150.0, n),
        "throttle": rng.random(n),
        "vibration_hz": rng.choice([0.0, 60.0], n),
        "uptime_s": rng.uniform(0.0, 900.0, n),
        "time_of_day_h": rng.uniform(0.0, 24.0, n),
        "target_size_cm": rng.uniform(2.0, 60.0, n),
        "neighbour_lag_ms": rng.choice([0.0, 2.0, 100.0], n),
        "neighbour_range_cm": rng.uniform(20.0, 700.0, n),
        "external_level_db": rng.uniform(80.0, 130.0, n),
        "external_duty": rng.random(n),
        "external_distance_cm": rng.uniform(10.0, 300.0, n),
        "external_frequency_khz": rng.uniform(38.0, 46.0, n),
        "previous_reading_cm": np.rint(rng.uniform(20.0, 765.0, n)),
    }
    columns |= {name: rng.random(n) for name in sorted({*extra} - columns.keys() - WORD_COLUMNS)}
    for name, column in columns.items():
        column[rng.random(n) < (0.02 if name == TRUE_RANGE else 0.1)] = np.nan
    columns["sensor"] = rng.choice(["left", "right", ""], n)
    # Almost every reading is the only one of its run, so that the runs' offsets are independent.
    columns["run"] = np.where(rng.random(n) < 0.3, "3" if n > 1000 else "4", np.arange(n).astype(str))
    columns["target"] = rng.choice(["grass", "asphalt", ""], n)
    return columns


def own_columns(effect: Effect) -> list[str]:
    """Columns of an effect that `contexts` does not know and fills with numbers from 0 to 1."""
    return sorted(effect.columns - contexts(1).keys())
