"""Readings for choosing and fitting, with what the steps of naming ask of them again and again: screens and refits.

A model and readings enter; screens at a fit, refits of what they found and what is left over leave. An `Item` is an
effect or a curve that has been taken into the model.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import adequacy
from msp_lab.gap.adequacy import FreeForm
from msp_lab.gap.beginning import fit_base
from msp_lab.gap.refit import Fitted, refit
from msp_lab.gap.screen import Screen, Sums, information_of, screen, sums, twin
from msp_lab.gap.tangent import CHANNELS, Entry, Prepared, entries
from msp_lab.gap.units import Dependence, dependence
from msp_sim.effects.curve import CurveChannel
from msp_sim.model.model import Active, Model

_Array = NDArray[np.float64]

MOST_ROWS = 20_000
"""Rows of a refit while effects are chosen; of more, every k-th."""
MOST_TRIED = 12
"""Refits in one go, at most."""
SHAPES = 25
"""Values of a shape's number that a refit may begin at."""
MOST_SHARE = 0.98
"""What befalls all readings is no effect on top of them: such a fit speaks of readings that are not there."""
RIDGE = 0.05
"""Precision of the prior about 0 for the values of curves."""
SPECIAL = frozenset({"run_offsets"})
"""Seen between runs, and not in single readings."""


@dataclass(frozen=True)
class Item:
    """An effect or a curve that is in the model."""

    active: Active
    entry: Entry | None

    @property
    def key(self) -> tuple[str, str | None]:
        """Name and word."""
        if self.active.shape is not None:
            return f"curve {self.active.shape[0]} {self.active.shape[1]}", None
        return self.active.effect.name, self.active.of

    @property
    def label(self) -> str:
        """For a person."""
        if self.active.shape is not None:
            return f"{self.active.shape[0]} over {' and '.join(self.active.shape[1])}"
        return self.active.effect.name


