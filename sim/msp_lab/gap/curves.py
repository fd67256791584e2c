"""Curves for what no name explains, and for names whose form is not that of the data.

A fit with its items enters, a fit with curves among them leaves. A curve is taken when a refit gains what its score
promises; a name goes when a free form on its channel gains clearly more than it does.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from msp_lab.gap import adequacy
from msp_lab.gap.adequacy import FreeForm
from msp_lab.gap.refit import Fitted, refit
from msp_lab.gap.rivals import eliminate
from msp_lab.gap.search import RIDGE, Item, Search
from msp_lab.gap.tangent import CHANNELS
from msp_sim.model.model import Active, active_curve

_Array = NDArray[np.float64]

UNKNOWN_P = 0.02
"""Chance of a curve, of all that are asked for, where nothing is there."""
CURVES_TRIED = 6
"""Refits until one gains what its score promises."""
FORM_SHARE = 0.85
"""Of what a free curve gains: a name that gains so much is the effect, though its form may not be exact."""


def add_curves(
    search: Search,
    fitted: Fitted,
    items: list[Item],
    needed: float,
    most: int,
    path: list[tuple[str, _Array, tuple[Active, ...]]],
    say: Callable[[str, float], None],
) -> tuple[Fitted, list[Item], bool]:
    """Add at most so many curves for what no name explains; names that a curve makes needless go."""
    changed = False
    say("asking for what no name explains", 0.5)
    for _ in range(min(most, 3)):
        forms = search.free_forms(fitted)
        singles = sum(len(each.variables) == 1 for each in forms)
        found = _likeliest_curve(search, fitted, items, forms, singles)
        if found is None and search.by_run:
            found = _curve_between_runs(search, fitted, items, singles)
        if found is None:
            break
        fitted, items = found
        fitted, items = eliminate(search, fitted, items, needed)
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
    """A finer curve over the same columns takes the place of a coarser one."""
    values = [0.0] * int(np.prod([len(each) for each in form.knots]))
    active = active_curve(form.channel, list(form.variables), [list(each) for each in form.knots], values)
    added = Item(active, None)
    others = [item for item in items if item.key != added.key]
    there = refit(search.prepared, [*(item.active for item in others), active], fitted.base, ridge=RIDGE)
    return there, [replace(item, active=each) for item, each in zip([*others, added], there.effects, strict=True)]


def _shape(item: Item) -> tuple[tuple[str, float], ...]:
    return item.entry.shape if item.entry is not None else ()
