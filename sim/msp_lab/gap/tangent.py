"""Derivatives of each reading's log probability: by the base's own parameters and by each entry of the catalogue.

Readings with their contexts and a model enter, score vectors leave. Whatever acts through a channel (a shift of the
hits, their spread, odds of the outliers) is chained through that channel's derivative, which is taken once; components
and faults of the code act linearly on the probability itself.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_range.reading_model.rows import FREE
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import TRUE_RANGE, WORD_COLUMNS, Effect, Parameter, Scene
from msp_sim.effects.curve import FIELDS, CurveChannel
from msp_sim.model.model import LARGEST_SHARE, Active, Model, acts, base_rows, changed
from msp_sim.model.rows import Rows
from msp_sim.model.slopes import log_prob, score_of_component, score_of_fault, slopes

_Array = NDArray[np.float64]

BASE = FREE
"""What of the base is free beside every effect: nuisance."""
CHANNELS: tuple[CurveChannel, ...] = ("bias", "spread", "short", "missed", "random")
CHUNK = 1 << 13
"""Rows of which all scores are taken at a time: what fits into a processor's cache."""


SHAPE_NATS = 0.7
PLACE_NATS = 2.0
"""What a number of a shape gains by chance, and what a place that readings gather at does."""


@dataclass(frozen=True)
class Entry:
    """An effect with its shape held, of which one number is asked for.

    Attributes
    ----------
    effect, of
        Of the catalogue, and the word that it is of.
    shape
        Values of its shape's parameters.
    parameter
        The number that is zero while it is away.
    """

    effect: Effect
    of: str | None
    shape: tuple[tuple[str, float], ...]
    parameter: Parameter
    curve: tuple[str, tuple[str, ...], tuple[tuple[Any, ...], ...]] | None = None

    @property
    def key(self) -> tuple[str, str | None]:
        """Name and word: entries that differ in shape alone have the same."""
        return self.effect.name, self.of

    @property
    def one_sided(self) -> bool:
        """Its number cannot be negative."""
        return self.parameter.low >= 0.0

    @property
    def odds(self) -> int | None:
        """Which of the three odds it changes, if that is all it does: 1 short, 2 missed, 3 random."""
        found = [i for i, channel in enumerate(("short", "missed", "random"), 1) if channel in self.effect.channels]
        return found[0] if len(found) == 1 and len(self.effect.channels) == 1 else None

    @property
    def linear(self) -> bool:
        """It mixes something into the probability."""
        return bool({"component", "code"} & set(self.effect.channels))

    @property
    def price(self) -> float:
        """What the search over its shapes gains by chance [nat]."""
        searched = sum(len(parameter.tried) > 1 for parameter in self.effect.parameters)
        return searched * (PLACE_NATS if self.linear else SHAPE_NATS)

    def at(self, value: float) -> Active:
        """The effect with this value of its number."""
        return Active(
            self.effect,
            {**self.effect.nulls(), **dict(self.shape), self.parameter.name: value},
            self.of,
            self.curve,
        )


def entries(model: Model, contexts: Mapping[str, Any]) -> tuple[list[Entry], list[tuple[str, tuple[str, ...]]]]:
    """Entries of the catalogue that these contexts can show, and names with the columns that are missing for them.

    An effect that the model has already is tested again: more of it may be there.
    """
    found: list[Entry] = []
    missing: list[tuple[str, tuple[str, ...]]] = []
    for effect in CATALOGUE.values():
        absent = tuple(
            name for name in (*effect.needs, *((effect.of,) if effect.of else ())) if not _said(contexts, name)
        )
        if absent:
            missing.append((effect.name, absent))
            continue
        words: Sequence[str | None] = (None,)
        if effect.of is not None:
            words = [str(word) for word in np.unique(np.asarray(contexts[effect.of])) if word]
            if len(words) < 2 or (effect.of == "run" and len(words) > 12):
                continue
        shapes = [parameter for parameter in effect.parameters if parameter.null is None]
        numbers = [parameter for parameter in effect.parameters if parameter.null is not None]
        for word in words:
            for tried in product(*(parameter.tried or (parameter.default or 0.0,) for parameter in shapes)):
                held = tuple((parameter.name, float(value)) for parameter, value in zip(shapes, tried, strict=True))
                found.extend(Entry(effect, word, held, number) for number in numbers)
    return found, missing


def _said(contexts: Mapping[str, Any], name: str) -> bool:
    if name not in contexts:
        return False
    column = np.asarray(contexts[name])
    return bool((column != "").any() if name in WORD_COLUMNS else np.isfinite(column).any())


