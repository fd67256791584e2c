"""How far the readings that a candidate explains come in clumps: fewer pieces of evidence than readings.

A component or a fault of the code changes each reading with its share, whatever happened to the one before. Then the
slopes of the readings' log probabilities by that share are independent about 0, where the share is fitted and whatever
its contexts. Where an object stands in the beam for a while, or a few values come again and again, slopes of one sign
are next to each other: their sums over blocks of neighbours scatter by more than their own squares, and the candidate's
gain counts by that ratio less (the variance of a sum of clusters; Liang & Zeger 1986, Biometrika 73, 13).
"""

from collections.abc import Iterator

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.runs import places_in
from msp_range.arrays import Array, Indices, numbered


def clumping(slope: Array, run: Indices, alike: Array | None = None) -> float:
    """By how much sums of the slopes over clusters scatter more than those of independent readings, at least 1.

    Parameters
    ----------
    slope
        Of each reading's log probability by the share of a candidate, where it is fitted, (n,).
    run
        Number of each reading's run, (n,); readings of a run are in their order.
    alike
        Readings of one value are one cluster, (n,): of a fault what it makes of each reading. It moves probability
        within these alone, so that their slopes have a mean of 0. None: clusters in time only.
    """
    clusters = list(_blocks(run))
    if alike is not None:
        clusters.append(numbered(alike))
    return max([1.0, *(_ratio(slope, each) for each in clusters)])


def _blocks(run: Indices) -> Iterator[Indices]:
    """Blocks of 2, 4, 8 ... neighbours of a run, as long as there are enough of them."""
    counts, place, length = np.bincount(run), places_in(run), 2
    while (-(-counts // length)).sum() >= rules.CLUMP_BLOCKS and length <= counts.max():
        of_run = -(-int(counts.max()) // length)
        yield run * of_run + place // length
        length *= 2


def _ratio(slope: Array, cluster: Indices) -> float:
    """Squares of the sums over their expectation, or 1 where random variation shows as much."""
    squares = np.bincount(cluster, slope**2)
    whole = float(squares.sum())
    if not whole > 0.0:
        return 1.0
    ratio = float((np.bincount(cluster, slope) ** 2).sum()) / whole
    # Of few clusters that have nearly all of it the ratio is known badly.
    of_equal_size = whole**2 / float((squares**2).sum())
    return ratio if ratio > 1.0 + rules.CLUMP_Z * np.sqrt(2.0 / of_equal_size) else 1.0
