"""Shares of cases with their intervals."""

import math


def wilson(count: int, of: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a share.

    Examples
    --------
    >>> [round(edge, 3) for edge in wilson(9, 10)]
    [0.596, 0.982]
    """
    if of == 0:
        return 0.0, 1.0
    z = 1.959964
    share = count / of
    middle = (share + z * z / (2 * of)) / (1 + z * z / of)
    half = z / (1 + z * z / of) * math.sqrt(share * (1 - share) / of + z * z / (4 * of * of))
    return max(middle - half, 0.0), min(middle + half, 1.0)


def share_of(count: int, of: int) -> str:
    """A share with its interval; empty of nothing."""
    if not of:
        return ""
    low, high = wilson(count, of)
    return f"{count / of:.2f} ({low:.2f} to {high:.2f})"
