"""Sequential evidence that readings have begun to follow another distribution than their model's, valid at any time.

It is updated with the likelihood ratio L of an alternative to the model for each reading, and reports when a change has
begun or ended. The statistic is that of Shiryaev and Roberts,

    M_n = L_n (M_(n-1) + 1),   M_0 = 0   =   sum over all possible beginnings k of  L_k L_(k+1) ... L_n,

an e-detector of Shin, Ramdas and Rinaldo (E-detectors: a nonparametric framework for sequential change detection, New
England Journal of Statistics in Data Science 2, 2023, section 2). Where the expectation of L given the past is at most
1, as it is while the model holds, M_n - n is a supermartingale. At the time T of the first M_T >= A therefore
E[T] >= E[M_T] >= A: without a change the mean number of readings to a report is at least A, whatever else the readings
do, however long one waits, and without a table of critical values. The same holds for the weighted sum of several
detectors whose weights sum to 1, so a detector of weight w reports at A / w. L may be smaller than the true ratio, as
where it is bounded: that keeps the bound.
"""

import math
from collections.abc import Sequence

RECOVERS_READINGS = 10_000.0
"""A report is withdrawn by the same statistic of the inverse ratio: while the change lasts, that happens once in so
many readings on average, an hour of one sensor. Fewer withdraw a report that is still true, more keep one longer."""
KEPT = 0.99
"""Share of the frequency so far that a reading leaves: it is a mean over 100 readings. A shorter one follows bushes and
soft ground sooner, a longer one knows the other sensors better."""
FREQUENCY_SIGMAS = 1.0
"""The others' mean frequency replaces the model's probability where it exceeds it by so many standard errors: fewer
find less where all sensors are a little worse than their model, more report one sensor where all are."""


class Evidence:
    """The evidence for one alternative, or, once that is reported, for the model again.

    Parameters
    ----------
    threshold
        A / w: readings between two false reports, over the alternative's weight.

    Attributes
    ----------
    is_found
        Whether the alternative is reported.

    Examples
    --------
    >>> evidence = Evidence(1000.0)
    >>> [evidence.update(8.0, 0.25, 1.0) for _ in range(4)], evidence.ratio
    ([False, False, False, True], 4.0)
    """

    is_found = False
    _sum = 0.0
    # Since the likeliest beginning of a change: product of the ratios, what was expected, and what was found.
    _since = _expected = _found = 0.0
    _before = (0.0, 0.0, 0.0, 0.0)

    def __init__(self, threshold: float) -> None:
        self._threshold = threshold

    @property
    def ratio(self) -> float:
        """What was found since the likeliest beginning of the change, over what was expected."""
        return self._found / self._expected if self._expected > 0.0 else math.inf

    def update(self, likelihood_ratio: float, expected: float, found: float) -> bool:
        """Update with a reading; True where the report begins or ends with it.

        Parameters
        ----------
        likelihood_ratio
            Of the alternative to the model.
        expected, found
            What is counted of the reading: its expectation by the model, and its value.
        """
        self._before = self._sum, self._since, self._expected, self._found
        if self.is_found:
            self._sum, limit = (self._sum + 1.0) / likelihood_ratio, RECOVERS_READINGS
        else:
            if self._since <= 1.0:
                self._since, self._expected, self._found = 1.0, 0.0, 0.0
            self._since *= likelihood_ratio
            self._expected += expected
            self._found += found
            self._sum, limit = likelihood_ratio * (self._sum + 1.0), self._threshold
        if self._sum < limit:
            return False
        self._sum = self._since = 0.0
        self._before = (0.0, 0.0, 0.0, 0.0)
        self.is_found = not self.is_found
        return True

    def retract(self) -> None:
        """Take back the last reading, which was of something else; a report that began or ended with it stays."""
        self._sum, self._since, self._expected, self._found = self._before


class Occurrences(Evidence):
    """How often something rare happens at a sensor, with the evidence that it has become more frequent.

    The alternative has ``odds`` times the odds of the model's probability p, so L = odds^k / (1 + (odds - 1) p), k = 1
    for a reading in which it happens and 0 for another. Readings in which it does not are only counted, until it does:
    they cannot begin a report.

    Parameters
    ----------
    threshold
        As for `Evidence`.
    odds
        Of the alternative over the model's.

    Attributes
    ----------
    nones
        Readings since it last happened.
    """

    nones = _readings = 0
    _frequency = _probability = 0.0

    def __init__(self, threshold: float, odds: float) -> None:
        super().__init__(threshold)
        self._odds = odds

    @property
    def frequency(self) -> float:
        """Mean over the last readings; 0 before the first."""
        readings = self._readings + self.nones
        return self._frequency * KEPT**self.nones / (1.0 - KEPT**readings) if readings else 0.0

    def happens(self, probability: float, others: Sequence["Occurrences"]) -> bool:
        """It happens; True where the report begins or ends with it.

        Parameters
        ----------
        probability
            By the model.
        others
            The same of other sensors: what happens to all of them has a common cause.
        """
        good = [other.frequency for other in others if not other.is_found]
        if good:
            mean = sum(good) / len(good)
            error = (mean * (1.0 - mean) * (1.0 - KEPT) / (2.0 * len(good))) ** 0.5
            probability = max(probability, mean - FREQUENCY_SIGMAS * error)
        self._probability = probability
        changed = self.settle()
        self._frequency = self._frequency * KEPT + 1.0 - KEPT
        self._readings += 1
        ratio = self._odds / (1.0 + (self._odds - 1.0) * probability)
        return self.update(ratio, probability, 1.0) or changed

    def settle(self) -> bool:
        """Account for the readings in which it did not happen; True where they end the report."""
        count, self.nones = self.nones, 0
        if not count:
            return False
        self._frequency *= KEPT**count
        self._readings += count
        ratio = 1.0 / (1.0 + (self._odds - 1.0) * self._probability)
        if self.is_found:
            return sum([self.update(ratio, 0.0, 0.0) for _ in range(count)]) > 0
        # As many updates at once: no ratio up to 1 begins a report. It is 1 where by the model this never happens.
        product = ratio**count
        self._sum = product * self._sum + ratio * ((1.0 - product) / (1.0 - ratio) if ratio < 1.0 else count)
        self._since *= product
        self._expected += count * self._probability
        return False
