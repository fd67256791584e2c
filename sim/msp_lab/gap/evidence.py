"""How much one joint fit gains over another, where readings of a run may share an offset.

Two fits of the same readings enter, nats leave. Where runs differ by more than the model says, each run has an offset
that is integrated out: per run u with the score S_u and the information I_u of an offset, a fit's log-likelihood grows
by ``max over tau of sum_u [tau^2 S_u^2 / (1 + tau^2 I_u) - log(1 + tau^2 I_u)] / 2`` (Laplace). What is evident inside
runs counts as it is, whatever the number of runs; what is evident only between runs counts by Student's t of as many
runs. So an effect is judged at the level at which it varies.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import norm
from scipy.stats import t as student

from msp_lab.gap import rules
from msp_lab.gap.refit import JointFit, sums_by
from msp_lab.gap.runs import Dependence

_Array = NDArray[np.float64]

TAU_GRID = np.geomspace(1e-3, 1e3, 121)
"""Deviations between runs at which the likelihood is computed, in units of that which doubles a run's variance."""


@dataclass(frozen=True)
class RunOffsets:
    """What free offsets of the runs would add to a fit's log-likelihood.

    Attributes
    ----------
    free_nats
        With an offset of its own for each run.
    integrated_nats
        With normal offsets of the best deviation, integrated out; at least 0.
    runs
        How many runs.
    """

    free_nats: float
    integrated_nats: float
    runs: int

    @classmethod
    def of(cls, fit: JointFit, unit: NDArray[np.intp], scale: float) -> "RunOffsets":
        """From the slopes by the offset; `scale` readings stand behind each that was fitted."""
        slope = fit.here.by[:, 0]
        counts = np.bincount(unit).astype(float)
        sums, squares = sums_by(unit, np.column_stack([slope, slope**2])).T
        some = counts > 1.0
        # About the run's mean: an offset of the run itself is no information.
        information = scale * np.maximum(squares - sums**2 / np.maximum(counts, 1.0), 1e-12)[some]
        sums = scale * sums[some]
        tau2 = TAU_GRID[:, None] ** 2 / np.median(information) if information.size else np.ones((1, 1))
        gained = tau2 * sums**2 / (1.0 + tau2 * information) - np.log1p(tau2 * information)
        best = 0.5 * float(gained.sum(axis=1).max(initial=0.0))
        return cls(0.5 * float((sums**2 / information).sum()), best, int(some.sum()))


def evidence_nats(
    smaller: JointFit, larger: JointFit, unit: NDArray[np.intp] | None, scale: float, left: Dependence | None = None
) -> float:
    """Gain of the larger fit over the smaller one [nat].

    Parameters
    ----------
    smaller, larger
        Fits of the same readings.
    unit
        Run of each reading; None: readings are independent, and the gain is that of the log-likelihood.
    scale
        Readings for each of those that were fitted.
    left
        Dependence inside runs that the larger fit leaves: the gain counts by as many independent readings.
    """
    plain = (larger.log_likelihood - smaller.log_likelihood) * scale
    if unit is None:
        return plain
    before, after = RunOffsets.of(smaller, unit, scale), RunOffsets.of(larger, unit, scale)
    gained = plain + after.integrated_nats - before.integrated_nats
    inside = float(np.clip(plain + after.free_nats - before.free_nats, 0.0, max(gained, 0.0)))
    if gained > 0.0:
        gained = inside + _between(gained - inside, after.runs)
    if left is not None and left.lag_z > rules.INDEPENDENT_LAG_Z:
        gained *= (1.0 - left.lag_correlation) / (1.0 + left.lag_correlation)
    return gained


def _between(nats: float, runs: int) -> float:
    """A gain between runs as that of one number whose error is known from so many runs.

    With t of runs - 2 degrees of freedom the likelihood ratio is ``runs / 2 log(1 + t^2 / (runs - 2))``.
    """
    freedom = runs - 2
    if freedom < 1 or nats <= 0.0:
        return 0.0
    t = float(np.sqrt(freedom * np.expm1(min(2.0 * nats / runs, 500.0))))
    log_p = float(student.logsf(t, freedom))
    return 0.5 * float(norm.isf(np.exp(max(log_p, -700.0)))) ** 2
