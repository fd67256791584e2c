"""The statistics of the gap workflow from readings to an extended model: screen, name, prove, quote.

A model, readings with their contexts and a split by runs enter; an `Explanation` leaves. Everything is chosen and
fitted on one half, kept only if the other half scores better for it, and quoted from that other half.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

from msp_lab.gap.findings import Calibration, FoundEffect, NotTestable, Unknown, Value
from msp_lab.gap.name import Chosen, name, settle
from msp_lab.gap.prove import Gain, gain
from msp_lab.gap.quote import calibrated, told
from msp_lab.gap.refit import ROUNDS, Fitted, extended, refit
from msp_lab.gap.screen import Screen
from msp_lab.gap.search import RIDGE, Item, Search
from msp_lab.gap.tangent import BASE, Prepared
from msp_lab.gap.units import Split, numbered, previous
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Active, Model

_Array = NDArray[np.float64]
Progress = Callable[[str, float], None]
POWER_Z = 0.84
KEPT_Z = 0.5
"""Standard errors by which an item's gain on the confirming runs has to be above nothing."""
KEPT_NATS = 2.0
"""And by so much in total."""
MOST_CONFIRM = 60_000


@dataclass(frozen=True)
class Step:
    """A model on the way."""

    name: str
    model: Model
    gain_fit_nats: float


@dataclass(frozen=True)
class Explanation:
    """What the statistics found; see `explain`."""

    model: Model
    model_fit: Model
    effects: tuple[FoundEffect, ...]
    unknown: tuple[Unknown, ...]
    calibration: tuple[Calibration, ...]
    not_testable: tuple[NotTestable, ...]
    path: tuple[Step, ...]
    unit: Literal["reading", "run"]
    global_p_value: float
    detectable: tuple[tuple[str, str, float, str], ...]
    confirm: Gain
    dropped: tuple[tuple[str, str], ...] = ()
    messages: tuple[str, ...] = ()


