"""Readings with the given model's distribution ready, and the slopes of their log probabilities.

A model, contexts and readings enter. The distribution with the base's numbers changed and with further effects leaves,
and the derivatives of each reading's log probability by the base's numbers, the first five of which are the channels
through which effects act.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_range.reading_model.rows import FREE
from msp_sim.effects.base import Scene
from msp_sim.effects.curve import CurveChannel
from msp_sim.model.history import MAX_CORRELATION, History
from msp_sim.model.model import Model, Term, apply_terms, base_rows, history_of
from msp_sim.model.rows import Carry, ModelRows
from msp_sim.model.slopes import log_prob, slopes

_Array = NDArray[np.float64]

BASE = (*FREE, "correlation")
"""The base's numbers that are fitted together with every effect; the last one only where readings are correlated."""
CHANNELS: tuple[CurveChannel, ...] = ("bias", "spread", "short", "missed", "random")
CHUNK = 1 << 13
"""Rows of which all scores are computed at a time: what fits into a processor's cache."""
LEAST_SHARE = 1e-6
"""Share of a kind of reading that the base does not have: its odds have to start somewhere."""


@dataclass(frozen=True)
class Prepared:
    """Readings in their scene, with the given model's distribution ready.

    Attributes
    ----------
    model
        The given model, with its effects.
    scene
        Contexts.
    rows
        The given model's distribution of each reading.
    reading_cm
        Readings, whole centimetres.
    spacing_s
        The time to which the correlation of the hits' errors refers [s]; None: it is not fitted.
    """

    model: Model
    scene: Scene
    rows: ModelRows
    reading_cm: _Array
    spacing_s: float | None = None

    @classmethod
    def of(
        cls, model: Model, contexts: Mapping[str, Any], reading_cm: _Array, spacing_s: float | None = None
    ) -> "Prepared":
        """Prepare readings; with a spacing, the correlation of their errors is one of the base's numbers."""
        scene = Scene(model.sensor, contexts)
        rows = apply_terms(base_rows(model, scene), scene, model.effects)
        logs = tuple(np.maximum(each, np.log(LEAST_SHARE)) for each in rows.log_weights)
        rows = replace(rows, log_weights=(logs[0], logs[1], logs[2], logs[3]))
        given = model.sensor.reading_model
        if given.correlation > 0.0:
            spacing_s = given.correlation_spacing_s
        elif spacing_s is not None:
            rows = replace(rows, history=history_of(scene, 0.0, spacing_s))
        return cls(model, scene, rows, reading_cm, spacing_s)

    def __len__(self) -> int:
        return self.reading_cm.size

    def at(self, base: _Array, effects: Sequence[Term]) -> ModelRows:
        """The distribution with the base's numbers changed by this much, and with these effects."""
        return apply_terms(shifted(self.rows, base), self.scene, effects)

    def log_prob(self, base: _Array, effects: Sequence[Term]) -> _Array:
        """log probability of each reading, (n,), bounded below."""
        return log_prob(self.at(base, effects), self.reading_cm)


def shifted(rows: ModelRows, base: _Array) -> ModelRows:
    """Rows with the base's numbers changed, in the order of `BASE`."""
    hit, short, missed, random = rows.log_weights
    return replace(
        rows.wider(np.exp(base[1])),
        centre_cm=rows.centre_cm + base[0],
        log_weights=(hit, short + base[2], missed + base[3], random + base[4]),
        rate_per_m=rows.rate_per_m * float(np.exp(base[5])),
        saturated_fraction=float(np.clip(rows.saturated_fraction + base[6], 0.0, 1.0)),
        history=None if rows.history is None else _correlated(rows.history, base[7]),
    )


def _correlated(history: History, more: float) -> History:
    return replace(history, correlation=float(np.clip(history.correlation + more, 0.0, MAX_CORRELATION)))


@dataclass(frozen=True)
class ChannelSlopes:
    """Derivatives of each reading's log probability at one distribution.

    Attributes
    ----------
    log_p
        (n,).
    by
        (n, 8) in the order of `BASE`: the first five are the channels, by what is the same for all readings.
    shares
        (n, 3): of short, missed and random readings, before components and faults of the code.
    rows
        The distribution of each reading after those before it.
    own_centre, carry
        Derivative by the centre of the reading's own hit, and what it carries over from the hit before; None where
        readings are independent.
    """

    log_p: _Array
    by: _Array
    shares: _Array
    rows: ModelRows
    own_centre: _Array
    carry: Carry | None

    def score(self, channel: int, template: _Array) -> _Array:
        """Derivative of each reading's log probability by a number that moves a channel by a template, (n,).

        With correlated noise the error of the hit before moves with its own template T_j, so that a shift counts as
        T_i - k T_j and a wider spread moves the centre by the error carried over, times L_i - L_j.
        """
        if self.carry is None or channel > 1:
            return self.by[:, channel] * template
        template = np.broadcast_to(template, self.log_p.shape)
        if channel == 0:
            return self.own_centre * (template - self.carry.factor * template[self.carry.before])
        # Of the logarithm of the whole spread, of which the sensor's own is a part.
        whole = self.rows.within_share * template
        carried: _Array = self.own_centre * self.carry.shift_cm * (whole - whole[self.carry.before])
        return self.by[:, 1] * template + carried


def channel_slopes(rows: ModelRows, reading_cm: _Array) -> ChannelSlopes:
    """Derivatives by the channels and by the base's other numbers."""
    rows, carry = rows.given(reading_cm)
    log_p, by_free = slopes(rows, reading_cm)
    by = np.zeros((reading_cm.size, len(BASE)))
    by[:, :-1] = by_free
    if not np.any(np.asarray(rows.log_weights[1]) > np.log(2.0 * LEAST_SHARE)):
        by[:, 5] = 0.0
    own_centre = by[:, 0].copy()
    if carry is not None:
        by[:, 0] *= 1.0 - carry.factor
        by[:, 7] = own_centre * carry.correlation_shift_cm + by[:, 1] * carry.log_sigma_slope
    weights = np.stack([np.broadcast_to(np.exp(each), reading_cm.shape) for each in rows.log_weights], axis=1)
    return ChannelSlopes(log_p, by, weights[:, 1:] / weights.sum(axis=1, keepdims=True), rows, own_centre, carry)


def chunks(contexts: Mapping[str, Any], reading_cm: _Array) -> Iterator[tuple[slice, dict[str, Any], _Array]]:
    """Parts of the readings that fit into a processor's cache."""
    for start in range(0, reading_cm.size, CHUNK):
        part = slice(start, min(start + CHUNK, reading_cm.size))
        yield part, {name: np.asarray(column)[part] for name, column in contexts.items()}, reading_cm[part]
