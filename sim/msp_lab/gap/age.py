"""How old a reading is when it is used: the sensor's latency, and the time that a log or a driver holds each value.

One age is found from the findings, the model with what was added and held-out readings. Latency and repeated readings
are two effects with two numbers, but what flies feels their sum.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from msp_lab.gap.findings import GapFindings, ReadingAge
from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.runs import reading_before
from msp_sim.effects.latency import LATENCY
from msp_sim.effects.stale import STALE
from msp_sim.model.model import Model


def reading_age(findings: GapFindings, model: Model, readings: HeldOutReadings) -> ReadingAge | None:
    """Add the mean hold to the latency; None where not both were found.

    Parameters
    ----------
    findings
        With the effects.
    model
        With what was added.
    readings
        With times, on which the hold is measured.
    """
    found: Mapping[str, float] = {
        each.name: next(iter(each.parameters.values())).value for each in findings.confirmed if each.parameters
    }
    if not {LATENCY.name, STALE.name} <= found.keys() or "time_s" not in readings.contexts:
        return None
    return ReadingAge(found[LATENCY.name] / 1000.0, mean_hold_s(model, readings))


def mean_hold_s(model: Model, readings: HeldOutReadings) -> float:
    """Mean time since a reading's value was new [s].

    A reading is a repeat with the probability p that it has under the model with repeats and without, so that a value
    that comes twice by itself does not count as held: h_i = p_i (h_before + t_i - t_before).

    Parameters
    ----------
    model
        With `stale`.
    readings
        With times.
    """
    fresh = replace(model, effects=tuple(each for each in model.effects if each.effect is not STALE))
    log_share = np.log1p(-_share(model)) + fresh.log_prob(readings.reading_cm, readings.contexts)
    repeat = -np.expm1(np.minimum(log_share - model.log_prob(readings.reading_cm, readings.contexts), 0.0))
    n = len(readings)
    before, elapsed_s = reading_before(readings.contexts, n)
    hold_s = np.zeros(n)
    for i in np.argsort(readings.contexts["time_s"], kind="stable").tolist():
        j = int(before[i])
        if j >= 0 and readings.reading_cm[i] == readings.reading_cm[j]:
            hold_s[i] = repeat[i] * (hold_s[j] + elapsed_s[i])
    return float(hold_s.mean())


def _share(model: Model) -> float:
    return next(each.values["share"] for each in model.effects if each.effect is STALE)
