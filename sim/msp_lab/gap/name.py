"""Which effects of the catalogue are missing: forward naming with joint refits, curves, swaps and elimination.

Readings for choosing and fitting enter; the accepted effects with their rivals and the path to them leave. An effect is
taken when its gain passes what the best of all entries gains by chance; others that do as well after a refit of their
own stay beside it as rivals; what a free curve explains and no name does is unknown.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2
from scipy.stats import f as fisher

from msp_lab.gap.curves import add_curves
from msp_lab.gap.refit import Fitted
from msp_lab.gap.rivals import RivalOf, beside_tails, eliminate, swap
from msp_lab.gap.screen import Screen
from msp_lab.gap.search import Item, Search
from msp_lab.gap.units import Dependence
from msp_sim.model.model import Active

_Array = NDArray[np.float64]
SURE_P = 1e-4
"""Chance below which runs differ by more than the model says."""
Say = Callable[[str, float], None]


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
    dropped: tuple[tuple[str, str], ...] = ()
    run_offset_cm: float = 0.0


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
        fitted, items, changed = add_curves(search, fitted, items, needed, max_effects - len(items), path, say)
        if not changed or len(items) >= max_effects or turn:
            break
        search.inform(fitted)
        seen = search.screen(fitted, items)
    return settle(search, Chosen(tuple(items), (), fitted, first, tuple(path)), say)


def settle(search: Search, chosen: Chosen, say: Say) -> Chosen:
    """Each name against all others in its place, needless ones taken out, and what runs differ by beside them."""
    needed = 0.5 * chosen.first.critical**2
    fitted, items = beside_tails(search, chosen.fitted, list(chosen.items), needed)
    fitted, items, of_item = swap(search, fitted, items, needed, say)
    fitted, items = eliminate(search, fitted, items, needed)
    left = search.depends(fitted)
    return replace(
        chosen,
        items=tuple(items),
        rivals=tuple(of_item.get(item.key, ()) for item in items),
        fitted=fitted,
        run_offset_cm=_run_offset_cm(search, fitted, left) if "run" in search.some else 0.0,
    )


def _run_offset_cm(search: Search, fitted: Fitted, left: Dependence) -> float:
    """Deviation of offsets between runs that the model lacks [cm]; 0 where there is none, or its spread has it already.

    A base that was fitted to readings of many runs takes their offsets for spread: then the whole spread is as it says.
    Where they are missing, the spread within runs is as it says, and the whole is larger.
    """
    if left.p_between > SURE_P or left.lag_z > 3.0:
        return 0.0
    share = min(left.between_run_share, 0.95)
    rows = search.prepared.at(fitted.base, fitted.effects)
    if rows.run_offsets:
        # What the model has already scatters from one set of runs to the next.
        whole_cm2, known_cm2 = float(np.median(rows.sigma_cm**2)), float(np.median(rows.between_cm2))
        runs = int(np.unique(search.some_unit).size)
        of_mean_cm2 = whole_cm2 * runs / len(search.prepared)
        times = (share * whole_cm2 + of_mean_cm2) / (known_cm2 + of_mean_cm2)
        if float(chi2.sf(times * (runs - 1), runs - 1)) > SURE_P:
            return 0.0
        return float(np.sqrt(share * whole_cm2 - known_cm2))
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
    had: set[frozenset[tuple[str, str | None]]] = set()
    while len(items) < max_effects:
        found = _next(search, fitted, items, seen, needed)
        if found is None:
            break
        before = fitted, items
        item, fitted = found
        say(f"found {item.key[0]}", 0.1 + 0.1 * len(items))
        fitted, items = eliminate(search, fitted, [*items, item], needed)
        now = frozenset(each.key for each in items)
        if now in had:
            # Names that take each other's place in turn: none of them is better than what was there.
            return before
        had.add(now)
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
