"""The verdict on a gap, and the sentence that a person reads first.

Findings enter, words leave. The bound within which a gap counts as closed is that of equivalence: a bias of a tenth of
a standard deviation, a spread within 5 %, 0.005 nats a reading; or 1.3 times what chance shows, up to half a standard
deviation, 25 % and 0.05 nats. To the nats comes what fitting costs.
"""

from collections.abc import Iterator

import numpy as np

from msp_lab.gap.findings import FoundEffect, GapFindings, Measure, Unknown, Verdict
from msp_sim.model.model import Model

BIAS_SIGMAS = 0.1
SPREAD_RATIO = 1.05
NATS = 0.005
BASE_NUMBERS = 7
"""Of the base model, which are fitted again with whatever is added."""
FLOORS = 1.3
"""Times what chance shows: its 95 % point is known no better than that from twenty, and three measures are asked."""
MOST_BIAS_SIGMAS, MOST_SPREAD_RATIO, MOST_NATS = 0.5, 1.25, 0.05
"""Where readings of a few runs depend on each other chance alone may show more; a gap so wide is not closed."""


def bounds(findings: GapFindings, model: Model) -> dict[str, float]:
    """The largest gap that counts as closed, by measure."""
    assert findings.gap is not None
    gap, sigma_cm = findings.gap, model.sensor.reading_model.sigma_cm
    fitted = BASE_NUMBERS + sum(len(each.parameters) for each in findings.effects) + 4 * len(findings.unknown)
    # Each number that was fitted on the one half of the readings costs half a nat on the other, and up to twice that.
    cost = fitted / max(findings.rows, 1)
    return {
        "nats_per_reading": float(np.clip(FLOORS * (gap.nats_per_reading.floor or 0.0), NATS, MOST_NATS)) + cost,
        "bias_cm": sigma_cm
        * float(np.clip(FLOORS * (gap.bias_cm.floor or 0.0) / sigma_cm, BIAS_SIGMAS, MOST_BIAS_SIGMAS)),
        "spread_ratio": float(
            np.clip(1.0 + FLOORS * ((gap.spread_ratio.floor or 1.0) - 1.0), SPREAD_RATIO, MOST_SPREAD_RATIO)
        ),
    }


def is_closed(findings: GapFindings, model: Model) -> bool:
    """Whether the gap that is left is within the bound, in nats and in centimetres."""
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
    # Where nothing was added, the given model may do as well as it is: fitting its numbers again has its own error.
    added = findings.effects or findings.unknown
    return not added and all(_within(measures[key].before, bound) for key, bound in limits.items())


def verdict(findings: GapFindings, model: Model) -> Verdict:
    """What all of it comes to.

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
    if closed:
        return "explained"
    gap = findings.gap
    assert gap is not None
    before, after = gap.nats_per_reading.before or 0.0, gap.nats_per_reading.after or 0.0
    return "partly explained" if after < 0.9 * before else "unexplained"


def sentence(findings: GapFindings) -> str:
    """The verdict for a person, with what was found and what it does to the gap."""
    told = {
        "nothing missing": "Nothing is missing",
        "explained": "The gap is explained",
        "partly explained": "The gap is partly explained",
        "unexplained": "There is a gap that nothing here explains",
        None: "Compared, not yet named",
    }[findings.verdict]
    if findings.verdict is None and (findings.effects or findings.unknown):
        told = "Named, not yet added"
    parts = [*(_effect_words(each) for each in findings.effects), *(_unknown_words(each) for each in findings.unknown)]
    if parts:
        told += ": " + "; ".join(parts)
    gap = findings.gap
    if gap is not None:
        told += ". " + "; ".join(_gap_words(gap.nats_per_reading, gap.bias_cm, bool(parts)))
    numbers = [each for each in findings.calibration if each.name not in ("resolution", "code")]
    if numbers:
        told += f". Calibration: {'; '.join(each.finding for each in numbers)}"
    return told + "."


def _effect_words(each: FoundEffect) -> str:
    said = each.name + (f" of {each.of}" if each.of else "")
    values = []
    for key, value in each.parameters.items():
        unit = "" if value.unit == "1" else f" {value.unit}"
        interval = "" if value.low is None or value.high is None else f" ({value.low:.3g} to {value.high:.3g})"
        values.append(f"{key} {value.value:.3g}{unit}{interval}")
    said += f", {', '.join(values)}" if values else ""
    if each.verdict == "indistinguishable" and each.rivals:
        said += " (or " + " or ".join(rival.name for rival in each.rivals) + ", which these data cannot tell apart)"
    return said


def _unknown_words(each: Unknown) -> str:
    return f"an unknown effect: {each.channel} depends on {' and '.join(each.variables)} like {each.formula}"


def _gap_words(nats: Measure, bias: Measure, added: bool) -> Iterator[str]:
    if nats.after is None or bias.after is None or not added:
        yield f"The gap is {_number(nats.before)} nats a reading (chance: {_number(nats.floor)})"
        yield f"bias {_number(bias.before)} cm (chance: {_number(bias.floor)})"
        return
    yield (
        f"On runs that took no part, the gap goes from {_number(nats.before)} to {_number(nats.after)} nats a reading "
        f"(chance: up to {_number(nats.floor)})"
    )
    yield f"the bias from {_number(bias.before)} to {_number(bias.after)} cm (chance: up to {_number(bias.floor)})"


def _number(value: float | None) -> str:
    if value is None:
        return "?"
    return "0" if abs(value) < 5e-5 else f"{value:.2g}" if abs(value) < 1.0 else f"{value:.3g}"


def _within(left: float | None, bound: float) -> bool:
    return left is not None and left <= bound
