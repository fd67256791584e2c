"""How far a hidden effect is from none by the generator's own likelihood, with the numbers of the base free.

A size over its standard error is a distance at the truth. Far from none the likelihood need not be a parabola: a third
of the readings that are 1.2 cm farther are 10 standard errors from no such readings, and yet a base with another offset
and a wider spread has nearly as high a likelihood. Twice the logarithm of the ratio of the likelihoods has a root which
is the number of standard errors where it is a parabola (Barndorff-Nielsen & Cox 1994, Inference and Asymptotics).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from evaluation.second_hand.base import Base
from evaluation.second_hand.density import log_probability
from evaluation.second_hand.effect import Effect, law_with
from evaluation.second_hand.rows import Rows
from evaluation.second_hand.sample import draw
from evaluation.second_hand.size import NUISANCE, scores

STEPS = 6
"""Newton steps from the truth to the best base without the effect; they gain less than 0.1 nat after four."""


def likelihood_root(rows: Rows, base: Base, effects: Sequence[Effect], sizes: Sequence[float], seed: int) -> float:
    """Root of twice the log-likelihood ratio of the truth and the best base without effects, on a drawn table.

    Numbers of the base that are the same as an effect are held: the bench and the other vehicles know them.
    """
    held = {name for each in effects for name in each.kind.same_as}
    free = [k for k, name in enumerate(NUISANCE) if name not in held]
    drawn = draw(rows, base, law_with(rows, base, effects, sizes), np.random.default_rng(seed))

    def height(base: Base, effects: Sequence[Effect], sizes: Sequence[float]) -> float:
        return float(log_probability(rows, base, law_with(rows, base, effects, sizes), drawn).sum())

    truth, best = height(base, effects, sizes), height(base, [], [])
    for _ in range(STEPS):
        slopes = scores(rows, base, [], [], drawn)[:, free]
        information = slopes.T @ slopes
        step = np.linalg.solve(information + 1e-6 * np.diag(np.diag(information) + 1.0), slopes.sum(axis=0))
        for part in (1.0, 0.5, 0.25, 0.1):
            names = [list(NUISANCE)[k] for k in free]
            numbers = {name: getattr(base, name) + part * float(each) for name, each in zip(names, step, strict=True)}
            there = replace(base, **numbers)
            if there.sigma_cm < 0.1 or not 0.0 <= there.correlation < 0.97 or there.degrees < 2.5:
                continue
            value = height(there, [], [])
            if value > best:
                base, best = there, value
                break
        else:
            break
    return float(np.sqrt(max(2.0 * (truth - best), 0.0)))
