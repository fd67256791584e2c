"""Which of the names that were taken stay, and which do as well in their place.

A fit with its items enters, a fit with better ones leaves, and for each its rivals: names that gain as much after a
refit of their own and that these data cannot tell from it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from msp_lab.gap.refit import Fitted
from msp_lab.gap.search import Item, Search, of_base, price
from msp_sim.model.model import Active

Key = tuple[str, str | None]

BASE_NATS = 3.0
"""By so much an effect has to do better than a number of the base that these data cannot tell from it."""
NEAR_NATS = 5.0
"""Rivals: within this of the best."""
SEPARABLE = 3.0
"""Standard errors that tell two effects apart."""
KEEP = 0.6
"""Share of the gain needed to come in that an effect needs to stay."""
TAILS, TAILS_SHARE = "heavy_tails", 0.05
"""What each component has to gain beside, and the share at which its fit begins."""


@dataclass(frozen=True)
class RivalOf:
    """Another effect in an item's place."""

    active: Active
    loss: float
    correlation: float
    separation: float


def eliminate(search: Search, fitted: Fitted, items: list[Item], needed: float) -> tuple[Fitted, list[Item]]:
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


def beside_tails(search: Search, fitted: Fitted, items: list[Item], needed: float) -> tuple[Fitted, list[Item]]:
    """Tails of the noise look like a component on the side that has more of them: it has to gain beside them too."""
    tails = next((entry for entry in search.tested if entry.key == (TAILS, None)), None)
    for item in [each for each in items if each.entry is not None and each.entry.linear and each.key[0] != TAILS]:
        if tails is None or any(each.key[0] == TAILS for each in items):
            break
        k = next(i for i, each in enumerate(items) if each.key == item.key)
        both = search.refitted(fitted, tails, TAILS_SHARE)
        only_tails = search.without(both, k)
        if search.loss(only_tails, both) - price(item.entry) >= needed:
            continue
        rest = [each for i, each in enumerate(items) if i != k]
        fitted, items = search.without(fitted, k), rest
        gained = search.loss(fitted, only_tails)
        if gained - price(tails) >= needed:
            fitted = only_tails
            items = [*rest, Item(only_tails.effects[-1], tails)]
    return fitted, [replace(item, active=each) for item, each in zip(items, fitted.effects, strict=True)]


def swap(
    search: Search, fitted: Fitted, items: list[Item], needed: float, say: Callable[[str, float], None]
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
            # Of the rows that are refitted: between two that are alike, more rows are not more certain than they are.
            own /= search.scale
            scaled = [
                ((there.log_likelihood - less.log_likelihood) / search.common_inflation, other, there)
                for _, other, there in found
            ]
            same = [each for each in scaled if each[1].key == item.key]
            if same and same[0][0] > own:
                own = same[0][0]
            others = [each for each in scaled if each[1].key != item.key]
            correlated = _correlations([(fitted, k, item), *((there, len(rest), each) for _, each, there in others)])
            apart = {
                each.key: float(np.sqrt(2.0 * max(own, 0.0)) * np.sqrt(max(1.0 - correlation**2, 0.0)))
                for (_, each, _), correlation in zip(others, correlated, strict=True)
            }

            def ahead(
                each: tuple[float, Item, Fitted], item: Item = item, own: float = own, apart: dict[Key, float] = apart
            ) -> float:
                """By how much another does better. A number of the base comes before an effect that is like it."""
                lead = each[0] - price(each[1].entry) - own + price(item.entry)
                if apart[each[1].key] < SEPARABLE:
                    lead += BASE_NATS * (of_base(each[1].entry) - of_base(item.entry))
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
            for (gained, other, _), correlation in zip(others, correlated, strict=True):
                same_name = other.active.effect.name == item.active.effect.name
                if own - gained <= NEAR_NATS and apart[other.key] < SEPARABLE and not same_name:
                    near.append(RivalOf(other.active, float(own - gained), correlation, apart[other.key]))
            rivals[item.key] = () if of_base(item.entry) else tuple(near)
        if not swapped:
            break
    return fitted, items, rivals


def _correlations(fits: Sequence[tuple[Fitted, int, Item]]) -> list[float]:
    """Of the first effect's score with each other's, as they were fitted, beside all that else is in the model."""
    left = []
    for fit, k, item in fits:
        assert item.entry is not None
        others = fit.scores[:, [not name.startswith(f"{k}.") for name in fit.names]]
        basis = np.linalg.qr(others[:, np.any(others != 0.0, axis=0)])[0]
        own = fit.scores[:, fit.names.index(f"{k}.{item.entry.parameter.name}")]
        rest = own - basis @ (basis.T @ own)
        left.append(rest / max(float(np.linalg.norm(rest)), 1e-12))
    return [float(left[0] @ each) for each in left[1:]]
