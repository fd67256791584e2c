"""Offsets between runs: how far runs differ by more than the model says, and whether splits of the runs agree.

A fit of all readings shows the effect `run_offsets`, which no single reading shows.
"""

import numpy as np
from scipy.optimize import minimize
from scipy.special import chdtrc

from msp_lab.gap import rules
from msp_lab.gap.evidence import blocks_of, wanders
from msp_lab.gap.findings import Alternative, FittedValue, FoundEffect, RunScatter
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.problem import Problem
from msp_lab.gap.refit import JointFit
from msp_lab.gap.runs import Splits
from msp_range.arrays import Array, Indices
from msp_range.reading_model.rows import Base
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import REFERENCE
from msp_sim.model.model import Term


def run_offset_cm(problem: Problem, fit: JointFit) -> float:
    """Standard deviation of offsets between runs that the model lacks [cm]; 0 where there is none.

    A base that was fitted to readings of many runs has their offsets in its spread: then the whole spread is as it
    says. Where they are missing, the spread within runs is as it says, and the whole is larger.
    """
    if problem.runs < rules.MIN_RUNS or REFERENCE in problem.contexts:
        # The other sensors are the reference, and differ from this one by the ground below in each run.
        return 0.0
    left = problem.dependence(fit)
    if left.p_between > rules.RUN_OFFSETS_P:
        return 0.0
    if p_beyond_wander(fit.offset_slope, problem.unit) > rules.WANDER_P:
        return 0.0
    share = min(left.between_run_share, rules.MAX_BETWEEN_SHARE)
    rows = problem.readings.at(fit.base, fit.effects)
    if rows.run_offsets:
        # The offsets that the model already has scatter from one set of runs to the next.
        whole_cm2, known_cm2 = float(np.median(rows.sigma_cm**2)), float(np.median(rows.between_cm2))
        of_mean_cm2 = whole_cm2 * problem.runs / len(problem.readings)
        times = (share * whole_cm2 + of_mean_cm2) / (known_cm2 + of_mean_cm2)
        if float(chdtrc(problem.runs - 1, times * (problem.runs - 1))) > rules.RUN_OFFSETS_P:
            return 0.0
        return float(np.sqrt(share * whole_cm2 - known_cm2))
    whole = fit.base.log_sigma
    within = whole + 0.5 * float(np.log1p(-share))
    if abs(whole) < abs(within):
        return 0.0
    sigma_cm = float(np.median(problem.readings.rows.sigma_cm)) * float(np.exp(whole))
    return sigma_cm * float(np.sqrt(share))


def run_scatter(problem: Problem, fit: JointFit) -> RunScatter | None:
    """How far runs differ or readings wander inside them, next to the effects of a fit; None where they do not.

    Offsets between runs are named if splits of the runs agree on them: this is what is known where they do not.
    Where blocks stand in for runs, what they differ by is a wander.
    """
    wander = wanders(fit, problem.unit)
    if not wander and problem.dependence(fit).p_between > rules.DEPENDENT_P:
        return None
    inside_runs = wander and p_beyond_wander(fit.offset_slope, problem.unit) > rules.WANDER_P
    unit = blocks_of(problem.unit) if inside_runs else problem.unit
    slope = fit.offset_slope - fit.offset_slope.mean()
    # Of a unit with information I and variance d of its offset, a sum of slopes has the variance I + I^2 d.
    sums, information = np.bincount(unit, slope), np.bincount(unit) * float(np.mean(slope**2))
    variance = float((sums**2 - information).sum() / (information**2).sum())
    return RunScatter(float(np.sqrt(max(variance, 0.0))), inside_runs or problem.of_blocks)


def p_beyond_wander(slope: Array, unit: Indices) -> float:
    """p-value of offsets between runs next to a wander inside them, by the likelihood of the means of blocks.

    A wander moves the means of runs too, the more the slower it is: block means ``m_i`` of a run have
    ``cov(m_i, m_j) = d + w r^|i - j| + [i = j] a / n_i``, with d of the offsets, and w and r of a wander that forgets
    itself in a run's length or sooner (`rules.RUN_BLOCKS`); slower ones are offsets. The likelihood ratio of d > 0
    against d = 0, at a bound, is zero or chi-squared, each half of the time (Self & Liang 1987, JASA 82, 605).
    """
    counts = np.bincount(unit)
    long = np.flatnonzero(counts >= rules.RUN_BLOCKS)
    if long.size < 2:
        return 1.0
    blocks = blocks_of(unit, rules.RUN_BLOCKS)
    size = np.bincount(blocks, minlength=counts.size * rules.RUN_BLOCKS).reshape(-1, rules.RUN_BLOCKS)[long]
    sums = np.bincount(blocks, slope - slope.mean(), counts.size * rules.RUN_BLOCKS)
    mean = sums.reshape(-1, rules.RUN_BLOCKS)[long] / size
    apart = np.abs(np.subtract.outer(np.arange(rules.RUN_BLOCKS), np.arange(rules.RUN_BLOCKS)))
    single, whole = float(np.var(slope)), float(np.var(mean))

    def loss(numbers: Array) -> float:
        own, wander, forgets = single * np.exp(numbers[0]), whole * np.exp(numbers[1]), np.exp(-np.exp(numbers[2]))
        offset = whole * np.exp(numbers[3]) if numbers.size > 3 else 0.0
        covariance = offset + wander * forgets**apart + np.eye(rules.RUN_BLOCKS) * (own / size)[:, None, :]
        rest = np.linalg.solve(covariance, mean[:, :, None])[:, :, 0]
        return 0.5 * float(np.linalg.slogdet(covariance)[1].sum() + (mean * rest).sum())

    # In blocks; the fastest wander is over before the next block.
    slowest, fastest = -np.log(rules.RUN_BLOCKS), 1.5
    bounds = [(-7.0, 7.0), (-12.0, 5.0), (slowest, fastest), (-12.0, 5.0)]
    starts = [np.array([0.0, -0.7, forgets, -0.7]) for forgets in (slowest, 0.0)]
    without = min(
        (minimize(loss, start[:3], method="L-BFGS-B", bounds=bounds[:3]) for start in starts), key=lambda fit: fit.fun
    )
    starts.append(np.append(without.x, -5.0))
    with_offsets = min(minimize(loss, start, method="L-BFGS-B", bounds=bounds).fun for start in starts)
    return 0.5 * float(chdtrc(1, 2.0 * max(without.fun - with_offsets, 0.0)))


