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
from msp_sim.model.model import Model, Term, apply_terms, base_rows
from msp_sim.model.rows import ModelRows
from msp_sim.model.slopes import log_prob, slopes

_Array = NDArray[np.float64]

BASE = FREE
"""The base's numbers that are fitted together with every effect."""
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
    """

    model: Model
    scene: Scene
    rows: ModelRows
    reading_cm: _Array

    @classmethod
    def of(cls, model: Model, contexts: Mapping[str, Any], reading_cm: _Array) -> "Prepared":
        """Prepare readings."""
        scene = Scene(model.sensor, contexts)
        rows = apply_terms(base_rows(model, scene), scene, model.effects)
        logs = tuple(np.maximum(each, np.log(LEAST_SHARE)) for each in rows.log_weights)
        return cls(model, scene, replace(rows, log_weights=(logs[0], logs[1], logs[2], logs[3])), reading_cm)

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
    )


@dataclass(frozen=True)
class ChannelSlopes:
    """Derivatives of each reading's log probability at one distribution.

    Attributes
    ----------
    log_p
        (n,).
    by
        (n, 7) in the order of `BASE`: the first five are the channels.
    shares
        (n, 3): of short, missed and random readings, before components and faults of the code.
    """

    log_p: _Array
    by: _Array
    shares: _Array


def channel_slopes(rows: ModelRows, reading_cm: _Array) -> ChannelSlopes:
    """Derivatives by the channels and by the base's other numbers."""
    log_p, by = slopes(rows, reading_cm)
    if not np.any(np.asarray(rows.log_weights[1]) > np.log(2.0 * LEAST_SHARE)):
        by[:, 5] = 0.0
    weights = np.stack([np.broadcast_to(np.exp(each), reading_cm.shape) for each in rows.log_weights], axis=1)
    return ChannelSlopes(log_p, by, weights[:, 1:] / weights.sum(axis=1, keepdims=True))


def chunks(contexts: Mapping[str, Any], reading_cm: _Array) -> Iterator[tuple[slice, dict[str, Any], _Array]]:
    """Parts of the readings that fit into a processor's cache."""
    for start in range(0, reading_cm.size, CHUNK):
        part = slice(start, min(start + CHUNK, reading_cm.size))
        yield part, {name: np.asarray(column)[part] for name, column in contexts.items()}, reading_cm[part]
