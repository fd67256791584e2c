"""95 % intervals that need no assumption on a distribution: of shares and of quantiles."""

import math
from collections.abc import Sequence

from scipy.special import ndtri

CONFIDENCE = 0.95
"""Level of all intervals."""
Z = float(ndtri(0.5 + CONFIDENCE / 2))
LIKELIHOOD_DROP = Z**2 / 2
"""Drop of the log-likelihood from its maximum at the ends of an interval: 1.92, half of chi squared's quantile."""


def wilson(count: float, of: float) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share, 0 to 1 where nothing was counted."""
    if of <= 0.0:
        return 0.0, 1.0
    p = count / of
    middle = (p + Z**2 / (2 * of)) / (1 + Z**2 / of)
    half = Z / (1 + Z**2 / of) * math.sqrt(p * (1 - p) / of + Z**2 / (4 * of**2))
    # Rounding may put an end on the wrong side of the share itself.
    return max(min(middle - half, p), 0.0), min(max(middle + half, p), 1.0)


def quantile(values: Sequence[float], share: float) -> tuple[float, float | None, float | None]:
    """A quantile with the 95 % interval between two of the values themselves (order statistics).

    With n independent values, the number below the true quantile is binomial with n and ``share``; the interval's ends
    are the values whose ranks are its 2.5 and 97.5 % points (David and Nagaraja, Order Statistics, 7.1).

    Parameters
    ----------
    values
        At least one.
    share
        Share of the distribution below the quantile, between 0 and 1.

    Returns
    -------
    tuple of float, float or None, float or None
        The smallest value with at least ``share`` of the values up to it, and the ends of the interval; None where the
        values are too few for an end.

    Examples
    --------
    >>> quantile(range(1, 101), 0.5)
    (50, 40.0, 61.0)
    >>> quantile(range(1, 21), 0.95)
    (19, 17.0, None)
    """
    # It takes half a second, which most who ask for an interval here do not need.
    from scipy.stats import quantile_test

    middle = sorted(values)[max(math.ceil(len(values) * share - 1e-9), 1) - 1]
    ends = quantile_test(values, p=share).confidence_interval(CONFIDENCE)
    low, high = (None if math.isnan(end) else float(end) for end in ends)
    return middle, low, high