@dataclass(frozen=True)
class Prepared:
    """Readings in their scene, with the given model's distribution ready.

    Attributes
    ----------
    model
        As given, with its effects.
    scene
        Contexts.
    rows
        The model's distribution of them.
    reading_cm
        Readings, whole.
    """

    model: Model
    scene: Scene
    rows: Rows
    reading_cm: _Array

    @classmethod
    def of(cls, model: Model, contexts: Mapping[str, Any], reading_cm: _Array) -> "Prepared":
        """Prepare readings."""
        scene = Scene(model.sensor, contexts)
        rows = changed(base_rows(model, scene), scene, model.effects)
        logs = tuple(_not_never(each) for each in rows.log_weights)
        return cls(model, scene, replace(rows, log_weights=(logs[0], logs[1], logs[2], logs[3])), reading_cm)

    def __len__(self) -> int:
        return self.reading_cm.size

    def at(self, base: _Array, effects: Sequence[Active]) -> Rows:
        """Distribution with the base's parameters changed by this much, and with these effects."""
        return changed(shifted(self.rows, base), self.scene, effects)

    def log_prob(self, base: _Array, effects: Sequence[Active]) -> _Array:
        """log probability of each reading, not below the least."""
        return log_prob(self.at(base, effects), self.reading_cm)


def _not_never(log_weight: Any) -> Any:
    """A class of readings that the base does not have may be there: its odds have to begin somewhere."""
    return np.maximum(log_weight, np.log(1e-6))


def shifted(rows: Rows, base: _Array) -> Rows:
    """Rows with the base's parameters changed: see `BASE`."""
    hit, short, missed, random = rows.log_weights
    saturated = rows.saturated_fraction
    return replace(
        rows.wider(np.exp(base[1])),
        centre_cm=rows.centre_cm + base[0],
        log_weights=(hit, short + base[2], missed + base[3], random + base[4]),
        rate_per_m=rows.rate_per_m * float(np.exp(base[5])),
        saturated_fraction=float(np.clip(saturated + base[6], 0.0, 1.0)),
    )


@dataclass(frozen=True)
class Channels:
    """Derivatives of each reading's log probability at one distribution.

    Attributes
    ----------
    log_p
        (n,).
    by
        (n, 7) in the order of `BASE`: the first five are the channels.
    shares
        (n, 3): of short, missed and random readings, before what codes and components change.
    """

    log_p: _Array
    by: _Array
    shares: _Array


def channels(rows: Rows, reading_cm: _Array) -> Channels:
    """Derivatives by the channels and by the base's other parameters."""
    log_p, by = slopes(rows, reading_cm)
    if not np.any(np.asarray(rows.log_weights[1]) > np.log(2e-6)):
        by[:, 5] = 0.0
    weights = np.stack([np.broadcast_to(np.exp(each), reading_cm.shape) for each in rows.log_weights], axis=1)
    return Channels(log_p, by, weights[:, 1:] / weights.sum(axis=1, keepdims=True))


def of_entry(entry: Entry, rows: Rows, scene: Scene, reading_cm: _Array, here: Channels) -> _Array:
    """Score of an entry at its null, one number a reading."""
    null, parameter = entry.parameter.null or 0.0, entry.parameter
    active = entry.at(null + parameter.step)
    known = acts(scene, active)
    score = np.zeros(reading_cm.size)
    if known is False:
        return score
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        change = active.effect.act(scene, active.values)
    step = active.values[parameter.name] - null
    for i, channel in enumerate(CHANNELS):
        moved = getattr(change, FIELDS[channel])
        if moved is not None:
            template = np.nan_to_num(np.where(known, moved, 0.0)) / step**parameter.power
            score += here.by[:, i] * template
    if change.run_offset_cm is not None:
        score += here.by[:, 1] * np.where(known, 0.5 / (rows.sigma_cm**2 - rows.between_cm2), 0.0)
    if change.component is not None:
        share = np.broadcast_to(np.nan_to_num(np.where(known, change.share, 0.0)), reading_cm.shape)
        share = np.clip(share, 0.0, LARGEST_SHARE)
        some = np.flatnonzero(share > 0.0)
        if some.size:
            own = score_of_component(rows.take(some), reading_cm[some], change.component.take(some), here.log_p[some])
            score[some] = own * share[some] / step
    if change.fault is not None:
        own = score_of_fault(rows, reading_cm, change.fault, here.log_p)
        score += own * np.where(known, change.fault_share, 0.0) / step
    return score


def chunks(contexts: Mapping[str, Any], reading_cm: _Array) -> Iterator[tuple[slice, dict[str, Any], _Array]]:
    """Parts of the readings that fit into a processor's cache."""
    for start in range(0, reading_cm.size, CHUNK):
        part = slice(start, min(start + CHUNK, reading_cm.size))
        yield part, {name: np.asarray(column)[part] for name, column in contexts.items()}, reading_cm[part]


def needed(contexts: Mapping[str, Any], tested: Sequence[Entry], model: Model) -> dict[str, Any]:
    """The columns that entries and model read."""
    names = {TRUE_RANGE, *model.needs}.union(*(entry.effect.columns for entry in tested))
    return {name: contexts[name] for name in names if name in contexts}
