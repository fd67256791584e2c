"""Curves of the bias for hits so far off that the model takes them for outliers, which have no slope.

A fit enters, curves leave with the values at which their refit starts: the medians of the readings near each knot.
Where most readings of a place are far from their hits, as over a box on the floor, the likelihood of each is flat: no
score says that they would all be hits of a surface elsewhere.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.curve_scan import CandidateCurve, log_p_of
from msp_lab.gap.problem import Problem, State
from msp_lab.gap.refit import has_range
from msp_range.arrays import Array, Flags
from msp_sim.effects.curve import MAX_VALUE, Knots, hats
from msp_sim.model.model import make_curve_term


def far_curves(problem: Problem, state: State) -> list[CandidateCurve]:
    """Curves over one column with a knot whose readings are far off, the least likely by random variation first."""
    rows, reading_cm = problem.readings.at(state.fit.base, state.fit.effects), problem.readings.reading_cm
    usual = has_range(rows, reading_cm)
    off_cm = (reading_cm - rows.centre_cm)[usual]
    far = np.abs(off_cm) > rules.FAR_SIGMAS * np.broadcast_to(rows.sigma_cm, reading_cm.shape)[usual]
    if far.sum() < rules.CELL_MIN_HITS:
        return []
    now = float(state.fit.here.log_p.sum())
    found = []
    for variables, knots in problem.curves.curves:
        if len(variables) > 1:
            continue
        column = np.asarray(problem.contexts[variables[0]])
        start_cm = _medians(column[usual], knots[0], off_cm, far)
        if start_cm is None:
            continue
        term = replace(make_curve_term("bias", variables, knots, start_cm), is_added=True)
        gain = problem.readings.log_likelihood(state.fit.base, [*state.fit.effects, term]) - now
        if gain > 0.0:
            log_p = log_p_of(2.0 * gain, len(start_cm))
            found.append(CandidateCurve("bias", variables, knots, gain, len(start_cm), log_p, start=start_cm))
    return sorted(found, key=lambda each: each.log_p)


def _medians(column: NDArray[np.generic], knots: Knots, off_cm: Array, far: Flags) -> tuple[float, ...] | None:
    """Median of the readings nearest to each knot, 0 where there are few or it is beyond any curve's.

    None where no knot's readings are mostly far off.
    """
    weights = hats({"column": column}, ["column"], [knots])
    nearest = np.where(weights.max(axis=1) > 0.0, weights.argmax(axis=1), -1)
    medians, is_far = np.zeros(weights.shape[1]), False
    for k in range(medians.size):
        own = nearest == k
        median_cm = float(np.median(off_cm[own])) if own.sum() >= rules.CELL_MIN_HITS else np.inf
        if abs(median_cm) < MAX_VALUE["bias"]:
            medians[k] = median_cm
            is_far |= bool(far[own].mean() > 0.5)
    return tuple(medians.tolist()) if is_far else None
