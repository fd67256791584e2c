"""The fitted mixture of hits, short, missed and random readings."""

from dataclasses import dataclass

from msp_lab.characterise.findings.estimate import IntervalEstimate


@dataclass(frozen=True)
class MixtureParameter:
    """One parameter of the fitted mixture: its name in the sensor model file, and the starting model's value.

    `at_bound` marks a value at the end of what it can be: the model has its bound or its floor, and not an estimate.
    """

    name: str
    fitted: IntervalEstimate
    before: float | None
    at_bound: bool = False


@dataclass(frozen=True)
class PlacementError:
    """How far the hits of one set-up are from where calibration and reference expect them [cm]."""

    condition: str
    run: str
    true_range_cm: float
    error_cm: float


@dataclass(frozen=True)
class Mixture:
    """The mixture of Thrun fitted by maximum likelihood (Probabilistic Robotics, section 6.3).

    Attributes
    ----------
    parameters
        In the order of the sensor model file.
    readings
        How many were fitted.
    log_likelihood
        At the fit.
    pit_counts
        Histogram of the randomised probability integral transform over [0, 1] in equal bins; flat where the model fits.
    pit_p_value
        Of uniformity; a small one means that the model does not fit. None: too few readings for it.
    conditional
        What depends on range, and why, in a sentence.
    notes
        What to know of these numbers.
    set_ups
        Set-ups that were fitted about their own mean, with its distance from the calibration.
    """

    parameters: tuple[MixtureParameter, ...]
    readings: int
    log_likelihood: float
    pit_counts: tuple[int, ...]
    pit_p_value: float | None
    conditional: str
    notes: tuple[str, ...] = ()
    set_ups: tuple[PlacementError, ...] = ()
