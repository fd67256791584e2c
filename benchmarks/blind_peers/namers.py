"""Usual ways to pick effects from a library: a set of names leaves.

All of them choose by the same gain in log likelihood, the sum of log(1 + S theta) over the readings with S the scores:
exact for whatever adds readings of its own, right to second order for what shifts, widens or reweights. The base's
parameters are free beside every choice. What differs is what counts as enough.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.blind_peers.library import Array, Library

LEAST = 0.1
"""Below this the logarithm goes on as a parabola (Owen, Empirical Likelihood, 2001, 12.4)."""
FALSE_SHARE = 0.05
"""PASTIS: the chance of a term too many; the one that the gap workflow is allowed."""
MOST_TERMS = 12
SAME = 0.05
"""Norm of an entry beside the base's parameters, of 1, under which it is one of them."""

Namer: TypeAlias = Callable[[Library], frozenset[str]]


def every_two_sigma(library: Library) -> frozenset[str]:
    """Each entry alone beside the base: named where |z| > 2, z the signed root of its likelihood ratio."""
    search = _Search.of(library)
    gains = (search.gain((k,)) for k in range(search.size))
    return frozenset(name for name, gain in zip(search.names, gains, strict=True) if 2.0 * gain > 2.0**2)


def aic_stepwise(library: Library) -> frozenset[str]:
    """Forward and backward steps while Akaike's criterion falls: 1 nat a term."""
    return _stepwise(library, lambda n, terms: 1.0)


def bic_stepwise(library: Library) -> frozenset[str]:
    """Forward and backward steps while the Bayesian criterion falls: half log n a term."""
    return _stepwise(library, lambda n, terms: 0.5 * np.log(n))


def pastis_stepwise(library: Library) -> frozenset[str]:
    """Forward and backward steps by PASTIS, log(size of the library / 0.05) a term.

    Gerardos and Ronceray, Principled model selection for stochastic dynamics, arXiv 2501.10339.
    """
    return _stepwise(library, lambda n, terms: float(np.log(terms / FALSE_SHARE)))


def pysindy_stlsq(library: Library) -> frozenset[str]:
    """PySINDy's STLSQ on the scores; its threshold is the one of the lowest BIC.

    The least-squares fit of ones by scores is the likelihood's own second order. Entries of which less than nothing
    would be best, and cannot be, are left out before, for STLSQ knows no bounds.
    """
    from pysindy.optimizers import STLSQ

    search = _Search.of(library)
    across, _ = np.linalg.qr(library.base)
    left = search.scores - across @ (across.T @ search.scores)
    left /= np.sqrt((left**2).sum(axis=0))
    ones = np.ones(len(left)) - across @ across.sum(axis=0)
    may = np.flatnonzero(~search.one_sided | (left.T @ ones > 0.0))
    best, chosen = 0.0, np.zeros(0, dtype=int)
    for threshold in np.arange(1.5, 6.1, 0.5):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Sparsity parameter is too big", UserWarning)
            found = STLSQ(threshold=threshold).fit(left[:, may], ones[:, None])
        terms = may[np.flatnonzero(found.coef_.ravel())]
        fitted = left[:, terms] @ np.linalg.lstsq(left[:, terms], ones, rcond=1e-6)[0]
        gain = 0.5 * float(ones @ ones - np.sum((ones - fitted) ** 2)) - 0.5 * np.log(len(left)) * terms.size
        if gain > best:
            best, chosen = gain, terms
    return frozenset(search.names[k] for k in chosen)


NAMERS: Mapping[str, Namer] = {
    "2 standard errors, each alone": every_two_sigma,
    "AIC stepwise": aic_stepwise,
    "BIC stepwise": bic_stepwise,
    "PASTIS stepwise": pastis_stepwise,
    "PySINDy STLSQ": pysindy_stlsq,
}


def _stepwise(library: Library, price: Callable[[int, int], float]) -> frozenset[str]:
    search = _Search.of(library)
    a_term = price(len(library.base), search.size)
    terms: tuple[int, ...] = ()
    gain = 0.0
    while len(terms) < MOST_TERMS:
        further = {k: search.gain((*terms, k)) for k in range(search.size) if k not in terms}
        k = max(further, key=further.__getitem__, default=None)
        if k is None or further[k] - gain <= a_term:
            break
        terms, gain = (*terms, k), further[k]
        while len(terms) > 1:
            fewer = {k: search.gain(tuple(t for t in terms if t != k)) for k in terms}
            k = max(fewer, key=fewer.__getitem__)
            if gain - fewer[k] > a_term:
                break
            terms, gain = tuple(t for t in terms if t != k), fewer[k]
    return frozenset(search.names[k] for k in terms)


@dataclass
class _Search:
    """A library without entries that the base's parameters already are."""

    base: Array
    scores: Array
    names: Sequence[str]
    one_sided: NDArray[np.bool_]
    alone: float

    @classmethod
    def of(cls, library: Library) -> "_Search":
        base = library.base[:, (library.base**2).sum(axis=0) > 0.0]
        base = base / np.sqrt((base**2).sum(axis=0))
        across, _ = np.linalg.qr(base)
        left = library.scores - across @ (across.T @ library.scores)
        new = np.flatnonzero((left**2).sum(axis=0) > SAME**2)
        names = [library.names[k] for k in new]
        search = cls(base, library.scores[:, new], names, library.one_sided[new], 0.0)
        search.alone = search.fit(())[1]
        return search

    @property
    def size(self) -> int:
        return len(self.names)

    def gain(self, terms: tuple[int, ...]) -> float:
        """Of the log likelihood over the base's own best [nat]."""
        return self.fit(terms)[1] - self.alone

    def fit(self, terms: tuple[int, ...]) -> tuple[Array, float]:
        """Coefficients of the base and of these terms, and the log likelihood that they reach."""
        columns = np.column_stack([self.base, self.scores[:, terms]])
        bound = np.concatenate([np.zeros(self.base.shape[1], dtype=bool), self.one_sided[list(terms)]])
        at = np.zeros(columns.shape[1])
        inside = np.ones(len(columns))
        value = 0.0
        for _ in range(50):
            uphill = columns.T @ _slope(inside)
            free = ~(bound & (at <= 0.0) & (uphill <= 0.0))
            curved = (columns[:, free].T * -_curvature(inside)) @ columns[:, free]
            step = np.zeros(at.size)
            step[free] = np.linalg.solve(curved + 1e-6 * np.eye(len(curved)), uphill[free])
            for _ in range(20):
                there = np.where(bound, np.maximum(at + step, 0.0), at + step)
                reached = float(_log(1.0 + columns @ there).sum())
                if reached > value:
                    break
                step = 0.3 * step
            if reached <= value + 1e-4:
                break
            at, value = there, reached
            inside = 1.0 + columns @ at
        return at, value


def _log(x: Array) -> Array:
    near = np.maximum(x, LEAST)
    below = np.minimum(x - LEAST, 0.0) / LEAST
    return np.asarray(np.log(near) + below - 0.5 * below**2)


def _slope(x: Array) -> Array:
    return np.asarray(np.where(x > LEAST, 1.0 / np.maximum(x, LEAST), (2.0 - x / LEAST) / LEAST))


def _curvature(x: Array) -> Array:
    return np.asarray(-1.0 / np.maximum(x, LEAST) ** 2)
