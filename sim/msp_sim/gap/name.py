"""Which effects of the catalogue are missing: forward naming with joint refits, swaps, elimination, rivals and curves.

Readings for choosing and fitting enter; the accepted effects with their rivals and the path to them leave. An effect is
taken when its gain passes what the best of all entries gains by chance; others that do as well after a refit of their
own stay beside it as rivals; what a free curve explains and no name does is unknown.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from msp_sim.effects.curve import CurveChannel
from msp_sim.gap import adequacy
from msp_sim.gap.adequacy import FreeForm
from msp_sim.gap.beginning import fit_base
from msp_sim.gap.refit import Fitted, refit
from msp_sim.gap.screen import Screen, Sums, information_of, screen, sums, twin
from msp_sim.gap.tangent import CHANNELS, Entry, Prepared, entries
from msp_sim.gap.units import Dependence, dependence
from msp_sim.model.model import Active, Model, active_curve

_Array = NDArray[np.float64]
Say = Callable[[str, float], None]

MOST_ROWS = 20_000
"""Rows of a refit while effects are chosen; of more, every k-th."""
TRIED = 6
MOST_TRIED = 12
"""Refits in one go: as many as seem near, and so many at most."""
SHAPES = 25
NEAR_NATS = 3.0
"""Rivals: within this of the best."""
SEPARABLE = 3.0
"""Standard errors that tell two effects apart."""
SHAPE_NATS = 0.7
PLACE_NATS = 2.0
"""What a number of a shape gains by chance, and what a place that readings gather at does."""
KEEP = 0.6
"""Share of the gain needed to come in that an effect needs to stay."""
UNKNOWN_P = 0.02
"""Chance of a curve, of all that are asked for, where nothing is there."""
TAILS, TAILS_SHARE = "heavy_tails", 0.05
CURVES_TRIED = 6
FORM_SHARE = 0.85
"""Of what a free curve gains: a name that gains so much is the effect, though its form may not be exact."""
RIDGE = 0.05
SPECIAL = frozenset({"run_offsets"})
"""Seen between runs, and not in single readings."""


@dataclass(frozen=True)
class Item:
    """An effect or a curve that is in the model."""

    active: Active
    entry: Entry | None
    z: float = 0.0
    gain: float = 0.0

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


@dataclass(frozen=True)
class RivalOf:
    """Another effect in an item's place."""

    active: Active
    loss: float
    correlation: float
    separation: float


