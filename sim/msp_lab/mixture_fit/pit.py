"""Goodness of fit of a reading model by the randomised probability integral transform (PIT).

Where the model is right, the probability of a smaller reading plus a random share of the reading's own is uniform from
0 to 1, also for whole centimetres and codes (Czado, Gneiting & Held 2009, Predictive model assessment for count data,
Biometrics 65).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2

from msp_lab.mixture_fit.fit_result import FitResult
from msp_range.arrays import Array

BINS = 20
FEWEST_IN_BIN = 5
"""Readings that a bin of the chi-square test should expect."""


@dataclass(frozen=True)
class GoodnessOfFit:
    """How uniform the transformed readings are."""

    pit_histogram: tuple[int, ...]
    """Number of readings in each of the equal bins from 0 to 1; none where it is not known."""
    chi_square_p_value: float | None
    """p-value of the histogram, for readings that the parameters were fitted to: they fit better than they should, by
    at most as many degrees of freedom as were fitted. The smaller of the p-values that the true one lies between."""
    note: str
    """What the p-value means, or why there is none: too few readings, or some that the model cannot give."""


def pit_values(
    result: FitResult,
    reading_cm: ArrayLike,
    expected_cm: ArrayLike,
    rng: np.random.Generator,
    reference_std_cm: ArrayLike = 0.0,
) -> Array:
    """Transform each reading to 0 ... 1, (n,); NaN for what the sensor cannot report."""
    below, itself = result.below(reading_cm, expected_cm, reference_std_cm)
    transformed = below + rng.random(below.size) * itself
    transformed[itself <= 0.0] = np.nan
    return np.clip(transformed, 0.0, 1.0)


def goodness_of_fit(
    result: FitResult,
    reading_cm: ArrayLike,
    expected_cm: ArrayLike,
    rng: np.random.Generator,
    reference_std_cm: ArrayLike = 0.0,
) -> GoodnessOfFit:
    """Test whether the readings could come from the mixture that was fitted to them.

    Parameters
    ----------
    result
        The fit.
    reading_cm, expected_cm
        Readings and what hits read on average [cm], (n,).
    rng
        Source of the random shares.
    reference_std_cm
        Standard deviation of the error of each expected range [cm], a number or (n,).
    """
    transformed = pit_values(result, reading_cm, expected_cm, rng, reference_std_cm)
    readings, impossible = transformed.size, int(np.isnan(transformed).sum())
    why = ""
    if readings < BINS * FEWEST_IN_BIN:
        why = f"found {readings} readings, expected at least {BINS * FEWEST_IN_BIN}"
    elif impossible:
        why = f"found {impossible} of {readings} readings that the model cannot give, expected none"
    if why:
        return GoodnessOfFit((), None, f"how well it fits is not known: {why}")
    counts = np.histogram(transformed, BINS, (0.0, 1.0))[0]
    expected = readings / BINS
    chi_square = float(((counts - expected) ** 2).sum() / expected)
    fitted = len(result.estimates) - 1 - len(result.at_bound) - len(result.not_identified)
    lower = float(chi2.sf(chi_square, max(BINS - 1 - fitted, 1)))
    upper = float(chi2.sf(chi_square, BINS - 1))
    note = (
        f"The {fitted} parameters were fitted to the same readings: the p-value of the fit lies between "
        f"{lower:.2g} and {upper:.2g}. Readings that depend on each other make it too small."
    )
    return GoodnessOfFit(tuple(counts.tolist()), lower, note)
