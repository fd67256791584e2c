"""Readings with the given model's distribution ready, and the slopes of their log probabilities.

From them follow the distribution with other numbers of the base or further effects, and the derivatives of each
reading's log probability by the base's numbers. Effects act through the first five of these, the channels.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from msp_lab.gap.runs import taken
from msp_range.arrays import Array
from msp_range.reading_model.rows import MIN_PROBABILITY, Base, shares_of
from msp_sim.effects.base import Contribution, Scene
from msp_sim.effects.component import Component
from msp_sim.effects.curve import FIELDS, CurveChannel, knot_weights
from msp_sim.model.model import Model, Term, applies, apply_terms, base_rows, history_of, shifted
from msp_sim.model.rows import AddedComponent, Carry, ModelRows, log_prob

BASE = Base._fields
"""The base's numbers that are fitted together with every effect; the last one only where readings are correlated."""
CHANNELS: tuple[CurveChannel, ...] = ("bias", "spread", "short", "missed", "random")
ODDS_CHANNELS = CHANNELS[2:]
LEAST_SHARE = 1e-6
"""Share of a kind of reading that the base does not have: its odds have to start somewhere."""


@dataclass(frozen=True)
class Prepared:
    """Readings in their scene, with the given model's distribution ready."""

    model: Model
    """The given model, with its effects."""
    contexts: Mapping[str, Any]
    """Columns of the readings, (n,) each."""
    scene: Scene
    """The same, of when the given model has them."""
    rows: ModelRows
    """The given model's distribution of each reading."""
    reading_cm: Array
    """Readings, multiples of the model's resolution."""
    spacing_s: float | None
    """The time to which the correlation of the hits' errors refers [s]; None: it is not fitted."""

    @classmethod
    def of(
        cls, model: Model, contexts: Mapping[str, Any], reading_cm: Array, spacing_s: float | None = None
    ) -> "Prepared":
        """Prepare readings; with a spacing, the correlation of their errors is one of the base's numbers."""
        scene = Scene(model.sensor, contexts)
        rows = apply_terms(base_rows(model, scene), scene, model.effects)
        logs = tuple(np.maximum(log, np.log(LEAST_SHARE)) for log in rows.log_weights)
        rows = replace(rows, log_weights=(logs[0], logs[1], logs[2], logs[3]))
        given = model.sensor.reading_model
        if given.correlation > 0.0:
            spacing_s = given.correlation_spacing_s
        elif spacing_s is not None:
            rows = replace(rows, history=history_of(scene, 0.0, spacing_s))
        return cls(model, contexts, shifted(scene, model.effects), rows, reading_cm, spacing_s)

    def __len__(self) -> int:
        return self.reading_cm.size

    def take(self, rows: Any) -> "Prepared":
        """Some of the readings."""
        return Prepared.of(self.model, taken(self.contexts, rows), self.reading_cm[rows], self.spacing_s)

    def at(self, base: Base, effects: Sequence[Term]) -> ModelRows:
        """The distribution with the base's numbers changed by this much, and with these effects."""
        return apply_terms(self.rows.changed(base), self.scene, effects)

    def log_prob(self, base: Base, effects: Sequence[Term]) -> Array:
        """log probability of each reading, (n,), bounded below."""
        return log_prob(self.at(base, effects), self.reading_cm)

    def log_likelihood(self, base: Base, effects: Sequence[Term]) -> float:
        """Sum of those of all readings."""
        return float(self.log_prob(base, effects).sum())

    def slopes(self, base: Base, effects: Sequence[Term]) -> "ChannelSlopes":
        """Derivatives of the log probabilities by the channels and by the base's other numbers."""
        return channel_slopes(self.at(base, effects), self.reading_cm)

    def bias_cm(self, term: Term) -> Array:
        """What a term adds to the hit of each reading [cm], (n,)."""
        return np.broadcast_to(templates(applies(self.scene, term), term.change(self.scene))[0], len(self))

    def slopes_of(self, base: Base, effects: Sequence[Term], here: "ChannelSlopes") -> Array:
        """Derivatives of each log probability by the numbers of the effects, one after another, (numbers, n).

        `here` are the slopes there. A number along which the likelihood jumps has none, so that a fit holds it: with a
        slope that says nothing each step of Newton would fail at any length, and with it that of all other numbers.
        """
        scene = shifted(self.scene, effects)
        found = [self._slopes_of(k, base, effects, here, scene) for k in range(len(effects))]
        return np.concatenate([np.zeros((0, len(self))), *found])

    def _slopes_of(self, k: int, base: Base, effects: Sequence[Term], here: "ChannelSlopes", scene: Scene) -> Array:
        """Those by the numbers of the k-th effect, (numbers, n), in the scene that all effects have shifted."""
        own, slopes = effects[k], np.zeros((len(effects[k].effect.parameters), len(self)))
        scene = self.scene if own.effect.is_shift else scene
        known = applies(scene, own)
        if known is False:
            return slopes
        if own.shape is not None:
            # Linear in its values: the weights of each knot.
            weights = knot_weights(scene, *own.shape[1:]).T
            if own.shape[0] == "bias" and own.is_added:
                weights = np.array([scene.about_run_mean(each) for each in weights])
            return here.score(CHANNELS.index(own.shape[0]), np.where(known, weights, 0.0))
        moves_all = "code" in own.effect.channels or own.effect.name == "run_offsets"
        is_component = own.effect.channels == ("component",)
        before = {} if moves_all or is_component else templates(known, own.change(scene))
        parts = self._parts(own, here) if is_component else []
        odds, total = _without(parts, here) if is_component else (0.0, 0.0)
        for slope, parameter in zip(slopes, own.effect.parameters, strict=True):
            if parameter.jumps:
                continue
            value = own.values[parameter.name]
            step = parameter.step * (1.0 if parameter.neutral is not None else max(abs(value), 1.0))
            if value + step > parameter.high:
                step = -step
            there = own.having({parameter.name: value + step})
            if moves_all:
                moved = self.log_prob(base, [*effects[:k], there, *effects[k + 1 :]])
                slope += (moved - here.log_p) / step
            elif is_component:
                added = self._parts(there, here, parts)
                p = (total + sum(part.odds * own_p for part, own_p in added)) / (
                    odds + sum(part.odds for part, _ in added)
                )
                slope += (np.log(np.maximum(p, MIN_PROBABILITY)) - here.log_p) / step
            else:
                for i, template in templates(known, there.change(scene)).items():
                    slope += here.score(i, (template - before[i]) / step)
        return slopes

    def _parts(
        self, term: Term, here: "ChannelSlopes", known: Sequence[tuple[AddedComponent, Array]] = ()
    ) -> list[tuple[AddedComponent, Array]]:
        """The components of a term, with the probability of each reading under each, (n,); those of `known` that have
        another share alone are not computed again."""
        rows, found = apply_terms(replace(here.rows, added=()), self.scene, (term,)), []
        for part in rows.added:
            own = next((own for other, own in known if _are_same(other.component, part.component)), None)
            if own is None:
                own = replace(rows, added=(part,)).of_readings(self.reading_cm, ModelRows.last_added)[0]
            found.append((part, own))
        return found


