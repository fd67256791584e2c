"""How much one joint fit gains over another, where readings of a run may share an offset.

It is counted in nats, from two fits of the same readings. Where runs differ by more than the model says, each run has
an offset that is integrated out. With the slopes s by an offset as normal numbers, W their sum of squares about the
runs' means m_u, n_u their counts, N their number and rho the variance between runs over that within, a fit's
log-likelihood grows by the largest over rho of ``N log((W + sum n_u m_u^2) / (W + sum n_u m_u^2 / (1 + n_u rho))) / 2 -
sum log(1 + n_u rho) / 2``, the likelihood ratio of the one-way normal model (Searle, Casella & McCulloch 1992, Variance
Components). What is evident inside runs counts as it is, whatever the number of runs; what is evident only between runs
counts by their mean errors, and by Student's t of as many runs. So an effect is judged at the level at which it varies:
that of the shift by which the two fits differ.

The normal model can put down to offsets what an effect explains as well, above all where blocks of one run stand in for
runs. So a gain counts for at least what its own scatter over whole runs says: the plain gain over the variance of its
sums by run, relative to that of as many independent readings, again by Student's t, of as many runs as hold it.

A component or a fault of the code changes each reading with its share, whatever happened to the one before. Then the
slopes of the readings' log probabilities by that share are independent about 0, where the share is fitted and whatever
its contexts. Where an object stands in the beam for a while, or a few values come again and again, slopes of one sign
are next to each other: their sums over blocks of neighbours scatter by more than their own squares, and the candidate's
gain counts by that ratio less (the variance of a sum of clusters; Liang & Zeger 1986, Biometrika 73, 13).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtri, stdtr

from msp_lab.gap import rules
from msp_lab.gap.refit import JointFit
from msp_lab.gap.runs import places_in, share_between
from msp_range.arrays import Array, Flags, Indices, numbered
from msp_range.numbers import limited

RATIO_GRID = np.geomspace(1e-6, 1e4, 101)
"""Variances between runs at which the likelihood is computed, over the variance within them."""


@dataclass(frozen=True)
class Offsets:
    """Normal offsets of the runs, of the best deviation."""

    nats: float
    """What they add to the log-likelihood if they are integrated out, at least 0 [nat]."""
    slope_removed: Array
    """Mean slope of each run with readings, as far as an offset accounts for it, (runs,); 0 for the others."""
    variance_cm2: float = 0.0
    """Their variance."""


def offsets_of(fit: JointFit, unit: Indices) -> Offsets:
    """Normal offsets of the runs that a fit lacks."""
    slope = fit.offset_slope
    counts = np.bincount(unit)
    mean = np.bincount(unit, slope) / np.maximum(counts, 1.0)
    between = counts * mean**2
    within = float((slope**2).sum() - between.sum())
    if within <= 0.0:
        return Offsets(0.0, np.zeros(counts.size))
    shrunk = 1.0 + RATIO_GRID[:, None] * counts
    spread = within + (between / shrunk).sum(axis=1)
    gained = slope.size * np.log((within + between.sum()) / spread) - np.log(shrunk).sum(axis=1)
    best = int(gained.argmax())
    if gained[best] <= 0.0:
        return Offsets(0.0, np.zeros(counts.size))
    # A slope is the residual over the fit's variance, in which the offsets are.
    variance_cm2 = float(RATIO_GRID[best]) * within * slope.size / (within + between.sum()) ** 2
    return Offsets(0.5 * float(gained[best]), mean * (1.0 - 1.0 / shrunk[best]), variance_cm2)


def _log_p_beside_offsets(fit: JointFit, unit: Indices, offsets: Offsets) -> Array:
    """Log-likelihood of each reading with its run's offset taken off, by a quadratic in that offset, (n,)."""
    slope, removed = fit.offset_slope, offsets.slope_removed[unit]
    log_p: Array = fit.here.log_p + removed * (slope - 0.5 * removed) / max(float((slope**2).mean()), 1e-12)
    return log_p


