"""Expected squares of the scores of what hardly ever shows: readings where the model has next to none.

The score of second echoes is several thousand at the few random readings that happen to be at twice the range, and
nothing elsewhere. A replicate of 24,000 readings has about seven of those, and a session of it none or one: its
expected square would be random. So is that of missed readings, where a sensor misses one in a thousand. So a share of
the replicate's readings is drawn from the effects themselves, and from the kinds of outliers, and every reading is
weighted by its probability under the model over that under the mixture that it was drawn from (importance sampling with
a defensive mixture: Hesterberg 1995, Technometrics 37:185).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from msp_lab.gap.candidates import CandidateEffect
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import JointFit
from msp_range.arrays import Array
from msp_range.reading_model.rows import MIN_PROBABILITY
from msp_sim.model.model import applies
from msp_sim.model.rows import ModelRows, log_prob
from msp_sim.model.streams import RandomStreams

RARE_SHARE = 0.2
"""Share of a replicate's readings that are drawn from effects and kinds of outliers, in equal parts from each. Of 30
each gets 160 of 24,000. Higher: what the model itself gives is known from fewer readings; lower: rare effects are."""
NO_WEIGHT = -60.0
"""Logarithm of the weight of a kind of reading that does not come."""
KINDS = (1, 2, 3)
"""Places of short, missed and random readings among the kinds."""


class RareReadings:
    """A replicate of which some readings are drawn from effects and kinds of outliers, and the weights for it.

    Parameters
    ----------
    drawn
        A replicate of the fit.
    fit
        Base and effects from which it was drawn.
    candidates
        Effects of which scores are asked; those that mix something into the probability are drawn from.
    rng
        Source of the readings.
    """

    def __init__(
        self, drawn: Prepared, fit: JointFit, candidates: Sequence[CandidateEffect], rng: np.random.Generator
    ) -> None:
        rows = drawn.at(fit.base, fit.effects)
        self._others = 1.0 + sum(np.asarray(each.odds) for each in rows.added)
        given, _ = rows.given(drawn.reading_cm)
        mixed = [k for k, each in enumerate(candidates) if each.linear]
        reading_cm = drawn.reading_cm.copy()
        self._sources = len(mixed) + len(KINDS)
        which = np.where(rng.random(len(drawn)) < RARE_SHARE, rng.integers(self._sources, size=len(drawn)), -1)
        self._shares: list[tuple[int, Array]] = []
        for number, k in enumerate(mixed):
            parameter = candidates[k].parameter
            active = candidates[k].at(candidates[k].neutral + parameter.step)
            change = active.change(drawn.scene)
            share = change.share if change.fault is None else change.fault_share
            known = np.where(applies(drawn.scene, active), share, 0.0) / parameter.step
            own = np.broadcast_to(np.nan_to_num(known), reading_cm.shape)
            self._shares.append((k, own))
            some = np.flatnonzero((which == number) & (own > 0.0))
            if change.fault is not None:
                reading_cm[some] = change.fault.arrives(reading_cm[some])
            elif change.component is not None:
                sigma_cm = np.broadcast_to(given.sigma_cm, reading_cm.shape)[some]
                hits = replace(given.hits, centre_cm=given.centre_cm[some], sigma_cm=sigma_cm)
                reading_cm[some] = change.component.take(some).sample(rng, hits)
        kinds = [_of_kind(given, kind) for kind in KINDS]
        for number, kind in enumerate(kinds, start=len(mixed)):
            some = np.flatnonzero(which == number)
            reading_cm[some] = kind.take(some).sample(RandomStreams(rng))
        # What the model cannot give at all says everything, and would leave nothing to be expected of the rest.
        log_p = replace(drawn, reading_cm=reading_cm).log_prob(fit.base, fit.effects)
        is_possible = log_p > np.log(2.0 * MIN_PROBABILITY)
        self.prepared = replace(drawn, reading_cm=np.where(is_possible, reading_cm, drawn.reading_cm))
        log_p = self.prepared.log_prob(fit.base, fit.effects)
        self._of_kinds = sum(np.exp(log_prob(kind, self.prepared.reading_cm) - log_p) for kind in kinds)

    def weights(self, scores: Array) -> Array:
        """Weight of each reading, at most 1 / (1 - `RARE_SHARE`), (n,).

        Parameters
        ----------
        scores
            (n, candidates): at `prepared`. With r the probability under an effect over that under the model, the score
            is (r - 1) times the effect's share at this reading, and the weight
            ``1 / (1 - RARE_SHARE + RARE_SHARE mean(r))``; where an effect has no share, r is 1.
        """
        ratio = np.asarray(self._of_kinds)
        for k, share in self._shares:
            some = share > 0.0
            odds = scores[:, k] * self._others / np.where(some, share, 1.0)
            ratio = ratio + np.where(some, np.maximum(1.0 + odds, 0.0), 1.0)
        weight: Array = 1.0 / (1.0 - RARE_SHARE + RARE_SHARE * ratio / self._sources)
        return weight


def _of_kind(rows: ModelRows, kind: int) -> ModelRows:
    """The rows as they would be if all their readings were of one kind."""
    hit, short, missed, random = (0.0 if place == kind else NO_WEIGHT for place in range(4))
    return replace(rows, log_weights=(hit, short, missed, random), added=())
