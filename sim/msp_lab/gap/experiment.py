"""Which experiment would tell two effects apart that these data cannot.

The sentence has numbers for an effect, its alternatives and the readings' contexts. Each context is spread out, the
others as they were, until the two effects' scores differ by enough standard errors for as many readings.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.candidates import SelectedTerm
from msp_lab.gap.exchange import AlternativeTerm
from msp_lab.gap.labels import unit_of
from msp_lab.gap.prepared import CHANNELS, templates
from msp_lab.gap.problem import Problem
from msp_lab.gap.refit import JointFit
from msp_range.arrays import Array
from msp_sim.effects.base import WORD_COLUMNS, Scene
from msp_sim.model.model import Term, applies

SPANS = {
    "true_range_cm": (20.0, 765.0),
    "air_temperature_c": (-10.0, 45.0),
    "target_temperature_c": (-10.0, 60.0),
    "humidity_pct": (5.0, 95.0),
    "incidence_deg": (-40.0, 40.0),
    "range_rate_cm_s": (-300.0, 300.0),
    "throttle": (0.0, 1.0),
    "vibration_hz": (0.0, 200.0),
    "uptime_s": (0.0, 3600.0),
}
"""How far a context can reasonably be varied."""
SHARES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.75, 1.0)
"""Shares of those spans; the smallest that is enough is suggested."""


def to_tell_apart(problem: Problem, base: JointFit, term: SelectedTerm, alternatives: Sequence[AlternativeTerm]) -> str:
    """A sentence for each alternative; `base` is the fit before any term."""
    return "; ".join(_sentence(problem, base, term.active, each.active) for each in alternatives)


def _sentence(problem: Problem, base: JointFit, own: Term, other: Term) -> str:
    best: tuple[float, str] | None = None
    for column in sorted((own.effect.columns | other.effect.columns) - WORD_COLUMNS):
        if column not in SPANS or column not in problem.contexts:
            continue
        low, high = SPANS[column]
        values = problem.contexts[column]
        middle = float(np.clip(np.nanmedian(values), low, high))
        for share in SHARES:
            start, end = middle - share * (middle - low), middle + share * (high - middle)
            drawn = start + (end - start) * _even(values.size)
            if _separation(problem, base, own, other, {**problem.contexts, column: drawn}) >= rules.SEPARABLE_Z:
                if best is None or share < best[0]:
                    text = f"vary {column} evenly from {start:.3g} to {end:.3g} {unit_of(column)}".rstrip()
                    now = float(np.nanmax(values) - np.nanmin(values))
                    best = share, f"{text} (by {end - start:.3g}; here by {now:.3g}) in as many readings"
                break
    text = best[1] if best else f"{own.effect.experiment}; or {other.effect.experiment}"
    return f"to tell {own.effect.name} from {other.effect.name}: {text}"


def _even(n: int) -> Array:
    """Numbers spread evenly over 0 to 1, in an order (golden ratio) that correlates with no column."""
    return np.asarray(np.mod(0.5 + np.arange(n) * 0.6180339887498949, 1.0))


def _separation(problem: Problem, base: JointFit, own: Term, other: Term, contexts: dict[str, Any]) -> float:
    """Standard errors between two effects, by their templates in the channels' units of information."""
    scene = Scene(problem.model.sensor, contexts)
    weights = np.sqrt(np.mean(base.here.by[:, : len(CHANNELS)] ** 2, axis=0))
    one, two = _templates(scene, own, weights), _templates(scene, other, weights)
    size = float(np.linalg.norm(one))
    if size == 0.0 or not np.any(two):
        return 0.0
    correlation = float((one * two).sum() / (np.linalg.norm(one) * np.linalg.norm(two)))
    return size * float(np.sqrt(max(1.0 - correlation**2, 0.0)))


def _templates(scene: Scene, each: Term, weights: Array) -> Array:
    known = applies(scene, each)
    found = np.zeros((scene.range_cm.size, len(CHANNELS)))
    if known is False:
        return found
    for i, template in templates(known, each.change(scene)).items():
        found[:, i] = weights[i] * template
    found -= found.mean(axis=0)
    return found