def between_share(smaller: JointFit, larger: JointFit, unit: Indices) -> float:
    """Share of a gain that is made by moving whole runs: that of the hits' shift, as far as this is what gains."""
    shift_cm = larger.here.rows.centre_cm - smaller.here.rows.centre_cm
    # Of a hit as it is expected after the one before.
    slope = larger.here.own_centre
    of_shift = float((slope * shift_cm + 0.5 * float((slope**2).mean()) * shift_cm**2).sum())
    plain = max(larger.log_likelihood - smaller.log_likelihood, 1e-9)
    return share_between(shift_cm, unit) * limited(of_shift / plain, 0.0, 1.0)


def _means_nats(smaller: JointFit, larger: JointFit, unit: Indices, variance_cm2: float) -> float:
    """What the runs' mean errors gain, as normal numbers with offsets of this variance: half their number times the log
    of the ratio of their sums of squares.

    The likelihood of the readings gains more: offsets are tails, outliers and correlation to a fit that lacks them.
    """
    counts = np.bincount(unit)
    information = np.maximum(counts * float((larger.offset_slope**2).mean()), 1e-12)
    weight = np.where(counts > 0, 1.0 / (variance_cm2 + 1.0 / information), 0.0)
    squares = []
    for slope in (smaller.offset_slope, larger.offset_slope):
        mean_cm = np.bincount(unit, slope) / np.maximum(counts * float((slope**2).mean()), 1e-12)
        squares.append(float(weight @ (mean_cm - np.average(mean_cm, weights=weight)) ** 2))
    return 0.5 * float((counts > 0).sum() * np.log(max(squares[0], 1e-12) / max(squares[1], 1e-12)))


def wander_inflation(smaller: JointFit, larger: JointFit, unit: Indices) -> float:
    """By how much a slow wander inside runs makes the gain scatter more than that of independent readings, at least 1.

    Where readings wander, the gain counts by the scatter of its own sums over blocks of consecutive readings.
    """
    return _scatter(larger.here.log_p - smaller.here.log_p, blocks_of(unit))[0] if wanders(larger, unit) else 1.0


def wanders(fit: JointFit, unit: Indices) -> bool:
    """Whether readings wander slowly inside runs.

    Each run is cut into `WANDER_BLOCKS` blocks of consecutive readings, whose sums of the slopes then scatter about
    their run's mean beyond random variation.
    """
    blocks = blocks_of(unit)
    slope = fit.offset_slope
    counts = np.maximum(np.bincount(unit), 1)
    centred = slope - (np.bincount(unit, slope) / counts)[unit]
    size = np.bincount(blocks)
    sums = np.bincount(blocks, centred)[size > 0]
    freedom = sums.size - np.unique(unit).size
    if freedom < 1:
        return False
    variance = float((centred**2).mean()) or 1.0
    scatter = float((sums**2 / (size[size > 0] * variance)).sum())
    return float(chdtrc(freedom, scatter)) <= rules.WANDER_P


def _scatter(gain: Array, unit: Indices) -> tuple[float, float]:
    """Variance of a gain's sums over units against that of as many independent readings, at least 1; and from how many
    units that is known: a few that the gain is about say little of it, however many others there are (Satterthwaite
    1946, Biometrics Bulletin 2, 110)."""
    gain = gain - gain.mean()
    squares = np.bincount(unit, gain**2)
    whole = float(squares.sum())
    if not whole > 0.0:
        return 1.0, 0.0
    return max(float((np.bincount(unit, gain) ** 2).sum()) / whole, 1.0), whole**2 / float((squares**2).sum())


def _by_scatter(nats: float, runs: float) -> float:
    """A gain whose error is known from so many runs, as that of one whose error is known."""
    if runs < 3 or nats <= 0.0:
        return 0.0
    p_value = max(float(stdtr(runs - 2, -np.sqrt(2.0 * nats))), 1e-304)
    return 0.5 * float(ndtri(p_value)) ** 2


def blocks_of(unit: Indices, parts: int = rules.WANDER_BLOCKS) -> Indices:
    """Number of each reading's block: its run's readings in their order, in so many parts."""
    return unit * parts + places_in(unit) * parts // np.bincount(unit)[unit]


