"""The verdict on a gap, and the sentence that a person reads first.

Findings enter, words leave. Where 'closed' is decided: `is_closed`, within `bounds`. A gap is closed if it is
equivalent to none (a bias of a tenth of sigma, a spread within 5 %, 0.005 nats per reading) or near the noise floor.
To the nats the cost of fitting is added.
"""

from collections.abc import Iterator

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.findings import FoundEffect, GapFindings, Measure, UnknownEffect, Verdict
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
    gap = findings.gap
    assert gap is not None
    measures = {
        "nats_per_reading": gap.nats_per_reading,
        "bias_cm": gap.bias_cm,
        "spread_ratio": gap.spread_ratio,
    }
    limits = bounds(findings, model)
    if all(_within(measures[key].after, bound) for key, bound in limits.items()):
        return True
    # Where nothing was added, the given model may do as it is: refitting its numbers has an error of its own.
    added = findings.effects or findings.unknown
    return not added and all(_within(measures[key].before, bound) for key, bound in limits.items())


def _was_closed(findings: GapFindings, model: Model) -> bool:
    """Whether the gap of the given model was within the bounds already."""
    gap = findings.gap
    assert gap is not None
    limits = bounds(findings, model)
    return all(_within(getattr(gap, key).before, limit) for key, limit in limits.items())


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
        return "nothing missing" if closed else "unexplained"
    sure = findings.unknown or any(each.verdict != "suggested" for each in findings.effects)
    if closed and sure:
        return "improved" if _was_closed(findings, model) else "explained"
    gap = findings.gap
    assert gap is not None
    before, after = gap.nats_per_reading.before or 0.0, gap.nats_per_reading.after or 0.0
    return "partly explained" if after < rules.PARTLY * before else "unexplained"


def sentence(findings: GapFindings) -> str:
    """The verdict for a person, with what was found and how far the gap closes."""
    text = {
        "nothing missing": "Nothing is missing",
        "explained": "The gap is explained",
        "improved": "The gap was within its bounds and is smaller now",
        "partly explained": "The gap is partly explained",
        "unexplained": "There is a gap that no effect explains",
        None: "Compared, not yet named",
    }[findings.verdict]
    if findings.verdict is None and (findings.effects or findings.unknown):
        text = "Named, not yet added"
    sure = [each for each in findings.effects if each.verdict != "suggested"]
    parts = [*(_effect_words(each) for each in sure), *(_unknown_words(each) for each in findings.unknown)]
    parts += [f"suggested, no finding: {_effect_words(each)}" for each in findings.effects if each not in sure]
    if parts:
        text += ": " + "; ".join(parts)
    gap = findings.gap
    if gap is not None:
        text += ". " + "; ".join(_gap_words(gap.nats_per_reading, gap.bias_cm, bool(parts)))
    numbers = [each for each in findings.calibration if each.name not in ("resolution", "code")]
    if numbers:
        text += f". Calibration: {'; '.join(each.finding for each in numbers)}"
    return text + "."


def _effect_words(each: FoundEffect) -> str:
    text = each.name + (f" of {each.of}" if each.of else "")
    values = []
    for key, value in each.parameters.items():
        unit = "" if value.unit == "1" else f" {value.unit}"
        interval = "" if value.low is None or value.high is None else f" ({value.low:.3g} to {value.high:.3g})"
        values.append(f"{key} {value.value:.3g}{unit}{interval}")
    text += f", {', '.join(values)}" if values else ""
    if each.verdict == "indistinguishable" and each.alternatives:
        text += " (or " + " or ".join(other.name for other in each.alternatives) + ", indistinguishable in these data)"
    return text


def _unknown_words(each: UnknownEffect) -> str:
    return f"an unknown effect: {each.channel} depends on {' and '.join(each.variables)} like {each.formula}"


def _gap_words(nats: Measure, bias: Measure, added: bool) -> Iterator[str]:
    if nats.after is None or bias.after is None or not added:
        yield f"The gap is {_number(nats.before)} nats per reading (noise floor {_number(nats.noise_floor)})"
        yield f"bias {_number(bias.before)} cm (noise floor {_number(bias.noise_floor)})"
        return
    yield (
        f"On held-out runs the gap goes from {_number(nats.before)} to {_number(nats.after)} nats per reading "
        f"(noise floor {_number(nats.noise_floor)})"
    )
    yield f"the bias from {_number(bias.before)} to {_number(bias.after)} cm (noise floor {_number(bias.noise_floor)})"


def _number(value: float | None) -> str:
    if value is None:
        return "?"
    return "0" if abs(value) < 5e-5 else f"{value:.2g}" if abs(value) < 1.0 else f"{value:.3g}"


def _within(left: float | None, bound: float) -> bool:
    return left is not None and left <= bound
