"""Usual ways to pick effects from a library: a set of names leaves.

All of them choose by the same gain in log likelihood, worked out from the scores alone. Entries that add readings of
their own or change odds are mixtures: with S their scores, u = 1 + S theta is how much likelier a reading becomes. What
moves or widens the hits is taken to second order: y - y^2 / 2 with y = S theta / u. The base's parameters are
free with every choice. What differs is what counts as enough.
"""

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from evaluation.blind_peers.library import BASE_MOVES, Array, Library

LEAST = 0.1
"""Below this the logarithm goes on as a parabola (Owen, Empirical Likelihood, 2001, 12.4)."""
FALSE_SHARE = 0.05
"""PASTIS: the probability of a term too many; the one that the gap workflow is allowed."""
MOST_TERMS = 12
SAME = 0.05
"""Norm of an entry orthogonal to the base's parameters, of 1, under which it is one of them."""

Namer: TypeAlias = Callable[[Library], frozenset[str]]


def every_two_sigma(library: Library) -> frozenset[str]:
    """Each entry alone with the base: named where |z| > 2, z the signed root of its likelihood ratio."""
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
    moves: NDArray[np.bool_]
    base_moves: NDArray[np.bool_]
    most: Array
    """How much likelier each reading can become: its probability is at most 1."""
    alone: float = 0.0

    @classmethod
    def of(cls, library: Library) -> "_Search":
        sizes = np.sqrt((library.base**2).sum(axis=0))
        there = sizes > 0.0
        base = library.base[:, there] / sizes[there]
        across, _ = np.linalg.qr(base)
        left = library.scores - across @ (across.T @ library.scores)
        new = np.flatnonzero((left**2).sum(axis=0) > SAME**2)
        search = cls(
            base,
            library.scores[:, new],
            [library.names[k] for k in new],
            library.one_sided[new],
            library.moves[new],
            BASE_MOVES[: sizes.size][there],
            np.exp(-library.log_p),
        )
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
        moves = np.concatenate([self.base_moves, self.moves[list(terms)]])
        at, value = np.zeros(columns.shape[1]), 0.0
        for _ in range(50):
            likelier = 1.0 + columns[:, ~moves] @ at[~moves]
            inside = np.maximum(likelier, LEAST)
            moved = columns[:, moves] @ at[moves] / inside
            uphill = np.zeros(at.size)
            uphill[~moves] = columns[:, ~moves].T @ (self._slope(likelier) - (1.0 - moved) * moved / inside)
            uphill[moves] = columns[:, moves].T @ ((1.0 - moved) / inside)
            free = ~(bound & (at <= 0.0) & (uphill <= 0.0))
            curved = columns[:, free] / inside[:, None]
            step = np.zeros(at.size)
            step[free] = np.linalg.solve(curved.T @ curved + 1e-6 * np.eye(curved.shape[1]), uphill[free])
            for _ in range(20):
                there = np.where(bound, np.maximum(at + step, 0.0), at + step)
                reached = self._value(columns[:, ~moves] @ there[~moves], columns[:, moves] @ there[moves])
                if reached > value:
                    break
                step = 0.3 * step
            if reached <= value + 1e-4:
                break
            at, value = there, reached
        return at, value

    def _value(self, mixed: Array, moved: Array) -> float:
        likelier = 1.0 + mixed
        inside = np.maximum(likelier, LEAST)
        below = np.minimum(likelier - LEAST, 0.0) / LEAST
        y = moved / inside
        return float((np.log(np.minimum(inside, self.most)) + below - 0.5 * below**2 + y - 0.5 * y**2).sum())

    def _slope(self, likelier: Array) -> Array:
        inside = np.where(likelier < self.most, 1.0 / np.maximum(likelier, LEAST), 0.0)
        return np.where(likelier > LEAST, inside, (2.0 - likelier / LEAST) / LEAST)
