"""The normal distribution's cumulative probability and its inverse, for arrays.

Both use the standard library, element by element: importing scipy.special takes 0.15 s, a third of the bridge's start,
and the filter in flight needs only 24 values at a time.
"""

import math
from statistics import NormalDist

import numpy as np

from msp_range.arrays import Array

_STANDARD = NormalDist()


def normal_cdf(z: Array) -> Array:
    """Phi(z) = erfc(-z / sqrt 2) / 2, exact to rounding in both tails.

    Parameters
    ----------
    z : ndarray, any shape
        Standard normal deviate.

    Returns
    -------
    ndarray, same shape
        Probability of less than ``z``.

    Examples
    --------
    >>> print(normal_cdf(np.array([-1.959964, 0.0])).round(6))
    [0.025 0.5  ]
    """
    doubled = map(math.erfc, (z * -math.sqrt(0.5)).ravel().tolist())
    return 0.5 * np.fromiter(doubled, np.float64, z.size).reshape(z.shape)


def normal_quantile(probability: Array) -> Array:
    """Quantile of the standard normal distribution for a probability above 0 and below 1 (Wichura's AS 241)."""
    deviates = map(_STANDARD.inv_cdf, probability.ravel().tolist())
    return np.fromiter(deviates, np.float64, probability.size).reshape(probability.shape)
