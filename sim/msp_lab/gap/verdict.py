"""The verdict on a gap.

Where 'closed' is decided: `bounds`. A gap is closed if it is equivalent to none (a bias of a tenth of sigma, a spread
within 5 %, 0.005 nats per reading) or near the noise floor. To the nats the cost of fitting is added. A gap near a
noise floor that is too high for that is neither closed nor seen; nor is one that is left where effects were named, if
its 95 % interval reaches no gap.
"""

from typing import Literal

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.findings import GapFindings, Measure, Verdict
from msp_lab.gap.prepared import BASE
from msp_sim.model.model import Model

NO_GAP = {"nats_per_reading": 0.0, "bias_cm": 0.0, "spread_ratio": 1.0}
"""Each measure of readings that agree with their model."""


def bounds(findings: GapFindings, model: Model, widened: float = 1.0) -> dict[str, float]:
    """The largest gap that counts as closed, by measure.

    Parameters
    ----------
    findings
        With the gap.
    model
        The given one, for its spread.
    widened
        Factor on the limits to which a noise floor counts; infinite: the largest gap that random variation hides.
    """
    assert findings.gap is not None
    gap, sigma_cm = findings.gap, model.sensor.reading_model.sigma_cm
    fitted = len(BASE) + sum(len(effect.parameters) for effect in findings.effects)
    fitted += rules.CURVE_NUMBERS * len(findings.unknown)
    # A number fitted on one half of the readings costs half a nat on the other, and up to twice that.
    cost = fitted / max(findings.rows, 1)
    limits = {
        "nats_per_reading": (rules.CLOSED_NATS, rules.CLOSED_MAX_NATS),
        "bias_cm": (rules.CLOSED_BIAS_SIGMAS * sigma_cm, rules.CLOSED_MAX_BIAS_SIGMAS * sigma_cm),
        "spread_ratio": (rules.CLOSED_SPREAD_RATIO, rules.CLOSED_MAX_SPREAD_RATIO),
    }
    found = {
        key: _near_floor(getattr(gap, key), NO_GAP[key], least, widened * most) for key, (least, most) in limits.items()
    }
    return {**found, "nats_per_reading": found["nats_per_reading"] + cost}


def _is_closed(measure: Measure, nothing: float, limit: float) -> bool:
    """Whether what is left is within a limit, or random variation may be all of it."""
    may_be_random = measure.low is not None and measure.low <= nothing
    return measure.after is not None and (measure.after <= limit or may_be_random)


def _near_floor(measure: Measure, nothing: float, least: float, most: float) -> float:
    """A bound somewhat above the noise floor, within limits; `nothing` is the measure of no gap."""
    floor = nothing if measure.noise_floor is None else measure.noise_floor
    return float(np.clip(nothing + rules.NOISE_FLOOR_FACTOR * (floor - nothing), least, most))


def verdict(findings: GapFindings, model: Model) -> Verdict:
    """What the findings amount to.

    Parameters
    ----------
    findings
        With the gap before and after.
    model
        The given one, for its spread.
    """
    closed, hidden = (bounds(findings, model, widened) for widened in (1.0, np.inf))

    def is_within(limits: dict[str, float], when: Literal["before", "after"]) -> bool:
        """Whether all three measures are known and within their bounds."""
        measured = {key: getattr(getattr(findings.gap, key), when) for key in limits}
        return all(measured[key] is not None and measured[key] <= limit for key, limit in limits.items())

    was_closed, is_closed = is_within(closed, "before"), is_within(closed, "after")
    added, sure = findings.effects or findings.unknown, findings.confirmed or findings.unknown
    # Where nothing was added, the given model may do as it is: refitting its numbers has an error of its own.
    if was_closed and (is_closed or not added):
        return "improved" if sure else "nothing missing"
    if not sure and not is_closed and is_within(hidden, "before"):
        return "undecided"
    # What the base's own numbers close was there all the same.
    if sure and all(_is_closed(getattr(findings.gap, key), NO_GAP[key], limit) for key, limit in hidden.items()):
        return "explained"
    if not added and is_within(hidden, "after"):
        return "absorbed"
    before, after = findings.nats.before or 0.0, findings.nats.after or 0.0
    return "partly explained" if added and after < rules.PARTLY * before else "unexplained"
