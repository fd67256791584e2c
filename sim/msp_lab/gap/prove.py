"""Whether what was chosen and fitted scores better on runs that took no part in it.

Log scores of two models on the confirming readings enter; the gain a reading, its standard error by whole runs and the
chance of as much leave.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t as student

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Gain:
    """A gain in log score.

    Attributes
    ----------
    nats_per_reading, se
        Gain, and its standard error over runs.
    p_value
        Of no gain, one-sided.
    runs, readings
        How many.
    """

    nats_per_reading: float
    se: float
    p_value: float
    runs: int
    readings: int

    @property
    def nats(self) -> float:
        """In total."""
        return self.nats_per_reading * self.readings

    @property
    def z(self) -> float:
        """Gain over its standard error."""
        return self.nats_per_reading / self.se if self.se > 0.0 else 0.0


def gain(after: _Array, before: _Array, unit: NDArray[np.intp]) -> Gain:
    """Gain of one log score over another, with errors of whole runs.

    Parameters
    ----------
    after, before
        Log probability of each confirming reading, (n,).
    unit
        Its run, numbered.

    Examples
    --------
    >>> better = gain(np.full(4, -1.0), np.full(4, -1.5), np.array([0, 0, 1, 1]))
    >>> print(better.nats_per_reading, better.runs)
    0.5 2
    """
    difference = after - before
    n = difference.size
    present = np.unique(unit)
    runs = int(present.size)
    if n == 0:
        return Gain(0.0, 0.0, 1.0, 0, 0)
    mean = float(difference.mean())
    sums = np.bincount(unit, difference - mean)[present]
    se = float(np.sqrt((sums**2).sum() * runs / max(runs - 1, 1)) / n)
    p_value = float(student.sf(mean / se, max(runs - 1, 1))) if se > 0.0 else (0.0 if mean > 0.0 else 1.0)
    return Gain(mean, se, p_value, runs, n)
