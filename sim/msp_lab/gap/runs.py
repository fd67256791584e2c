"""The split into training and held-out runs, and how far readings of a run depend on each other.

Contexts enter, a split by whole runs leaves, drawn before anything is looked at. Scores enter, a measure of dependence
leaves: with any dependence the unit of evidence is the run and not the reading.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from msp_lab.gap import rules
from msp_sim.model.history import History

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Split:
    """Training readings, on which effects are selected and fitted, and held-out readings, which validate them.

    Attributes
    ----------
    training, held_out
        Masks, (n,).
    runs
        Name of each reading's run, or of its block where runs are few.
    training_runs, held_out_runs
        Names.
    messages
        What a reader has to know about it.
    of_blocks
        Blocks of readings stand in for runs.
    """

    training: NDArray[np.bool_]
    held_out: NDArray[np.bool_]
    runs: NDArray[np.str_]
    training_runs: tuple[str, ...]
    held_out_runs: tuple[str, ...]
    messages: tuple[str, ...] = ()
    of_blocks: bool = False

    def take(self, rows: NDArray[np.bool_]) -> "Split":
        """The split of some of the readings."""
        return replace(self, training=self.training[rows], held_out=self.held_out[rows], runs=self.runs[rows])


def split(contexts: Mapping[str, Any], reading_cm: _Array, rng: np.random.Generator, run_column: str = "run") -> Split:
    """Split whole runs into two halves of about as many readings.

    Parameters
    ----------
    contexts
        Columns; without runs, or with too few, consecutive readings are cut into blocks of equal length.
    reading_cm
        Readings, (n,).
    rng
        Random generator.
    run_column
        Which column names the runs.
    """
    n = reading_cm.size
    messages: list[str] = []
    runs = np.asarray(contexts[run_column]).astype(str) if run_column in contexts else np.full(n, "")
    names, unit = np.unique(runs, return_inverse=True)
    if names.size < rules.MIN_RUNS:
        runs = _blocks(contexts, unit, names, n)
        messages.append(
            f"There {'is only 1 run' if names.size == 1 else f'are only {names.size} runs'}: blocks of consecutive "
            "readings are split instead, so what is constant within a run cannot be judged. Record four runs or more."
        )
        names, unit = np.unique(runs, return_inverse=True)
    counts = np.bincount(unit, minlength=names.size)
    training = np.zeros(names.size, dtype=bool)
    # Of two runs of about the same length one is for training and one held out, so that both halves are alike.
    order = np.lexsort((rng.random(names.size), -counts))
    for pair in range(0, names.size, 2):
        two = order[pair : pair + 2]
        if two.size == 2:
            training[two[int(rng.integers(2))]] = True
        else:
            training[two[0]] = counts[training].sum() * 2 <= n
    mask = training[unit]
    return Split(
        mask,
        ~mask,
        runs,
        tuple(str(name) for name in names[training]),
        tuple(str(name) for name in names[~training]),
        tuple(messages),
        bool(messages),
    )


def _blocks(contexts: Mapping[str, Any], unit: NDArray[np.intp], names: NDArray[np.str_], n: int) -> NDArray[np.str_]:
    order = np.lexsort((np.asarray(contexts["time_s"], dtype=float) if "time_s" in contexts else np.arange(n), unit))
    block = np.empty(n, dtype=np.int64)
    block[order] = np.arange(n) * min(rules.SPLIT_BLOCKS, max(n // 2, 1)) // max(n, 1)
    return np.array([f"{names[u] or 'all'}#{b:02d}" for u, b in zip(unit.tolist(), block.tolist(), strict=True)])


def numbered(runs: NDArray[np.str_]) -> NDArray[np.intp]:
    """Runs as numbers from 0."""
    return np.unique(runs, return_inverse=True)[1].astype(np.intp)


@dataclass(frozen=True)
class Dependence:
    """How far readings of a run depend on each other.

    Attributes
    ----------
    lag_correlation
        Of the residual with the one before it, inside runs, about each run's mean.
    between_run_share
        Variance between runs beyond what independent readings show, as a share of the residuals' variance.
    effective_readings
        How many independent readings would say as much about a constant.
    p_between
        p-value of the variance between runs.
    lag_z
        The lag correlation in its standard errors.
    """

    lag_correlation: float
    between_run_share: float
    effective_readings: float
    p_between: float
    lag_z: float

    @property
    def dependent(self) -> bool:
        """Readings depend on each other beyond random variation."""
        return self.p_between < rules.DEPENDENT_P or self.lag_z > rules.DEPENDENT_LAG_Z

    @property
    def independent(self) -> bool:
        """Nothing speaks against independent readings."""
        return self.p_between > rules.INDEPENDENT_P and self.lag_z < rules.INDEPENDENT_LAG_Z


def dependence(residual: _Array, unit: NDArray[np.intp], time_s: _Array | None = None) -> Dependence:
    """Measure dependence inside runs.

    Parameters
    ----------
    residual
        One number per reading with mean 0 and about equal variance: the score of the bias.
    unit
        Run of each reading, numbered.
    time_s
        Order inside runs; as they come where it is not known.
    """
    n = residual.size
    order = np.lexsort((np.arange(n) if time_s is None else time_s, unit))
    value, run = residual[order] - residual.mean(), unit[order]
    counts = np.bincount(run).astype(float)
    present = counts > 0
    variance = float(np.mean(value**2)) or 1.0
    sums = np.bincount(run, value)
    statistic = float((sums[present] ** 2 / (counts[present] * variance)).sum())
    runs = int(present.sum())
    p_between = float(chi2.sf(statistic, max(runs - 1, 1)))
    centred = value - (sums / np.maximum(counts, 1.0))[run]
    same = run[1:] == run[:-1]
    pairs = max(int(same.sum()), 1)
    lag = float((centred[1:] * centred[:-1])[same].sum() / max(float((centred**2).sum()), 1e-12) * n / pairs)
    expected = -runs / max(n, 1)
    lag_z = float((lag - expected) * np.sqrt(pairs))
    mean_square = statistic / max(runs, 1)
    share = max(mean_square - 1.0, 0.0) / max(n / max(runs, 1), 1.0)
    return Dependence(lag, share, n / max(mean_square, 1.0), p_between, lag_z)


def previous(contexts: Mapping[str, Any], reading_cm: _Array) -> _Array:
    """The reading before each, of the same sensor in the same run; NaN for the first [cm]."""
    before, _ = History.of(contexts, reading_cm.size, 0.0, 1.0).before(np.ones(reading_cm.size, dtype=bool))
    return np.where(before >= 0, reading_cm[before], np.nan)


def spacing_s(contexts: Mapping[str, Any]) -> float:
    """Median time between neighbouring readings of a sensor in a run [s]."""
    n = np.shape(contexts["true_range_cm"])[0]
    _, age_s = History.of(contexts, n, 0.0, 1.0).before(np.ones(n, dtype=bool))
    steps_s = age_s[np.isfinite(age_s) & (age_s > 0.0)]
    return float(np.median(steps_s)) if steps_s.size else 1.0
