"""The verdict on a gap.

Findings enter, a word leaves. Where 'closed' is decided: `is_closed`, within `bounds`. A gap is closed if it is
equivalent to none (a bias of a tenth of sigma, a spread within 5 %, 0.005 nats per reading) or near the noise floor.
To the nats the cost of fitting is added.
"""

from typing import Literal

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.findings import GapFindings, Measure, Verdict
from msp_lab.gap.prepared import BASE
from msp_sim.model.model import Model


def bounds(findings: GapFindings, model: Model) -> dict[str, float]:
    """The largest gap that counts as closed, by measure."""
    assert findings.gap is not None
    gap, sigma_cm = findings.gap, model.sensor.reading_model.sigma_cm
    fitted = len(BASE) + sum(len(each.parameters) for each in findings.effects)
    fitted += rules.CURVE_NUMBERS * len(findings.unknown)
    # A number fitted on one half of the readings costs half a nat on the other, and up to twice that.
    cost = fitted / max(findings.rows, 1)
    nats = _near_floor(gap.nats_per_reading, 0.0, rules.CLOSED_NATS, rules.CLOSED_MAX_NATS)
    least_cm, most_cm = rules.CLOSED_BIAS_SIGMAS * sigma_cm, rules.CLOSED_MAX_BIAS_SIGMAS * sigma_cm
    return {
        "nats_per_reading": nats + cost,
        "bias_cm": _near_floor(gap.bias_cm, 0.0, least_cm, most_cm),
        "spread_ratio": _near_floor(gap.spread_ratio, 1.0, rules.CLOSED_SPREAD_RATIO, rules.CLOSED_MAX_SPREAD_RATIO),
    }


def _near_floor(measure: Measure, nothing: float, least: float, most: float) -> float:
    """A bound somewhat above the noise floor, within limits; `nothing` is the measure of no gap."""
    floor = nothing if measure.noise_floor is None else measure.noise_floor
    return float(np.clip(nothing + rules.NOISE_FLOOR_FACTOR * (floor - nothing), least, most))


def is_closed(findings: GapFindings, model: Model) -> bool:
    """Whether the gap that is left is within the bounds."""
    # Where nothing was added, the given model may do as it is: refitting its numbers has an error of its own.
    added = findings.effects or findings.unknown
    return _is_within(findings, model, "after") or (not added and _was_closed(findings, model))


def _was_closed(findings: GapFindings, model: Model) -> bool:
    """Whether the gap of the given model was within the bounds already."""
    return _is_within(findings, model, "before")


def _is_within(findings: GapFindings, model: Model, when: Literal["before", "after"]) -> bool:
    """Whether all three measures are known and within their bounds."""
    limits = bounds(findings, model)
    measured = {key: getattr(getattr(findings.gap, key), when) for key in limits}
    return all(measured[key] is not None and measured[key] <= limit for key, limit in limits.items())


def _is_noise(findings: GapFindings) -> bool:
    """Whether random variation makes a gap like that of the given model: of few readings it is beyond the bounds."""
    assert findings.gap is not None
    nats = findings.gap.nats_per_reading
    return None not in (nats.before, nats.noise_floor) and (nats.before or 0.0) <= (nats.noise_floor or 0.0)


def verdict(findings: GapFindings, model: Model) -> Verdict:
    """What the findings amount to.

    Parameters
    ----------
    findings
        With the gap before and after.
    model
        The given one, for its spread.
    """
    closed = is_closed(findings, model)
    if not findings.effects and not findings.unknown:
        if not closed:
            return "nothing missing" if _is_noise(findings) else "unexplained"
        # What the base's own numbers close was there all the same.
        return "nothing missing" if _was_closed(findings, model) else "absorbed"
    sure = findings.unknown or findings.confirmed
    if closed and _was_closed(findings, model):
        return "improved" if sure else "nothing missing"
    if closed and sure:
        return "explained"
    gap = findings.gap
    assert gap is not None
    before, after = gap.nats_per_reading.before or 0.0, gap.nats_per_reading.after or 0.0
    return "partly explained" if after < rules.PARTLY * before else "unexplained"