@dataclass
class Search:
    """Readings for choosing and fitting, with all that is asked of them again and again."""

    model: Model
    contexts: Mapping[str, Any]
    reading_cm: _Array
    unit: NDArray[np.intp]
    rng: np.random.Generator
    alpha: float
    tested: list[Entry] = field(init=False)
    missing: list[tuple[str, tuple[str, ...]]] = field(init=False)
    common_inflation: float = 1.0
    """Of likelihoods, where the unit is the run."""

    def __post_init__(self) -> None:
        found, self.missing = entries(self.model, self.contexts)
        self.tested = [entry for entry in found if entry.effect.name not in SPECIAL]
        n = self.reading_cm.size
        thin = slice(None, None, -(-n // MOST_ROWS))
        self.some = {name: np.asarray(column)[thin] for name, column in self.contexts.items()}
        self.prepared = Prepared.of(self.model, self.some, self.reading_cm[thin])
        self.some_unit = self.unit[thin]
        self.scale = n / len(self.prepared)
        self.curves = adequacy.curves_of(self.some)
        self.null = fit_base(self.prepared)
        self.inform(self.null)
        self.by_run = self.depends(self.null).dependent

    def inform(self, fitted: Fitted) -> None:
        """Information at a fit: what a large effect hid before it was named, it hides no more."""
        drawn = twin(self.model, fitted.base, fitted.effects, self.contexts, self.rng)
        self.information = information_of(drawn, fitted.base, fitted.effects, self.tested)

    def depends(self, fitted: Fitted) -> Dependence:
        """Dependence inside runs at a fit."""
        score = fitted.here.by[:, 0]
        time_s = np.asarray(self.some["time_s"], dtype=float) if "time_s" in self.some else None
        return dependence(score, self.some_unit, time_s)

    # A screen at a fit, and refits of what it found.

    def sums(self, fitted: Fitted) -> Sums:
        """Scores of all rows at a fit."""
        return sums(
            self.model,
            fitted.base,
            fitted.effects,
            self.tested,
            self.contexts,
            self.reading_cm,
            self.unit,
            self.information,
        )

    def screen(self, fitted: Fitted, items: Sequence[Item]) -> Screen:
        """Every entry beside what is accepted."""
        accepted = [self.nearest(item) for item in items if item.entry is not None]
        return screen(self.sums(fitted), self.information, self.tested, accepted, self.by_run, self.alpha, self.rng)

    def nearest(self, item: Item) -> int:
        """The entry whose shape is nearest to an item's."""
        same = [j for j, entry in enumerate(self.tested) if entry.key == item.key]
        return min(
            same,
            key=lambda j: sum(
                abs(np.log(max(abs(value), 1e-3) / max(abs(item.active.values[name]), 1e-3)))
                for name, value in self.tested[j].shape
            ),
        )

    def candidates(
        self, fitted: Fitted, items: Sequence[Item], seen: Screen, within: float, least: float
    ) -> list[tuple[float, Item, Fitted]]:
        """Refits of the names that gain most, the best first, with their gains in nats."""
        taken = {item.key for item in items}
        best: dict[tuple[str, str | None], int] = {}
        for j, entry in enumerate(self.tested):
            if entry.key not in taken and seen.gain[j] > seen.gain[best.get(entry.key, j)] - 1e-12:
                best[entry.key] = j
        order = sorted(best.values(), key=lambda j: -seen.gain[j])
        refits: list[tuple[float, Item, Fitted]] = []
        top = 0.0
        for j in order[:MOST_TRIED]:
            # What the screen promises is not always there, and of what is large it promises too little: what is near
            # is within the nats that are asked for, or within half of the smaller of the best promise and refit.
            best_so_far = min(top, seen.gain[order[0]])
            near = best_so_far - max(within, 0.5 * best_so_far)
            if seen.gain[j] < least or (refits and seen.gain[j] < near):
                break
            there = self.refitted(fitted, self.tested[j], self._start(self.tested[j], seen, j))
            if self.tested[j].linear and there.effects[-1].values[self.tested[j].parameter.name] > MOST_SHARE:
                continue
            gained = (there.log_likelihood - fitted.log_likelihood) * self.scale / seen.inflation[j]
            gained -= price(self.tested[j])
            top = max(top, gained)
            refits.append((gained, Item(there.effects[-1], self.tested[j]), there))
        return sorted(refits, key=lambda each: -each[0])

    def _start(self, entry: Entry, seen: Screen, j: int) -> float:
        """Where a refit begins."""
        parameter = entry.parameter
        null = parameter.null or 0.0
        if np.isfinite(seen.best[j]) and seen.best[j] != 0.0:
            return float(np.clip(null + seen.best[j], parameter.low, parameter.high))
        size = max(abs(seen.z[j] * seen.deviation[j]), parameter.step) ** (1.0 / parameter.power)
        return float(np.clip(null + np.sign(seen.z[j]) * size, parameter.low, parameter.high))

    def refitted(self, fitted: Fitted, entry: Entry, start: float) -> Fitted:
        """A joint refit with one more effect, from the best of some starts and shapes."""
        best: tuple[float, Active] | None = None
        for shape in self._shapes(entry):
            for part in (1.0, 0.25) if shape == entry.shape else (1.0,):
                active = replace(entry, shape=shape).at(start * part)
                value = float(self.prepared.log_prob(fitted.base, [*fitted.effects, active]).sum())
                if best is None or value > best[0]:
                    best = value, active
        assert best is not None
        return refit(self.prepared, [*fitted.effects, best[1]], fitted.base, ridge=RIDGE)

    def _shapes(self, entry: Entry) -> list[tuple[tuple[str, float], ...]]:
        """Its shape, and with one number of it moved over what is between and beside the values tried."""
        shapes = [entry.shape]
        for parameter in entry.effect.parameters:
            if parameter.null is not None or len(parameter.tried) < 2:
                continue
            low, high = min(parameter.tried), max(parameter.tried)
            beside = (high - low) / 2.0
            places = np.linspace(max(low - beside, parameter.low), min(high + beside, parameter.high), SHAPES)
            shapes += [
                tuple((name, float(f"{place:.4g}") if name == parameter.name else value) for name, value in entry.shape)
                for place in places
            ]
        return shapes

    def without(self, fitted: Fitted, k: int) -> Fitted:
        """The fit with the k-th effect taken out."""
        effects = [each for i, each in enumerate(fitted.effects) if i != k]
        return refit(self.prepared, effects, fitted.base, ridge=RIDGE)

    def loss(self, less: Fitted, fitted: Fitted) -> float:
        """Nats that the smaller of two fits loses, corrected for dependence as a whole."""
        return (fitted.log_likelihood - less.log_likelihood) * self.scale / self.common_inflation

    def free_forms(
        self, fitted: Fitted, channels: Sequence[CurveChannel] = CHANNELS, by_run: bool | None = None
    ) -> list[FreeForm]:
        """Curves that explain what is left."""
        unit = self.some_unit if (self.by_run if by_run is None else by_run) else None
        return adequacy.scan(self.curves, fitted.scores, fitted.here.shares, unit, channels)


def price(entry: Entry | None) -> float:
    """What the search over an entry's shapes gains by chance [nat]."""
    return 0.0 if entry is None else entry.price


def of_base(entry: Entry | None) -> bool:
    return entry is not None and entry.effect.base is not None
