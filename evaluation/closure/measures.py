"""Two measures of how far two tables of readings at the same contexts differ.

A classifier that learns to separate measured from simulated rows, tested on held-out runs; and the Kolmogorov and
Smirnov distance in slices of each context. Both grow with the square of a small difference, like nats per reading.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import ks_2samp
from threadpoolctl import threadpool_limits

from evaluation.closure.table import FloatArray, Table

FOLDS = 4
"""Groups of runs that are left out in turn. More take longer, and change a figure by less than its error."""

BINS, CATEGORIES, FEWEST = 5, 8, 60
"""Slices of a context: quantile bins of a number, values of a category, and the fewest readings of a slice. KS on fewer
than 60 readings is nearly all noise; more bins leave less in each."""


@dataclass(frozen=True)
class Separability:
    """How well a classifier separates two tables."""

    nats: float
    """Logarithm of 2 less its log loss on rows that were left out, per row: 0 where they are alike, log 2 = 0.69 where
    it is always right. A lower bound of the Jensen-Shannon divergence."""
    auc: float
    """Share of pairs, one of each table, that it ranks rightly; 0.5 where they are alike."""


def separability(measured: Table, simulated: Table, seed: int) -> Separability:
    """Train on some runs, ask on others; both tables' rows of a run are left out together.

    Parameters
    ----------
    measured, simulated
        Rows at the same contexts, in the same order.
    seed
        Of the folds and of the classifier.
    """
    # Here, because all processes of tests import this module, and only few need half a second of scikit-learn.
    from sklearn.ensemble import HistGradientBoostingClassifier
    from sklearn.linear_model import LogisticRegression
    from sklearn.metrics import roc_auc_score

    features = np.vstack([_features(measured), _features(simulated)])
    label = np.repeat([1, 0], len(measured.reading_cm))
    fold = np.tile(_folds(measured, seed), 2)
    probability = np.empty(label.size)
    for number in range(FOLDS):
        out = fold == number
        if not out.any():
            continue
        # Small trees and many rows a leaf: tables of 1,000 rows are the usual case.
        model = HistGradientBoostingClassifier(
            max_iter=80, learning_rate=0.08, max_leaf_nodes=12, min_samples_leaf=40, l2_regularization=1.0,
            early_stopping=False, random_state=seed,
        )  # fmt: skip
        # Its threads wait for each other by spinning, which takes minutes where other programs want the processors too.
        with threadpool_limits(1):
            model.fit(features[~out], label[~out])
            probability[out] = model.predict_proba(features[out])[:, 1]
    # On runs that it has not seen it is overconfident: two numbers put that right for all of them.
    logit = np.log(np.clip(probability, 1e-6, 1 - 1e-6) / np.clip(1 - probability, 1e-6, 1.0))[:, None]
    likely = LogisticRegression().fit(logit, label).predict_proba(logit)[np.arange(label.size), label]
    return Separability(float(np.log(2.0) + np.log(likely).mean()), float(roc_auc_score(label, probability)))


def _features(table: Table) -> FloatArray:
    residual = table.residual_cm
    return np.column_stack([residual, table.reading_cm, *table.contexts.values()])


def _folds(table: Table, seed: int) -> FloatArray:
    """A fold for each row: whole runs, or where there are fewer than four, blocks of consecutive rows."""
    names, run = np.unique(table.run, return_inverse=True)
    if names.size < FOLDS:
        run = np.arange(run.size) * 6 * FOLDS // run.size
    order = np.random.default_rng(seed).permutation(run.max() + 1)
    return order[run] % FOLDS


def ks_by_slice(measured: Table, simulated: Table) -> float:
    """Mean square of the KS distance of residuals over the slices of all contexts, and all rows."""
    one, other = measured.residual_cm, simulated.residual_cm
    squares = [ks_2samp(one, other, method="asymp").statistic ** 2]
    for column in measured.contexts.values():
        for rows in slices(column):
            squares.append(ks_2samp(one[rows], other[rows], method="asymp").statistic ** 2)
    return float(np.mean(squares))


def slices(column: FloatArray) -> list[FloatArray]:
    """Rows of each slice of one context."""
    known = column[~np.isnan(column)]
    values = np.unique(known)
    if values.size <= CATEGORIES:
        parts = [column == value for value in values]
    else:
        edges = np.quantile(known, np.linspace(0.0, 1.0, BINS + 1)[1:-1])
        number = np.where(np.isnan(column), -1, np.searchsorted(edges, column, side="right"))
        parts = [number == k for k in range(BINS)]
    return [part for part in parts if part.sum() >= FEWEST]
