"""Two-sample tests between a table and its simulation: a p-value leaves, and no name.

The simulation is drawn from the base model at the measured contexts, so that reading k of the one and reading k of the
other are a pair: what is exchangeable, if nothing is missing, are the two of a pair and not all readings.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.spatial.distance import cdist
from scipy.stats import ks_2samp

from evaluation.blind_peers.library import Array
from msp_sim.effects.base import WORD_COLUMNS
from msp_sim.model.model import Model

SWAPS = 199
REPLICATES = 4
"""Simulated tables next to the paired one."""
FAR = 10.0
"""Standard deviations at which an error is cut off, so that a missed echo does not outweigh all else in a distance."""
NOT_CONTEXT = frozenset({"reading_cm", "run", "time_s"})
BINS = 4


@dataclass(frozen=True)
class Compared:
    """A table and simulations of it."""

    reading_cm: Array
    true_cm: Array
    """Shape (n,)."""
    simulated_cm: Array
    """Readings of simulated tables, (1 + REPLICATES, n); the first is the one of the pairs."""
    sigma_cm: float
    """Standard deviation of a hit by the base."""
    contexts: Array
    """Columns of numbers: NaN where unknown, a word as 0 or 1; (n, k)."""
    slices: tuple[Array, ...]
    """Rows of each slice of context."""
    run: NDArray[np.intp]
    """Number of each row's run."""

    def errors(self) -> tuple[Array, Array]:
        """Measured and simulated errors in standard deviations, cut off."""
        both = (self.reading_cm, self.simulated_cm[0])
        one, other = (np.clip((reading - self.true_cm) / self.sigma_cm, -FAR, FAR)[:, None] for reading in both)
        return one, other

    def points(self) -> tuple[Array, Array]:
        """The same together with the contexts, in standard deviations of theirs."""
        contexts = self.contexts - np.nanmean(self.contexts, axis=0)
        contexts = np.nan_to_num(contexts / np.maximum(np.nanstd(contexts, axis=0), 1e-9))
        one, other = (np.column_stack([error, contexts]) for error in self.errors())
        return one, other


Detector: TypeAlias = Callable[[Compared, Generator], float]


def compare(model: Model, contexts: Mapping[str, Any], reading_cm: Array, rng: Generator) -> Compared:
    """Simulate a table at its own contexts."""
    true_cm = np.asarray(contexts["true_range_cm"], dtype=float)
    simulated_cm = np.array([model.sample(contexts, rng) for _ in range(1 + REPLICATES)])
    columns, slices = [], [np.ones(true_cm.size, dtype=bool)]
    for name, values in contexts.items():
        if name in NOT_CONTEXT:
            continue
        if name in WORD_COLUMNS:
            words = np.unique(np.asarray(values))
            columns += [(values == word).astype(float) for word in words[1:]]
            slices += [values == word for word in words] if words.size > 1 else []
            continue
        numbers = np.asarray(values, dtype=float)
        if np.isfinite(numbers).any():
            columns.append(numbers)
            inner = np.nanquantile(numbers, np.arange(1, BINS) / BINS)
            bins = np.where(np.isfinite(numbers), np.searchsorted(inner, numbers), BINS)
            slices += [bins == each for each in np.unique(bins)]
    run = np.unique(np.asarray(contexts["run"]), return_inverse=True)[1]
    sigma_cm = model.sensor.reading_model.sigma_cm
    return Compared(reading_cm, true_cm, simulated_cm, sigma_cm, np.column_stack(columns), tuple(slices), run)


def ks_by_slice(data: Compared, rng: Generator) -> float:
    """Kolmogorov and Smirnov in each slice, against all simulations; the smallest p times the number of slices."""
    measured_cm, simulated_cm = data.reading_cm - data.true_cm, data.simulated_cm - data.true_cm
    found = [ks_2samp(measured_cm[rows], simulated_cm[:, rows].ravel(), method="asymp").pvalue for rows in data.slices]
    return min(1.0, float(np.min(found)) * len(found))


def energy_distance(data: Compared, rng: Generator) -> float:
    """Energy distance of the errors alone, with pairs swapped."""
    return with_pairs_swapped(*data.errors(), rng)[1]


def pted_pairs_swapped(data: Compared, rng: Generator) -> float:
    """PTED's statistic, the energy distance of errors and contexts together, with pairs swapped.

    PTED itself permutes all readings and knows no pairs, so its statistic is worked out here.
    """
    return with_pairs_swapped(*data.points(), rng)[1]


def pted_as_it_comes(data: Compared, rng: Generator) -> float:
    """PTED with its own permutations of all readings, two-tailed, which is its default."""
    from pted import pted

    return float(pted(*data.points(), permutations=SWAPS, rng=rng))


def classifier(data: Compared, rng: Generator) -> float:
    """Gradient-boosted trees that tell measured from simulated, taught on half of the runs and scored on the others.

    The statistic is the mean difference in log odds within pairs; its null is that of pairs swapped. Halves that teach
    and score each other would count the same noise twice: they reject too often.
    """
    from sklearn.ensemble import HistGradientBoostingClassifier

    readings = (data.reading_cm, *data.simulated_cm)
    tables = [np.column_stack([reading, reading - data.true_cm, data.contexts]) for reading in readings]
    taught = data.run % 2 == 1
    labels = np.repeat([1, 0], [taught.sum(), taught.sum() * (1 + REPLICATES)])
    weights = np.where(labels == 1, 1.0 + REPLICATES, 1.0)
    trees = HistGradientBoostingClassifier(
        max_iter=100, learning_rate=0.08, max_leaf_nodes=8, random_state=int(rng.integers(2**31))
    )
    trees.fit(np.concatenate([table[taught] for table in tables]), labels, sample_weight=weights)
    one, other = (trees.decision_function(table[~taught]) for table in tables[:2])
    difference = one - other
    swapped = (rng.choice((-1.0, 1.0), (999, difference.size)) @ difference) >= difference.sum()
    return (1.0 + float(swapped.sum())) / 1000.0


DETECTORS: Mapping[str, Detector] = {
    "KS by slice": ks_by_slice,
    "energy distance, pairs swapped": energy_distance,
    "PTED, pairs swapped": pted_pairs_swapped,
    "PTED as it comes": pted_as_it_comes,
    "classifier, boosted trees": classifier,
}


def with_pairs_swapped(measured: Array, simulated: Array, rng: Generator) -> tuple[float, float]:
    """Energy distance, with all pairs counted, and its p-value.

    Labels are +1 and -1 and swap within pairs; the distance is -s D s / n^2.
    """
    both = np.concatenate([measured, simulated])
    signs = rng.choice((-1.0, 1.0), (len(measured), SWAPS + 1))
    signs[:, 0] = 1.0
    labels = np.concatenate([signs, -signs])
    statistic = -np.einsum("ij,ij->j", labels, cdist(both, both) @ labels) / len(measured) ** 2
    return float(statistic[0]), float((1.0 + (statistic[1:] >= statistic[0]).sum()) / (1.0 + SWAPS))