def evidence_nats(smaller: JointFit, larger: JointFit, unit: Indices | None, of_blocks: bool = False) -> float:
    """Gain of the larger fit over the smaller one [nat].

    Parameters
    ----------
    smaller, larger
        Fits of the same readings.
    unit
        Run of each reading; None: readings are independent, and the gain is that of the log-likelihood.
    of_blocks
        Whether blocks of one run stand in for runs: what it has passed once, as a box, is in a few of them.
    """
    plain = larger.log_likelihood - smaller.log_likelihood
    if unit is None:
        return plain
    runs = np.unique(unit).size
    of_larger = offsets_of(larger, unit)
    gained = plain + of_larger.nats - offsets_of(smaller, unit).nats
    if gained > 0.0:
        inside = min((1.0 - between_share(smaller, larger, unit)) * plain, gained)
        between = min(gained - inside, _means_nats(smaller, larger, unit, of_larger.variance_cm2))
        gained = inside / wander_inflation(smaller, larger, unit) + _between(between, runs)
    inflation, known_from = _scatter(larger.here.log_p - smaller.here.log_p, unit)
    return max(gained, _by_scatter(plain / inflation, runs if of_blocks else known_from))


def lead_nats(one: JointFit, other: JointFit, unit: Indices | None) -> float:
    """By how much one of two fits with as many numbers is ahead of the other [nat]; negative if it is behind.

    Where the run is the unit, the runs' offsets are integrated out of both, and the rest counts by the scatter of the
    difference over runs (Vuong 1989, Econometrica 57, 307). An offset times what two names differ by on the average of
    its run is most of that scatter: a thermometer and a scale on days from cold to warm, each with an offset.
    """
    plain = one.log_likelihood - other.log_likelihood
    if unit is None:
        return plain
    of_one, of_other = (offsets_of(fit, unit) for fit in (one, other))
    nats = plain + of_one.nats - of_other.nats
    gain = _log_p_beside_offsets(one, unit, of_one) - _log_p_beside_offsets(other, unit, of_other)
    inflation, known_from = _scatter(gain, unit)
    return float(np.copysign(_by_scatter(abs(nats) / inflation, known_from), nats))


def of_one_run(nats: float, fit: JointFit, unit: Indices, run: Flags) -> float:
    """A gain by an offset of one run, by what the other runs scatter next to it [nat].

    Of many runs one is always the farthest off, and slow noise that the model misses moves the means of all. Their
    variance, relative to what the model says, is averaged with the model's own as `rules.RUN_SCATTER_FREEDOM` further
    runs, and the gain counts by Student's t (a moderated t; Smyth 2004, Stat. Appl. Genet. Mol. Biol. 3). Where they
    scatter more than the model says, that says nothing of them, and they count alone.

    Parameters
    ----------
    nats
        Gain of readings, as the model has them.
    fit
        With the offset.
    unit
        Run of each reading.
    run
        Readings that are of the run with the offset.
    """
    slope, others = fit.offset_slope, np.unique(unit[~run])
    sums, squares = (np.bincount(unit, values)[others] for values in (slope, slope**2))
    own, freedom = rules.RUN_SCATTER_FREEDOM, others.size - 1
    if nats <= 0.0 or freedom < 1:
        return min(nats, 0.0)
    scatter = float((sums**2 / np.maximum(squares, 1e-300)).sum())
    if chdtrc(freedom, scatter) <= rules.WANDER_P:
        own = 0.0
    return _by_scatter(nats / max((own + scatter) / (own + freedom), 1.0), own + freedom + 2.0)


def _between(nats: float, runs: int) -> float:
    """A gain between runs as that of one number whose error is known from so many runs.

    With t of runs - 2 degrees of freedom the likelihood ratio is ``runs / 2 log(1 + t^2 / (runs - 2))``.
    """
    freedom = runs - 2
    if freedom < 1 or nats <= 0.0:
        return 0.0
    return _by_scatter(0.5 * freedom * float(np.expm1(min(2.0 * nats / runs, 500.0))), runs)


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
    return max([1.0, *(_ratio(slope, cluster) for cluster in clusters)])


def _blocks(run: Indices) -> Iterator[Indices]:
    """Blocks of 2, 4, 8 ... neighbours of a run, as long as there are enough of them."""
    counts, place, length = np.bincount(run), places_in(run), 2
    while (-(-counts // length)).sum() >= rules.RUN_BLOCKS and length <= counts.max():
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
    return ratio if ratio > 1.0 + rules.SURE_Z * np.sqrt(2.0 / of_equal_size) else 1.0
