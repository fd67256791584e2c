"""Pictures of the fitted mixture: its four densities, all of them together, how well they fit; and its parameters."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from msp_lab.characterise.findings import Findings, Mixture
from msp_lab.characterise.page.draw.mixture import (
    KINDS,
    Densities,
    draw_hit,
    draw_missed,
    draw_mixture,
    draw_pit,
    draw_random,
    draw_short,
)
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData, needed, placement_error_cm
from msp_lab.characterise.page.text import interval, sentence
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.page.page import PageTable
from msp_sim.page.style import p_text

_MIXTURE_PARAMETERS = {
    "hit": ("weights.hit", "sigma_cm", "sigma_growth_cm_per_m"),
    "short": ("weights.short", "short_rate_per_m"),
    "missed": ("weights.missed", "saturated_fraction", "missed_growth_per_m"),
    "random": ("weights.random",),
}
"""Kind of reading -> its parameters, by their names in the sensor model file."""

_SYMBOLS = {
    "weights.hit": "z_hit",
    "weights.short": "z_short",
    "weights.missed": "z_max",
    "weights.random": "z_rand",
    "sigma_cm": "σ_hit",
    "short_rate_per_m": "λ_short",
}
"""Parameter -> its symbol in Probabilistic Robotics (Thrun, Burgard & Fox 2005, section 6.3)."""


def entries() -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    for kind, title in (
        ("hit", "Hits: density of the measurement noise"),
        ("short", "Short readings: density of what is nearer than the surface"),
        ("missed", "Missed echoes: the sensor's codes"),
        ("random", "Random readings: density"),
    ):
        yield f"density_{kind}", title, partial(density, kind=kind)
    yield "mixture", "The fitted mixture, all four densities", _whole_mixture
    yield "pit", "Goodness of fit: probability integral transform", _pit


def densities(findings: Findings, rows: PictureData) -> tuple[Densities, Array]:
    """The fitted mixture at one range, and the probability of each reading by all of it."""
    condition, true_cm = _one_range(rows)
    chosen = rows.of(condition) & (rows.true_cm == true_cm)
    minimum_cm, maximum_cm = math.floor(rows.model.minimum_cm), math.ceil(rows.model.maximum_cm)
    k = np.arange(float(minimum_cm), maximum_cm + 1.0)
    # About the ranges that the fit took the rows to be at, which differ with the air's temperature.
    mean_cm = float(np.mean(rows.apparent_cm[chosen]))
    steps_cm, rows_at = np.unique(np.round(rows.apparent_cm[chosen] - mean_cm, 1), return_counts=True)
    apparent_cm = mean_cm + placement_error_cm(findings, condition, true_cm)
    # Drawn, and counted, in whole centimetres, whatever the step of the model.
    whole = replace(ReadingModel.of(rows.model), resolution_cm=1.0, minimum_cm=minimum_cm, maximum_cm=maximum_cm)
    at_each = [_probabilities(whole, k, apparent_cm + step_cm) for step_cm in steps_cm.tolist()]
    *by_each_kind, total = np.average(at_each, axis=0, weights=rows_at)
    by_kind = dict(zip(KINDS, by_each_kind, strict=True))
    # The model knows whole centimetres within the sensor's limits, and so do the counts.
    readings = to_step(rows.reading_cm[chosen], 1.0)
    readings = readings[(readings >= minimum_cm) & (readings <= maximum_cm)].astype(int) - minimum_cm
    counts = np.bincount(readings, minlength=k.size).astype(np.float64)
    peak_cm = float(np.sum(k * by_kind["hit"]))
    fitted = Densities(
        true_range_cm=peak_cm,
        reading_cm=k,
        density=by_kind,
        weight={kind: float(share) for kind, share in zip(KINDS, whole.shares(apparent_cm), strict=True)},
        counts=counts if readings.size else None,
    )
    return fitted, total


def _probabilities(whole: ReadingModel, k: Array, apparent_cm: float) -> list[Array]:
    """Probability of each reading by each kind alone, and by all of the mixture, at a range."""
    contexts = {"true_range_cm": np.full(k.size, apparent_cm)}
    mixture = whole.rows(contexts["true_range_cm"])
    hit, short, _, random = mixture.kinds(k, k)
    # The garbled code is drawn with the mass that it comes from.
    missed = np.exp(replace(mixture, log_weights=(-np.inf, -np.inf, 0.0, -np.inf)).log_prob(k))
    return [hit.p, short.p, missed, random.p, np.exp(whole.log_prob(k, contexts))]


def _one_range(rows: PictureData) -> tuple[str, float]:
    """Condition and true range: most readings of the maximum range, else a middle one of the baseline."""
    condition = "maximum_range"
    try:
        found = rows.of(condition)
    except Absent:
        condition = "baseline"
        found = rows.of(condition)
    ranges, counts = np.unique(rows.true_cm[found], return_counts=True)
    much = ranges[counts >= 0.5 * np.max(counts)]
    return condition, float(much[much.size // 2])


def density(findings: Findings, rows: PictureData, kind: str) -> Drawn:
    """Draw the density of a kind of reading."""
    caption = _parameters(needed(findings.mixture, findings, "mixture"), kind)
    fitted, total = densities(findings, rows)
    if kind == "hit":
        figure = draw_hit(fitted)
        caption += " The probability of a reading is the integral over its centimetre."
    elif kind == "short":
        figure = draw_short(fitted)
        caption += " It ends at the expected range and is normalised up to there."
    elif kind == "missed":
        codes = _codes(rows)
        figure = draw_missed(fitted, {code: float(total[fitted.reading_cm == code][0]) for code in codes})
        caption += " A point mass, since a missed echo is a code."
    else:
        figure = draw_random(fitted)
        caption += f" It begins at the {rows.model.minimum_cm} cm under which the sensor reports nothing."
    return Drawn(figure, caption, f"The fitted density of {kind} readings, with what was read.")


def _codes(rows: PictureData) -> list[float]:
    """Readings that mean no echo [cm]."""
    garbled = rows.model.reading_model.saturated_fraction > 0.0
    return [float(rows.model.maximum_cm), *([float(SATURATED_CM)] if garbled else [])]


def _whole_mixture(findings: Findings, rows: PictureData) -> Drawn:
    """All four densities together."""
    found = needed(findings.mixture, findings, "mixture")
    fitted, total = densities(findings, rows)
    caption = (
        f"The fitted mixture at {fitted.true_range_cm:.0f} cm and what was read there. Fitted to "
        f"{found.readings:,} readings. {sentence(found.conditional)}"
    )
    return Drawn(
        draw_mixture(fitted, total, _codes(rows)), caption, "Probability of each centimetre by the fitted mixture."
    )


def _pit(findings: Findings, rows: PictureData) -> Drawn:
    found = needed(findings.mixture, findings, "mixture")
    if found.pit_p_value is None:
        raise Absent("There are too few readings for a goodness of fit.")
    caption = (
        "Where the model is right the bars are level. A slope is a bias, a bowl too small a spread, a hump too large a "
        f"one. Of uniform, p: {p_text(found.pit_p_value)}, over {found.readings:,} readings."
    )
    return Drawn(draw_pit(np.array(found.pit_counts, dtype=np.float64), found.pit_p_value), caption, "PIT histogram.")


def mixture_table(mixture: Mixture) -> PageTable:
    """Return the fitted parameters with intervals, and the starting model's values, as a table."""
    return PageTable(
        name="mixture_parameters",
        title="Parameters of the mixture",
        header=("parameter", "Thrun", "fitted, 95 % interval", "before"),
        rows=tuple(
            (
                each.name,
                _SYMBOLS.get(each.name, "–"),
                interval(each.fitted) + (" at its bound" if each.at_bound else ""),
                "–" if each.before is None else f"{each.before:.4g}",
            )
            for each in mixture.parameters
        ),
        caption=" ".join(
            [
                f"Maximum likelihood from {mixture.readings:,} readings, names as in the sensor model file.",
                *map(sentence, mixture.notes),
            ]
        ),
    )


def _parameters(mixture: Mixture, kind: str) -> str:
    found = {each.name: each.fitted for each in mixture.parameters}
    at_bound = {each.name for each in mixture.parameters if each.at_bound}
    shown = [
        f"{name} = {interval(found[name])}{' (at its bound)' if name in at_bound else ''}"
        for name in _MIXTURE_PARAMETERS[kind]
        if name in found
    ]
    return f"Fitted: {'; '.join(shown)}." if shown else ""
