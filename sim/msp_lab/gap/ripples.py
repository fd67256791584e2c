"""Ripples of the hits' bias over range and over the time in a run: a periodogram of what a fit leaves.

Slopes at a fit enter, the likeliest ripple over each column leaves. A curve of twelve knots over five metres sees
nothing shorter than a metre; a sum over all readings of the score times a cosine and a sine sees every period. Its
power is judged against that of neighbouring frequencies, so that a slow wander or anything else without a period of its
own raises both; and the largest of all by the number of independent frequencies (Baluev 2008, MNRAS 385, 1279).
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msp_lab.gap import rules
from msp_lab.gap.curve_scan import CandidateCurve
from msp_lab.gap.prepared import ChannelSlopes
from msp_lab.gap.runs import known_values, spacing_s
from msp_range.arrays import Array
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.curve import Ripple

OVER = (TRUE_RANGE, "time_in_run_s", "uptime_s")
"""Columns over which a ripple is asked: standing waves and interference over range, what turns or beats over time."""
SHORTEST_CM = 4.0
"""Ripples over range are asked down to this period. Whole centimetres average over shorter ones. Smaller: more
independent frequencies, so that each has to be stronger."""
OVERSAMPLED = 4
"""Frequencies in the width of a peak. With 4 a peak between two of them keeps 97 % of its power. It affects speed and
that share."""
TRIMMED = 0.1
"""The largest share of the neighbours is left out: a strong ripple leaks into them where ranges are not even. It
affects how much power the second of two ripples needs."""
TRIMMED_MEAN = (1.0 - TRIMMED * (1.0 - np.log(TRIMMED))) / (1.0 - TRIMMED)
"""Mean of the others where the power is that of noise, which is exponential, with a mean of 1."""
CELLS_PER_PERIOD = 8
"""Scores are put into cells of this share of the shortest period. With 8 it keeps 97 % of its power."""


def ripples(contexts: Mapping[str, Any], here: ChannelSlopes) -> list[CandidateCurve]:
    """The likeliest ripple over each column, the least likely by random variation first.

    Parameters
    ----------
    contexts
        Columns by name, (n,).
    here
        Slopes at the present fit.
    """
    score = here.own_centre
    if here.carry is not None:
        # What moves a hit moves the centre of the hit after it, which carries its error over.
        n = score.size
        score = score - np.bincount(here.carry.before, here.carry.factor * here.own_centre, n)
    found = []
    for name in OVER:
        if name in contexts:
            at = np.asarray(contexts[name], dtype=np.float64)
            # Closer ripples have another one's values where there are readings.
            spacing = _spacing(at) if name == TRUE_RANGE else spacing_s(contexts)
            found.append(_ripple(name, at, score, max(SHORTEST_CM if name == TRUE_RANGE else 0.0, 2.0 * spacing)))
    return sorted((each for each in found if each is not None), key=lambda each: each.log_p + each.cost_nats)


def _ripple(name: str, at: Array, score: Array, shortest: float) -> CandidateCurve | None:
    known = np.isfinite(at) & (score != 0.0)
    at, score = at[known], score[known]
    if at.size < rules.RIPPLE_MIN_READINGS:
        return None
    span = float(np.ptp(at))
    longest = span / rules.RIPPLE_CYCLES
    if not 0.0 < shortest < longest:
        return None
    power, step = _periodogram(at - at.min(), score, span, shortest)
    first = int(np.ceil(1.0 / (longest * step)))
    if power.size - first < OVERSAMPLED * rules.RIPPLE_MIN_NEIGHBOURS:
        return None
    ratio, degrees = _over_neighbours(power)
    best = first + int(ratio[first:].argmax())
    largest = float(ratio[best])
    period = _sharpened(at, score, best * step, step)
    independent = span * (1.0 / shortest - 1.0 / longest)
    # Power of noise over the mean of `degrees` others: both have two degrees of freedom.
    log_p = -degrees * float(np.log1p(largest / degrees))
    cost = float(np.log(max(independent, 1.0)) + 0.5 * np.log(max(largest, 1.0)))
    return CandidateCurve("bias", (name,), (Ripple(period),), largest, 2, log_p, cost)


def _spacing(at: Array) -> float:
    """Mean distance of the places at which there are readings; those of a cell are one."""
    known = known_values(at)
    cell = SHORTEST_CM / CELLS_PER_PERIOD
    return float(np.ptp(known)) / max(np.unique(np.rint(known / cell)).size - 1, 1) if known.size else np.inf


def _periodogram(at: Array, score: Array, span: float, shortest: float) -> tuple[Array, float]:
    """Power at whole multiples of a step of frequency, up to that of the shortest period, and the step."""
    cell = shortest / CELLS_PER_PERIOD
    size = int(np.ceil(OVERSAMPLED * span / cell)) + 2
    left = np.floor(at / cell).astype(np.intp)
    share = at / cell - left
    cells = np.bincount(left, score * (1.0 - share), size) + np.bincount(left + 1, score * share, size)
    step = 1.0 / (size * cell)
    power: Array = np.abs(np.fft.rfft(cells)) ** 2
    return power[: int(1.0 / (shortest * step)) + 1], step


def _over_neighbours(power: Array) -> tuple[Array, int]:
    """Power over that of its neighbours below or above, whichever is larger, and how many of those are independent.

    A slow wander has the more power the lower the frequency, so a mean over both sides would be too small.
    """
    apart = OVERSAMPLED + OVERSAMPLED // 2
    # The lowest frequency is that of an offset and a slope.
    known = np.where(np.arange(power.size) < OVERSAMPLED, np.nan, power)
    below = _level(known, apart)
    above = _level(known[::-1], apart)[::-1]
    degrees = min(rules.RIPPLE_NEIGHBOURS, (power.size - 2 * apart) // OVERSAMPLED)
    return power / np.maximum(np.maximum(below, above), 1e-300), degrees


def _level(power: Array, apart: int) -> Array:
    """Mean power of independent frequencies below each, without those that another ripple raises; 0 without any."""
    reach = OVERSAMPLED * np.arange(rules.RIPPLE_NEIGHBOURS) + apart
    place = np.arange(power.size)[:, None] - reach
    near = np.sort(np.where(place >= 0, power[np.maximum(place, 0)], np.nan), axis=1)
    count = np.isfinite(near).sum(axis=1)
    kept = np.ceil((1.0 - TRIMMED) * count)
    lower = np.where(np.arange(near.shape[1]) < kept[:, None], np.nan_to_num(near), 0.0)
    level: Array = lower.sum(axis=1) / np.maximum(kept, 1.0) / TRIMMED_MEAN
    return level


def _sharpened(at: Array, score: Array, frequency: float, step: float) -> float:
    """The period of the largest power within a step of a frequency."""
    near = frequency + step * np.linspace(-1.0, 1.0, 21)
    power = [abs(np.exp(-2j * np.pi * each * at) @ score) for each in near]
    return float(f"{1.0 / near[int(np.argmax(power))]:.4g}")