def _are_same(one: Component, other: Component) -> bool:
    """Whether two components are of one kind and have the same numbers."""
    ours, theirs = vars(one), vars(other)
    return type(one) is type(other) and all(
        ours[name] is theirs[name] or np.array_equal(ours[name], theirs[name]) for name in ours
    )


def _without(parts: Sequence[tuple[AddedComponent, Array]], here: "ChannelSlopes") -> tuple[Array, Array]:
    """One and the odds of all components but these, and the sum of the parts without them: the probability times one
    and all odds is that with them, as all after the mixture is linear in the probability."""
    odds: Array = np.asarray(1.0 + sum(part.odds for part in here.rows.added))
    total = odds * np.where(here.log_p > np.log(MIN_PROBABILITY), np.exp(here.log_p), 0.0)
    for part, own in parts:
        odds, total = odds - part.odds, total - part.odds * own
    return odds, total


def templates(known: Any, change: Contribution) -> dict[int, Array]:
    """What a change adds to each channel that it moves, by the channel's place; 0 where it is not known."""
    moved = {i: getattr(change, FIELDS[channel]) for i, channel in enumerate(CHANNELS)}
    return {i: np.nan_to_num(np.where(known, template, 0.0)) for i, template in moved.items() if template is not None}


@dataclass(frozen=True)
class ChannelSlopes:
    """Derivatives of each reading's log probability at one distribution."""

    log_p: Array
    """Log probability of each reading, (n,)."""
    by: Array
    """Derivatives, (n, 8) in the order of `BASE`: the first five are by the channels, by what is the same for all
    readings."""
    rows: ModelRows
    """The distribution of each reading after those before it."""
    own_centre: Array
    carry: Carry | None
    """Derivative by the centre of the reading's own hit, and what it carries over from the hit before; None where
    readings are independent."""

    @property
    def shares(self) -> Array:
        """Shares of short, missed and random readings, (n, 3), before components and faults of the code."""
        shares = [np.broadcast_to(share, self.log_p.shape) for share in shares_of(self.rows.log_weights)[1:]]
        return np.stack(shares, axis=1)

    def score(self, channel: int, template: Array) -> Array:
        """Derivative of each reading's log probability by a number that moves a channel by a template, (n,) or (m, n).

        With correlated noise the error of the hit before moves with its own template T_j, so that a shift counts as
        T_i - k T_j and a wider spread moves the centre by the error carried over, times L_i - L_j.
        """
        own, carried = self.parts(channel)
        if carried is None or self.carry is None:
            return own * template
        template = np.broadcast_to(template, np.broadcast_shapes(np.shape(template), self.log_p.shape))
        return own * template - carried * template[..., self.carry.before]

    def parts(self, channel: int) -> tuple[Array, Array | None]:
        """What a channel's template counts, and that of the hit before, with a minus sign; None if it does not."""
        if self.carry is None or channel > 1:
            return self.by[:, channel], None
        if channel == 0:
            return self.own_centre, self.own_centre * self.carry.factor
        # Of the logarithm of the whole spread, of which the sensor's own is a part.
        within = np.broadcast_to(self.rows.within_share, self.log_p.shape)
        carried = self.own_centre * self.carry.shift_cm
        return self.by[:, 1] + carried * within, carried * within[self.carry.before]


def channel_slopes(rows: ModelRows, reading_cm: Array) -> ChannelSlopes:
    """Derivatives by the channels and by the base's other numbers."""
    rows, carry = rows.given(reading_cm)
    log_p, by_free = rows.scores(reading_cm)
    by = np.zeros((reading_cm.size, len(BASE)))
    by[:, :-1] = by_free
    if not np.any(np.asarray(rows.log_weights[1]) > np.log(2.0 * LEAST_SHARE)):
        by[:, 5] = 0.0
    own_centre = by[:, 0].copy()
    if carry is not None:
        by[:, 0] *= 1.0 - carry.factor
        by[:, 7] = own_centre * carry.correlation_shift_cm + by[:, 1] * carry.log_sigma_slope
    return ChannelSlopes(log_p, by, rows, own_centre, carry)