def validated_run_offsets(
    deviation_cm: float,
    fit: JointFit,
    readings: Prepared,
    unit: Indices,
    splits: Splits,
    alternatives: tuple[Alternative, ...],
) -> tuple[FoundEffect, Term] | None:
    """The effect, if nearly all splits of the runs agree; a run's offset is integrated out.

    Parameters
    ----------
    deviation_cm
        Standard deviation of the offsets.
    fit, readings, unit
        Fit of all readings, and their runs.
    splits
        Of the runs.
    alternatives
        Columns that explain nearly as well what runs differ by.
    """
    runs = splits.names.size
    slope = fit.offset_slope - fit.offset_slope.mean()
    sums, information = np.bincount(unit, slope, runs), np.bincount(unit, slope**2, runs)
    rows = readings.at(fit.base, fit.effects)
    known_cm2 = float(np.median(rows.between_cm2)) if rows.run_offsets else 0.0
    within = 1.0 - known_cm2 / float(np.median(rows.sigma_cm**2))
    mean_cm = sums / np.maximum(information, 1e-12)

    grid = deviation_cm * np.geomspace(0.1, 10.0, 200)
    # A run's mean is off by its offset, by that of the model, and by random variation.
    before = known_cm2 + within / np.maximum(information, 1e-12)
    after = before + grid[:, None] ** 2
    gains = -0.5 * np.log(after / before) + 0.5 * mean_cm**2 * (1.0 / before - 1.0 / after)
    crossed = _crossed(gains, splits)
    agree = float(np.mean(crossed.sum(axis=1) >= rules.VALIDATED_NATS))
    if agree < rules.SPLITS_AGREE:
        return None
    of_runs = crossed.mean(axis=0)
    se = float(np.std(of_runs, ddof=1) * np.sqrt(runs))
    height = gains.sum(axis=1)
    # 95 % interval of a likelihood: half of chi-squared's 3.84.
    inside = grid[height > height.max() - 1.92]
    effect = CATALOGUE["run_offsets"]
    low, high = min(float(inside[0]), deviation_cm), max(float(inside[-1]), deviation_cm)
    total = float(of_runs.sum())
    found = FoundEffect(
        effect.name,
        "indistinguishable" if alternatives else "named",
        {"deviation_cm": FittedValue(deviation_cm, low, high, "cm")},
        total / len(readings),
        total / se if se > 0.0 else None,
        alternatives,
        "; ".join(f"to tell {effect.name} from {one.name}: more runs that differ in it alone" for one in alternatives)
        or effect.experiment,
        splits_agree=agree,
    )
    return found, Term(effect, {"deviation_cm": deviation_cm})


def _crossed(gains: Array, splits: Splits) -> Array:
    """What each run gains by the deviation of the grid that the runs of the other parts have, (splits, runs)."""
    crossed = np.empty((len(splits), gains.shape[1]))
    for k, part in enumerate(splits.part):
        for left_out in (part == number for number in range(int(part.max()) + 1)):
            crossed[k, left_out] = gains[gains[:, ~left_out].sum(axis=1).argmax(), left_out]
    return crossed


def with_run_offsets(fit: JointFit, offsets: Term, prepared: Prepared) -> tuple[Base, tuple[Term, ...]]:
    """Base and effects of a fit with offsets between runs, whose variance is taken from the spread within them."""
    sigma_cm = float(np.median(prepared.rows.sigma_cm)) * float(np.exp(fit.base.log_sigma))
    share = min((offsets.values["deviation_cm"] / sigma_cm) ** 2, rules.MAX_BETWEEN_SHARE)
    base = fit.base._replace(log_sigma=fit.base.log_sigma + 0.5 * float(np.log1p(-share)))
    return base, (*fit.effects, offsets)
