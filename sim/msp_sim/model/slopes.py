"""Derivatives of the readings' log probabilities by the parameters of the mixture, all in one pass.

Rows and readings enter; log probabilities and their derivatives leave, for fits and scores. All steps after the mixture
(saturation, faults of the code) are linear in the probability, so derivatives of the mixture pass through them in the
same way as the probability itself.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from msp_sim.effects.codes import CodeFault
from msp_sim.effects.component import Component
from msp_sim.model.rows import AddedComponent, AppliedFault, ModelRows

_Array = NDArray[np.float64]

MIN_PROBABILITY = 1e-12
"""Smallest probability of a reading: one that the model cannot give is treated as this improbable, so that a single
impossible reading does not make every likelihood zero. Smaller gives such readings more weight."""


def slopes(rows: ModelRows, reading_cm: _Array) -> tuple[_Array, _Array]:
    """Log probabilities and their derivatives.

    Parameters
    ----------
    rows
        The distribution of n readings.
    reading_cm
        The readings [cm], (n,).

    Returns
    -------
    log_p : ndarray, shape (n,)
        At least log `MIN_PROBABILITY`, where the derivatives are 0.
    by : ndarray, shape (n, 7)
        In the order of `msp_range.reading_model.rows.FREE`: by the centre of the hits [1/cm], the logarithm of their
        spread within runs, the log odds of short, missed and random readings, the logarithm of the rate of short
        readings, and the saturated fraction.
    """
    parts = rows.of_readings(reading_cm, ModelRows.slopes)
    p = np.maximum(parts[0], MIN_PROBABILITY)
    by = np.where(parts[0] > MIN_PROBABILITY, parts[1:] / p, 0.0)
    by[1] *= rows.within_share
    return np.log(p), np.ascontiguousarray(by.T)


def log_prob(rows: ModelRows, reading_cm: _Array) -> _Array:
    """Log probabilities alone, (n,): as `ModelRows.log_prob`, but at least log `MIN_PROBABILITY`."""
    return np.asarray(np.log(np.maximum(rows.of_readings(reading_cm, ModelRows.probability)[0], MIN_PROBABILITY)))


def score_of_component(rows: ModelRows, reading_cm: _Array, component: Component, log_p: _Array) -> _Array:
    """Derivative of the log probabilities by the odds of one more component, at odds of 0, (n,)."""
    others = 1.0 + sum(np.asarray(each.odds) for each in rows.added)
    own = replace(rows, added=(AddedComponent(1.0, component, ""),)).of_readings(reading_cm, ModelRows.last_added)[0]
    return _ratio(own, log_p) / others


def score_of_fault(rows: ModelRows, reading_cm: _Array, fault: CodeFault, log_p: _Array) -> _Array:
    """Derivative of the log probabilities by the share of one more fault, at a share of 0, (n,)."""
    faults = sorted((*rows.faults, AppliedFault(1.0, fault, "")), key=lambda each: each.fault.order)
    own = replace(rows, faults=tuple(faults)).of_readings(reading_cm, ModelRows.probability)[0]
    return _ratio(own, log_p)


def _ratio(own: _Array, log_p: _Array) -> _Array:
    """The added probability divided by the present one, minus 1; an impossible reading cannot become less probable."""
    p = np.exp(log_p)
    score: _Array = np.maximum(own / p - 1.0, np.where(p > MIN_PROBABILITY * (1.0 + 1e-9), -1.0, 0.0))
    return score