@dataclass(frozen=True)
class Chosen:
    """The end of naming.

    Attributes
    ----------
    items
        In order of acceptance.
    rivals
        Of each.
    fitted
        The joint fit, on the rows for choosing.
    first
        The first screen.
    path
        Names with the fits after each.
    """

    items: tuple[Item, ...]
    rivals: tuple[tuple[RivalOf, ...], ...]
    fitted: Fitted
    first: Screen
    path: tuple[tuple[str, _Array, tuple[Active, ...]], ...]
    dependence: Dependence
    dropped: tuple[tuple[str, str], ...] = ()
    run_offset_cm: float = 0.0


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
        self.stride = -(-n // MOST_ROWS)
        thin = slice(None, None, self.stride)
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
            # What the screen promises is not always there: the best refit so far says what is near.
            if seen.gain[j] < least or (len(refits) >= TRIED and seen.gain[j] < top - within):
                break
            if refits and seen.gain[j] < top - within:
                break
            there = self.refitted(fitted, self.tested[j], self._start(self.tested[j], seen, j))
            gained = (there.log_likelihood - fitted.log_likelihood) * self.scale / seen.inflation[j]
            gained -= _price(self.tested[j])
            top = max(top, gained)
            refits.append((gained, Item(there.effects[-1], self.tested[j], float(seen.z[j]), gained), there))
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


def name(search: Search, max_effects: int, say: Say) -> Chosen:
    """Name what is missing."""
    fitted = search.null
    items: list[Item] = []
    path: list[tuple[str, _Array, tuple[Active, ...]]] = []
    first = search.screen(fitted, items)
    needed = 0.5 * first.critical**2
    if search.by_run:
        search.common_inflation = float(np.median(first.inflation))
    seen = first
    for turn in range(2):
        fitted, items = _forward(search, fitted, items, seen, needed, max_effects, path, say)
        fitted, items, changed = _curves(search, fitted, items, needed, path, say)
        if not changed or len(items) >= max_effects or turn:
            break
        search.inform(fitted)
        seen = search.screen(fitted, items)
    return settle(search, Chosen(tuple(items), (), fitted, first, tuple(path), search.depends(fitted)), say)


def settle(search: Search, chosen: Chosen, say: Say) -> Chosen:
    """Each name against all others in its place, needless ones taken out, and what runs differ by beside them."""
    needed = 0.5 * chosen.first.critical**2
    fitted, items = _beside_tails(search, chosen.fitted, list(chosen.items), needed)
    fitted, items, of_item = _swaps(search, fitted, items, needed, say)
    fitted, items = _eliminate(search, fitted, items, needed)
    left = search.depends(fitted)
    return replace(
        chosen,
        items=tuple(items),
        rivals=tuple(of_item.get(item.key, ()) for item in items),
        fitted=fitted,
        dependence=left,
        run_offset_cm=_run_offset_cm(search, fitted, left) if "run" in search.some else 0.0,
    )


def _run_offset_cm(search: Search, fitted: Fitted, left: Dependence) -> float:
    """Deviation of offsets between runs that the model lacks [cm]; 0 where there is none, or its spread has it already.

    A base that was fitted to readings of many runs takes their offsets for spread: then the whole spread is as it says.
    Where they are missing, the spread within runs is as it says, and the whole is larger.
    """
    if left.p_between > 1e-4 or left.lag_z > 3.0:
        return 0.0
    share = min(left.between_run_share, 0.95)
    whole = float(fitted.base[1])
    within = whole + 0.5 * float(np.log1p(-share))
    if abs(whole) < abs(within):
        return 0.0
    sigma_cm = float(np.median(search.prepared.rows.sigma_cm)) * float(np.exp(whole))
    return sigma_cm * float(np.sqrt(share))


def _forward(
    search: Search,
    fitted: Fitted,
    items: list[Item],
    seen: Screen,
    needed: float,
    max_effects: int,
    path: list[tuple[str, _Array, tuple[Active, ...]]],
    say: Say,
) -> tuple[Fitted, list[Item]]:
    while len(items) < max_effects:
        found = _next(search, fitted, items, seen, needed)
        if found is None:
            break
        item, fitted = found
        items = [*items, item]
        say(f"found {item.key[0]}", 0.1 + 0.1 * len(items))
        fitted, items = _eliminate(search, fitted, items, needed)
        path.append((item.key[0], fitted.base, fitted.effects))
        _update_unit(search, fitted)
        search.inform(fitted)
        seen = search.screen(fitted, items)
    return fitted, items


def _next(search: Search, fitted: Fitted, items: list[Item], seen: Screen, needed: float) -> tuple[Item, Fitted] | None:
    """The name that gains most after its refit, if it gains enough.

    What differs from run to run looks like dependence until it is named: where readings are independent beside a name,
    its gain counts as it is, against chance by as many runs as there are. Otherwise it counts by whole runs.
    """
    if not search.by_run:
        if seen.largest < seen.critical:
            return None
        found = search.candidates(fitted, items, seen, 6.0, 0.6 * needed)
        return (found[0][1], found[0][2]) if found and found[0][0] >= needed else None
    free = replace(seen, gain=seen.gain * seen.inflation, inflation=np.ones_like(seen.inflation))
    runs = int(np.unique(search.some_unit).size)
    names = len({entry.key for entry in search.tested})
    for gained, item, there in search.candidates(fitted, items, free, 6.0, needed):
        if gained < needed:
            break
        left = search.depends(there)
        if left.p_between > 0.02 and left.lag_z < 2.5:
            if float(fisher.sf(2.0 * gained, 1, max(runs - 2, 1))) < search.alpha / names:
                return item, there
        elif seen.largest >= seen.critical and gained / seen.inflation[search.nearest(item)] >= needed:
            return item, there
    return None


def _update_unit(search: Search, fitted: Fitted) -> None:
    """An effect that changes slowly looks like dependence until it is named."""
    search.by_run = search.depends(fitted).dependent
    if not search.by_run:
        search.common_inflation = 1.0


def _eliminate(search: Search, fitted: Fitted, items: list[Item], needed: float) -> tuple[Fitted, list[Item]]:
    """Take out what the others have made needless."""
    while len(items) > 1:
        losses = []
        for k, item in enumerate(items):
            less = search.without(fitted, k)
            numbers = len(item.active.values) if item.active.shape is not None else 1
            need = needed * KEEP + (0.5 * numbers if numbers > 1 else 0.0)
            losses.append((search.loss(less, fitted) - need, k, less))
        worst = min(losses, key=lambda each: each[0])
        if worst[0] >= 0.0:
            break
        fitted = worst[2]
        items = [item for i, item in enumerate(items) if i != worst[1]]
    return fitted, [replace(item, active=each) for item, each in zip(items, fitted.effects, strict=True)]


def _curves(
    search: Search,
    fitted: Fitted,
    items: list[Item],
    needed: float,
    path: list[tuple[str, _Array, tuple[Active, ...]]],
    say: Say,
) -> tuple[Fitted, list[Item], bool]:
    """Add curves for what no name explains; names that a curve makes needless go."""
    changed = False
    say("asking for what no name explains", 0.5)
    for _ in range(3):
        forms = search.free_forms(fitted)
        singles = sum(len(each.variables) == 1 for each in forms)
        found = _likeliest_curve(search, fitted, items, forms, singles)
        if found is None and search.by_run:
            found = _curve_between_runs(search, fitted, items, singles)
        if found is None:
            break
        fitted, items = found
        fitted, items = _eliminate(search, fitted, items, needed)
        changed = True
    for channel in CHANNELS:
        named = [k for k, item in enumerate(items) if item.entry is not None and channel in item.active.effect.channels]
        if not named:
            continue
        rest = [item for k, item in enumerate(items) if k not in named]
        less = refit(search.prepared, [item.active for item in rest], fitted.base, ridge=RIDGE)
        forms = search.free_forms(less, (channel,))
        if not forms or forms[0].degrees == 0:
            continue
        there, others = _with_curve(search, less, rest, forms[0])
        more = search.loss(fitted, there)
        spare = max(forms[0].degrees - sum(1 + len(_shape(items[k])) for k in named), 1)
        cost = adequacy.PAIR_COST if len(forms[0].variables) > 1 else 0.0
        if search.loss(less, fitted) > FORM_SHARE * search.loss(less, there):
            continue
        least = 0.5 * float(chi2.isf(UNKNOWN_P / 10.0 / len(forms), spare)) - 0.5 * max(len(named) - 1, 0)
        if more > cost + least:
            fitted, items, changed = there, others, True
    if changed:
        path.append(("curve", fitted.base, fitted.effects))
    return fitted, items, changed


def _likeliest_curve(
    search: Search, fitted: Fitted, items: list[Item], forms: Sequence[FreeForm], asked: int
) -> tuple[Fitted, list[Item]] | None:
    """The first of the likeliest curves that gains after a refit what its score promises."""
    for form in forms[:CURVES_TRIED]:
        if not _unlikely(form, asked):
            return None
        there, added = _with_curve(search, fitted, items, form)
        statistic = 2.0 * max(search.loss(fitted, there), 0.0)
        if _unlikely(replace(form, log_p=adequacy.log_chance(statistic, form.degrees)), asked):
            return there, added
    return None


def _curve_between_runs(
    search: Search, fitted: Fitted, items: list[Item], singles: int
) -> tuple[Fitted, list[Item]] | None:
    """A curve that differs from run to run, with which readings are independent: see `_between_runs`."""
    runs = int(np.unique(search.some_unit).size)
    forms = search.free_forms(fitted, ("bias", "spread"), by_run=False)
    for form in forms[:4]:
        left = max(runs - 2 - form.degrees, 1)
        if form.degrees >= runs // 3 or not _unlikely(form, singles):
            continue
        there, added = _with_curve(search, fitted, items, form)
        rest = search.depends(there)
        gained = 2.0 * (there.log_likelihood - fitted.log_likelihood) * search.scale / form.degrees
        if rest.p_between > 0.02 and rest.lag_z < 2.5 and fisher.sf(gained, form.degrees, left) < UNKNOWN_P / singles:
            search.by_run, search.common_inflation = False, 1.0
            return there, added
    return None


def _unlikely(form: FreeForm, asked: int) -> bool:
    cost = adequacy.PAIR_COST if len(form.variables) > 1 else 0.0
    return form.degrees > 0 and form.log_p + cost < np.log(UNKNOWN_P) - np.log(asked)


def _with_curve(search: Search, fitted: Fitted, items: list[Item], form: FreeForm) -> tuple[Fitted, list[Item]]:
    values = [0.0] * int(np.prod([len(each) for each in form.knots]))
    active = active_curve(form.channel, list(form.variables), [list(each) for each in form.knots], values)
    there = refit(search.prepared, [*fitted.effects, active], fitted.base, ridge=RIDGE)
    item = Item(there.effects[-1], None, float(np.sqrt(2.0 * max(form.gain, 0.0))), form.gain)
    kept = [replace(old, active=each) for old, each in zip(items, there.effects, strict=False)]
    return there, [*kept, item]


def _beside_tails(search: Search, fitted: Fitted, items: list[Item], needed: float) -> tuple[Fitted, list[Item]]:
    """Tails of the noise look like a component on the side that has more of them: it has to gain beside them too."""
    tails = next((entry for entry in search.tested if entry.key == (TAILS, None)), None)
    for item in [each for each in items if each.entry is not None and each.entry.linear and each.key[0] != TAILS]:
        if tails is None or any(each.key[0] == TAILS for each in items):
            break
        k = next(i for i, each in enumerate(items) if each.key == item.key)
        both = search.refitted(fitted, tails, TAILS_SHARE)
        only_tails = search.without(both, k)
        if search.loss(only_tails, both) - _price(item.entry) >= needed:
            continue
        rest = [each for i, each in enumerate(items) if i != k]
        fitted, items = search.without(fitted, k), rest
        gained = search.loss(fitted, only_tails)
        if gained - _price(tails) >= needed:
            fitted = only_tails
            items = [*rest, Item(only_tails.effects[-1], tails, float(np.sqrt(2.0 * gained)), gained)]
    return fitted, [replace(item, active=each) for item, each in zip(items, fitted.effects, strict=True)]


def _swaps(
    search: Search, fitted: Fitted, items: list[Item], needed: float, say: Say
) -> tuple[Fitted, list[Item], dict[tuple[str, str | None], tuple[RivalOf, ...]]]:
    """Each effect against all others in its place: a better one takes it, others that do as well are its rivals."""
    rivals: dict[tuple[str, str | None], tuple[RivalOf, ...]] = {}
    for turn in range(3):
        swapped = False
        rivals = {}
        for k, item in enumerate(items):
            if item.entry is None:
                continue
            say(f"looking for rivals of {item.key[0]}", 0.6 + 0.1 * turn)
            less = search.without(fitted, k)
            rest = [other for i, other in enumerate(items) if i != k]
            seen = search.screen(less, rest)
            own = search.loss(less, fitted)
            found = search.candidates(less, rest, seen, max(8.0, 0.25 * own), 0.3 * needed)
            scaled = [
                ((there.log_likelihood - less.log_likelihood) * search.scale / search.common_inflation, other, there)
                for _, other, there in found
            ]
            same = [each for each in scaled if each[1].key == item.key]
            if same and same[0][0] > own:
                own = same[0][0]
            others = [each for each in scaled if each[1].key != item.key]
            mine = search.nearest(item)

            def apart(other: Item, mine: int = mine, own: float = own, seen: Screen = seen) -> tuple[float, float]:
                """Correlation with another, and the standard errors that tell it from this one."""
                correlation = float(seen.correlation[mine, search.nearest(other)])
                return correlation, float(np.sqrt(2.0 * max(own, 0.0)) * np.sqrt(max(1.0 - correlation**2, 0.0)))

            def ahead(each: tuple[float, Item, Fitted], item: Item = item, own: float = own) -> float:
                """By how much another does better. A number of the base comes before an effect that is like it."""
                lead = each[0] - _price(each[1].entry) - own + _price(item.entry)
                if apart(each[1])[1] < SEPARABLE:
                    lead += NEAR_NATS * (_of_base(each[1].entry) - _of_base(item.entry))
                return lead

            better = max(others, key=ahead, default=None)
            if better is not None and ahead(better) > 0.3:
                order = [*rest, better[1]]
                say(f"{better[1].key[0]} in place of {item.key[0]}", 0.65)
                fitted = better[2]
                items = [replace(old, active=each) for old, each in zip(order, fitted.effects, strict=True)]
                swapped = True
                break
            near = []
            for gained, other, _ in others:
                if own - gained > NEAR_NATS or other.active.effect.name == item.active.effect.name:
                    continue
                correlation, separation = apart(other)
                if separation < SEPARABLE:
                    near.append(RivalOf(other.active, float(own - gained), correlation, separation))
            rivals[item.key] = () if _of_base(item.entry) else tuple(near)
            items[k] = replace(item, z=float(seen.z[mine]), gain=own)
        if not swapped:
            break
    return fitted, items, rivals


def _price(entry: Entry | None) -> float:
    """What the search over an entry's shapes gains by chance [nat]."""
    if entry is None:
        return 0.0
    searched = sum(len(parameter.tried) > 1 for parameter in entry.effect.parameters)
    return searched * (PLACE_NATS if entry.linear else SHAPE_NATS)


def _of_base(entry: Entry | None) -> bool:
    return entry is not None and entry.effect.base is not None


def _shape(item: Item) -> tuple[tuple[str, float], ...]:
    return item.entry.shape if item.entry is not None else ()