def explain(
    model: Model,
    contexts: Mapping[str, Any],
    reading_cm: _Array,
    parts: Split,
    rng: np.random.Generator,
    alpha: float = 0.05,
    max_effects: int = 6,
    progress: Progress = lambda sentence, share: None,
) -> Explanation:
    """Name what is missing from a model, add it, and keep what the confirming runs score better for.

    Parameters
    ----------
    model
        As given.
    contexts
        Columns by name, (n,).
    reading_cm
        Readings, (n,), no NaN.
    parts
        Split by whole runs.
    rng
        Source of chance.
    alpha
        Chance of naming anything where nothing is missing, before the confirming runs are asked.
    max_effects
        At most so many effects and curves.
    progress
        Is told what is being done, and which share of it is behind.
    """
    reading_cm = np.rint(np.asarray(reading_cm, dtype=np.float64))
    columns = dict(contexts)
    columns["previous_reading_cm"] = previous(columns, reading_cm)
    unit = numbered(parts.runs)
    progress("fitting the base", 0.02)
    fit_rows, confirm_rows = np.flatnonzero(parts.fit), np.flatnonzero(parts.confirm)
    search = Search(model, _taken(columns, fit_rows), reading_cm[fit_rows], _again(unit[fit_rows]), rng, alpha)
    chosen = name(search, max_effects, progress)
    progress("asking the runs that took no part", 0.85)
    thin = confirm_rows[:: max(1, -(-confirm_rows.size // MOST_CONFIRM))]
    confirming = Prepared.of(model, _taken(columns, thin), reading_cm[thin])
    confirm_unit = _again(unit[thin])
    kept, gains, dropped = _prove(search, chosen, confirming, confirm_unit)
    if len(kept) < len(chosen.items):
        # What was dropped stood beside the others: without it another name may be the better one.
        less = _fitted(search, kept, chosen.fitted.base)
        chosen = settle(search, replace(chosen, items=tuple(kept), fitted=less, dropped=tuple(dropped)), progress)
        kept, gains, dropped = _prove(search, chosen, confirming, confirm_unit)
    last = _fitted(search, kept, chosen.fitted.base)
    as_given = not kept and _total(confirming, last.base) <= _total(confirming, np.zeros(len(BASE)))
    if as_given:
        last = refit(search.prepared, [], rounds=0)
    progress("quoting from the runs that took no part", 0.92)
    quoted = refit(confirming, last.effects, last.base, ridge=RIDGE, rounds=0 if as_given else ROUNDS)
    by_run = search.by_run
    covariance = quoted.covariance(confirm_unit if by_run else None)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    runs = int(np.unique(confirm_unit).size)
    width = float(student.isf(0.025, max(runs - 1, 1))) if by_run else 1.959964
    rivals = dict(zip((item.key for item in chosen.items), chosen.rivals, strict=True))
    named, unknown, as_base = told(search, kept, rivals, gains, quoted, covariance * width**2, confirming)
    null_base = last.base if as_given else search.null.base
    after_base, quoted_effects, last_base, last_effects = quoted.base, quoted.effects, last.base, last.effects
    if chosen.run_offset_cm > 0.0:
        offsets = _run_offsets(search, chosen.run_offset_cm, quoted, confirming, confirm_unit)
        if offsets is not None:
            found, own = offsets
            named.append(found)
            last_base, last_effects = _with_offsets(last, own, confirming)
            after_base, quoted_effects = _with_offsets(quoted, own, confirming)
    whole = gain(confirming.log_prob(last.base, last.effects), confirming.log_prob(null_base, []), confirm_unit)
    return Explanation(
        extended(model, after_base, quoted_effects),
        extended(model, last_base, last_effects),
        tuple(named),
        tuple(unknown),
        (*calibrated(model, search, last, quoted, deviation, width), *as_base),
        tuple(NotTestable(effect, absent, f"{' and '.join(absent)} not recorded") for effect, absent in search.missing),
        _path(model, search, chosen, kept, last),
        "run" if by_run else "reading",
        chosen.first.p_value,
        _detectable(search, chosen.first),
        whole,
        tuple(dropped),
        tuple(_messages(search, parts)),
    )


def _run_offsets(
    search: Search, deviation_cm: float, quoted: Fitted, confirming: Prepared, unit: NDArray[np.intp]
) -> tuple[FoundEffect, Active] | None:
    """Offsets between runs, if the confirming runs' sums say so too: a run's offset is integrated out."""
    slope = quoted.here.by[:, 0] - quoted.here.by[:, 0].mean()
    sums, information = np.bincount(unit, slope), np.bincount(unit, slope**2)
    rows = confirming.at(quoted.base, quoted.effects)
    known_cm2 = float(np.median(rows.between_cm2)) if rows.run_offsets else 0.0
    within = 1.0 - known_cm2 / float(np.median(rows.sigma_cm**2))
    mean_cm = sums / np.maximum(information, 1e-12)

    def of_runs(deviation: float) -> _Array:
        """Gain of each run: its mean is off by its offset, the model's own and this one, and by chance."""
        before = known_cm2 + within / np.maximum(information, 1e-12)
        after = before + deviation**2
        each: _Array = -0.5 * np.log(after / before) + 0.5 * mean_cm**2 * (1.0 / before - 1.0 / after)
        return each

    gains = of_runs(deviation_cm)
    runs = gains.size
    se = float(np.std(gains, ddof=1) * np.sqrt(runs)) if runs > 1 else 0.0
    if gains.sum() < KEPT_NATS:
        return None
    grid = deviation_cm * np.geomspace(0.1, 10.0, 200)
    height = np.array([of_runs(each).sum() for each in grid])
    inside = grid[height > height.max() - 1.92]
    effect = CATALOGUE["run_offsets"]
    value = float(grid[height.argmax()])
    n = len(confirming)
    named = FoundEffect(
        effect.name,
        "named",
        {"deviation_cm": Value(value, float(inside[0]), float(inside[-1]), "cm")},
        float(gains.sum()) / n,
        float(gains.sum()) / se if se > 0.0 else None,
        experiment=effect.experiment,
    )
    return named, Active(effect, {"deviation_cm": deviation_cm})


def _with_offsets(fitted: Fitted, own: Active, prepared: Prepared) -> tuple[_Array, tuple[Active, ...]]:
    """What lies between runs is taken from the spread within them."""
    sigma_cm = float(np.median(prepared.rows.sigma_cm)) * float(np.exp(fitted.base[1]))
    share = min((own.values["deviation_cm"] / sigma_cm) ** 2, 0.95)
    base = fitted.base.copy()
    base[1] += 0.5 * np.log1p(-share)
    return base, (*fitted.effects, own)


def _taken(columns: Mapping[str, Any], rows: NDArray[np.intp]) -> dict[str, Any]:
    return {key: np.asarray(column)[rows] for key, column in columns.items()}


def _again(unit: NDArray[np.intp]) -> NDArray[np.intp]:
    return np.unique(unit, return_inverse=True)[1].astype(np.intp)


def _total(prepared: Prepared, base: _Array) -> float:
    return float(prepared.log_prob(base, []).sum())


def _fitted(search: Search, items: Sequence[Item], base: _Array) -> Fitted:
    return refit(search.prepared, [item.active for item in items], base, ridge=RIDGE)


def _prove(
    search: Search, chosen: Chosen, confirming: Prepared, unit: NDArray[np.intp]
) -> tuple[list[Item], dict[tuple[str, str | None], Gain], list[tuple[str, str]]]:
    """Keep the items that the confirming runs score better for, the worst taken out first."""
    items, fitted = list(chosen.items), chosen.fitted
    dropped = list(chosen.dropped)
    gains: dict[tuple[str, str | None], Gain] = {}
    while items:
        gains = {}
        after = confirming.log_prob(fitted.base, fitted.effects)
        less: list[Fitted] = []
        for k, item in enumerate(items):
            less.append(search.without(fitted, k))
            gains[item.key] = gain(after, confirming.log_prob(less[k].base, less[k].effects), unit)
        worst = min(range(len(items)), key=lambda k: gains[items[k].key].z)
        proof = gains[items[worst].key]
        if proof.nats >= KEPT_NATS and proof.z >= KEPT_Z:
            break
        dropped.append(
            (
                items[worst].label,
                f"runs that took no part in choosing score {proof.nats_per_reading:+.2g} nats a reading "
                f"(standard error {proof.se:.2g})",
            )
        )
        fitted = less[worst]
        items = [item for k, item in enumerate(items) if k != worst]
        items = [replace(item, active=each) for item, each in zip(items, fitted.effects, strict=True)]
    return items, gains, dropped


def _path(model: Model, search: Search, chosen: Chosen, kept: Sequence[Item], last: Fitted) -> tuple[Step, ...]:
    """The given model, the calibrated one, and one more for each item that was kept."""
    steps = [Step("", model, 0.0), Step("calibration", extended(model, search.null.base, []), 0.0)]
    before = search.null
    for k, item in enumerate(kept):
        there = last if k == len(kept) - 1 else _fitted(search, kept[: k + 1], before.base)
        gained = (there.log_likelihood - before.log_likelihood) * search.scale
        steps.append(Step(item.label, extended(model, there.base, there.effects), gained))
        before = there
    return tuple(steps)


def _detectable(search: Search, seen: Screen) -> tuple[tuple[str, str, float, str], ...]:
    """Smallest number of each effect that is found with 80 % power."""
    least: dict[tuple[str, str], tuple[float, str]] = {}
    for entry, deviation in zip(search.tested, seen.deviation, strict=True):
        smallest = ((seen.critical + POWER_Z) * float(deviation)) ** (1.0 / entry.parameter.power)
        key = entry.effect.name, entry.parameter.name
        span = entry.parameter.high - entry.parameter.low
        if smallest < span and (key not in least or smallest < least[key][0]):
            least[key] = smallest, entry.parameter.unit
    return tuple((effect, parameter, size, unit) for (effect, parameter), (size, unit) in least.items())


def _messages(search: Search, parts: Split) -> list[str]:
    found = []
    if search.by_run:
        measured = search.depends(search.null)
        found.append(
            f"Readings depend on each other inside runs (correlation with the one before "
            f"{measured.lag_correlation:.2f}; of a constant they tell as much as "
            f"{measured.effective_readings:.0f} independent ones): the unit is the run."
        )
        if len(parts.fit_runs) < 8:
            found.append(
                f"With {len(parts.fit_runs)} runs for choosing, what is constant within a run cannot be judged."
            )
    return found
