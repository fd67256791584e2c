"""Pictures of the fitted mixture: its four densities, all of them together, and how well they fit."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes

from msp_lab.characterise.findings import Mixture
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.text import interval
from msp_lab.characterise.points import PointReadings
from msp_lab.estimates import wilson
from msp_lab.mixture_fit.parameters import KINDS
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array, Indices
from msp_range.reading_model.mixture import ReadingModel
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import (
    GREEN,
    INK,
    ORANGE,
    OURS,
    PURPLE,
    REFERENCE,
    draw_pit_bars,
    intervals,
    label,
    new_axes,
    note,
    shaded,
)
from msp_sim.page.text import p_text, sentence


class _Kind(NamedTuple):
    """How a kind of readings is drawn, and its parameters by their names in the sensor model file."""

    title: str
    colour: str
    dashes: str
    remark: str
    parameters: tuple[str, ...]


_KINDS = {
    "hit": _Kind(
        "Hits: density of the measurement noise",
        OURS,
        "-",
        "The probability of a reading is the integral over its centimetre.",
        ("weights.hit", "sigma_cm", "sigma_growth_cm_per_m"),
    ),
    "short": _Kind(
        "Short readings: density of what is nearer than the surface",
        ORANGE,
        "--",
        "It ends at the expected range and is normalised up to there.",
        ("weights.short", "short_rate_per_m"),
    ),
    "missed": _Kind(
        "Missed echoes: the sensor's codes",
        PURPLE,
        "-",
        "A point mass, since a missed echo is a code.",
        ("weights.missed", "saturated_fraction", "missed_growth_per_m"),
    ),
    "random": _Kind(
        "Random readings: density",
        GREEN,
        "-.",
        "It begins at the {:g} cm under which the sensor reports nothing.",
        ("weights.random",),
    ),
}
NO_WEIGHT = 1e-7
"""A smaller weight is that of a kind that was not seen."""
LEAST_SHARE = 0.01
"""Readings of a bin in which a kind has a smaller share, by the model, say nothing of the kind."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    for kind, look in _KINDS.items():
        yield f"density_{kind}", look.title, partial(density, rows, kind)
    yield "mixture", "The fitted mixture, all four densities", partial(_whole_mixture, rows)
    yield "pit", "Goodness of fit: probability integral transform", partial(_pit, rows)


@dataclass(frozen=True)
class Densities:
    """Probabilities of each whole centimetre at one range by the fitted model, and what was read."""

    true_range_cm: float
    """The true range that they are for, in the centimetres that the sensor reads: after calibration and air [cm]."""
    reading_cm: Array
    """Readings that the sensor can report, shape (k,)."""
    density: dict[str, Array]
    """By kind: probability of each reading if the reading is of this kind, shape (k,); its sum is 1."""
    weight: dict[str, float]
    """By kind: share of the readings."""
    counts: Array
    """How often each was read, shape (k,)."""

    @property
    def parts(self) -> dict[str, Array]:
        """By kind: probability of each reading of this kind, of all readings."""
        return {kind: self.weight[kind] * self.density[kind] for kind in KINDS}

    @property
    def bins(self) -> list[Indices]:
        """Places of each centimetre with hits or codes, elsewhere of some 25, in which few readings look like few."""
        hit = self.density["hit"]
        single = (hit > 1e-7 * np.max(hit)) | (self.density["missed"] > 0.0)
        stretches = np.split(np.arange(single.size), np.flatnonzero(np.diff(single)) + 1)
        parts = [np.array_split(each, each.size if single[each[0]] else max(each.size // 25, 1)) for each in stretches]
        return [cells for part in parts for cells in part]

    @property
    def total(self) -> Array:
        """Probability of each reading by the whole model, codes in it, shape (k,)."""
        total: Array = np.sum(list(self.parts.values()), axis=0)
        return total


def densities(rows: PictureData) -> Densities:
    """The fitted mixture at the range with most readings."""
    points, true_cm = _one_range(rows)
    minimum_cm, maximum_cm = math.floor(rows.model.minimum_cm), math.ceil(rows.model.maximum_cm)
    k = np.arange(minimum_cm, maximum_cm + 1.0)
    # About the ranges that the fit took the rows to be at, which differ with the air's temperature.
    at_cm, reading_cm = np.concatenate(
        [np.array([point.apparent_cm, point.reading_cm])[:, point.true_range_cm == true_cm] for point in points], axis=1
    )
    mean_cm = np.mean(at_cm)
    steps_cm, rows_at = np.unique(np.round(at_cm - mean_cm, 1), return_counts=True)
    set_ups = () if rows.findings.mixture is None else rows.findings.mixture.set_ups
    condition = points[0].condition
    here = [
        set_up for set_up in set_ups if set_up.condition == condition and math.isclose(set_up.true_range_cm, true_cm)
    ]
    apparent_cm = mean_cm + sum(set_up.error_cm for set_up in here) / max(len(here), 1)
    # Drawn, and counted, in whole centimetres, whatever the step of the model.
    whole = replace(ReadingModel.of(rows.model), resolution_cm=1.0, minimum_cm=minimum_cm, maximum_cm=maximum_cm)
    at_each = [_probabilities(whole, k, apparent_cm + step_cm) for step_cm in steps_cm]
    by_kind = dict(zip(KINDS, np.average(at_each, axis=0, weights=rows_at), strict=True))
    # The model knows whole centimetres within the sensor's limits, and so do the counts.
    readings = to_step(reading_cm, 1.0)
    readings = readings[(readings >= minimum_cm) & (readings <= maximum_cm)].astype(int) - minimum_cm
    return Densities(
        true_range_cm=float(np.sum(k * by_kind["hit"])),
        reading_cm=k,
        density=by_kind,
        weight=dict(zip(KINDS, whole.shares(apparent_cm), strict=True)),
        counts=np.bincount(readings, minlength=k.size).astype(np.float64),
    )


def longest_range_cm(points: Sequence[PointReadings]) -> float:
    """True range with most readings of these points; the longest of equal ones [cm]."""
    ranges, counts = _ranges(points)
    return float(ranges[np.lexsort((ranges, counts))[-1]])


def _one_range(rows: PictureData) -> tuple[list[PointReadings], float]:
    """Points and a true range of theirs: the longest range, else a middle one of the baseline."""
    try:
        points = rows.of("maximum_range")
        return points, longest_range_cm(points)
    except Absent:
        points = rows.of("baseline")
    ranges, counts = _ranges(points)
    much = ranges[counts >= 0.5 * np.max(counts)]
    return points, float(much[much.size // 2])


def _ranges(points: Sequence[PointReadings]) -> tuple[Array, Indices]:
    """True ranges, and how many readings there are at each."""
    return np.unique(np.concatenate([point.true_range_cm for point in points]), return_counts=True)


def _probabilities(whole: ReadingModel, k: Array, apparent_cm: float) -> list[Array]:
    """Probability of each reading by each kind alone, at a range."""
    mixture = whole.rows(np.full(k.size, apparent_cm))
    hit, short, _, random = mixture.kinds(k, k)
    # The garbled code is drawn with the mass that it comes from.
    missed = np.exp(replace(mixture, log_weights=(-np.inf, -np.inf, 0.0, -np.inf)).log_prob(k))
    return [hit.p, short.p, missed, random.p]


def density(rows: PictureData, kind: str) -> Drawn:
    """Draw the density of a kind of reading, with what was read."""
    caption = _fitted(rows.needed(rows.findings.mixture, "mixture"), kind)
    fitted, look = densities(rows), _KINDS[kind]
    figure, axes = new_axes(3.2, "reading [cm]", "probability of a centimetre")
    k, p = fitted.reading_cm, fitted.density[kind]
    axes.fill_between(k, 0.0, p, step="mid", **shaded(look.colour))
    axes.step(k, p, where="mid", color=look.colour, label="fitted, if it is of this kind")
    axes.axvline(fitted.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    shown = np.flatnonzero(p > 1e-5 * np.max(p))
    if fitted.weight[kind] < NO_WEIGHT:
        rate = ",\nand its rate is the starting model's" if kind == "short" else ""
        note(axes, f"weight 0: no reading was found to be of this kind{rate}", y=0.9)
    else:
        # Readings of a kind cannot be identified one by one: a count is multiplied by the share of the kind in it.
        part, total = fitted.parts[kind], fitted.total
        bins = [cells for cells in fitted.bins if (cells.size > 1) == (kind in ("short", "random"))]
        shares = [(cells, np.sum(part[cells]) / np.sum(total[cells])) for cells in bins]
        scaled = [(cells, share / fitted.weight[kind]) for cells, share in shares if share > LEAST_SHARE]
        _dots(axes, fitted, scaled, "read, times the model's share of this kind")
    if kind == "missed":
        read = 100.0 * fitted.counts / max(np.sum(fitted.counts), 1.0)
        for at in shown:
            words = f"{k[at]:g} cm\nfitted {100.0 * fitted.total[at]:.2f} %\nread {read[at]:.2f} % of all"
            side, ha = (-1, "right") if k[at] > 0.85 * k[-1] else (1, "left")
            label(axes, words, (k[at], p[at]), (14 * side, 2), va="top", ha=ha)
    axes.set_xlim((k[shown[0]] - 1.0, k[shown[-1]] + 1.0) if kind == "hit" else (0.0, 1.06 * k[shown[-1]]))
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter("{x:.3g}")
    return figure, f"{caption} {look.remark.format(k[0])}".strip()


def _fitted(mixture: Mixture, kind: str) -> str:
    """The parameters of a kind, in a sentence."""
    found = {parameter.name: parameter for parameter in mixture.parameters}
    shown = [
        f"{name} = {interval(found[name].fitted)}{' (at its bound)' if found[name].at_bound else ''}"
        for name in _KINDS[kind].parameters
        if name in found
    ]
    return f"Fitted: {'; '.join(shown)}." if shown else ""


def _dots(axes: Axes, fitted: Densities, bins: Sequence[tuple[Indices, float]], words: str) -> None:
    """Share of the readings in each bin by centimetre, times its scale, with its interval."""
    total = np.sum(fitted.counts)
    for cells, scale in bins if total else ():
        share, ends = np.sum(fitted.counts[cells]) / total, wilson(np.sum(fitted.counts[cells]), total)
        per_cm = scale / cells.size
        intervals(axes, np.mean(fitted.reading_cm[cells]), share * per_cm, np.array(ends) * per_cm, label=words)


def _whole_mixture(rows: PictureData) -> Drawn:
    """All four densities together on a logarithmic scale, with what was read."""
    found, fitted = rows.needed(rows.findings.mixture, "mixture"), densities(rows)
    figure, axes = new_axes(4.2, "reading [cm]", "probability of a centimetre")
    k, parts = fitted.reading_cm, fitted.parts
    is_code = fitted.density["missed"] > 0.0
    plain = np.concatenate([p[~is_code & (p > 0.0)] for p in (parts["short"], parts["random"])])
    least = 0.2 * np.min(plain) if plain.size else 1e-7
    read = [(cells, 1.0) for cells in fitted.bins if np.any(fitted.counts[cells])]
    _dots(axes, fitted, read, f"read ({np.sum(fitted.counts):,.0f} readings)")
    for kind, p in parts.items():
        colour, words = _KINDS[kind].colour, f"{kind}, weight {fitted.weight[kind]:.3g}"
        if kind == "missed":
            axes.vlines(k[p > least], least, p[p > least], linewidth=5, alpha=0.6, color=colour, label=words)
        else:
            line = np.where((p > least) & ~is_code, p, np.nan)
            axes.plot(k, line, _KINDS[kind].dashes, color=colour, label=words)
    axes.plot(k, np.where(is_code, np.nan, fitted.total), color=INK, linewidth=0.8, label="all together")
    axes.set(yscale="log", ylim=(least, 2.0), xlim=(0.0, k[-1] * 1.03))
    return figure, (
        f"The fitted mixture at {fitted.true_range_cm:.0f} cm and what was read there. Fitted to "
        f"{found.readings:,} readings. {sentence(found.conditional)}"
    )


def _pit(rows: PictureData) -> Drawn:
    """Histogram of the randomised PIT over equal bins of [0, 1]: flat where the model fits."""
    found = rows.needed(rows.findings.mixture, "mixture")
    if found.pit_p_value is None:
        raise Absent("There are too few readings for a goodness of fit.")
    words = "probability that the fitted model gives to a smaller reading (randomised within a centimetre)"
    figure, axes = new_axes(3.2, words)
    draw_pit_bars(axes, found.pit_counts)
    note(axes, f"p of uniform: {p_text(found.pit_p_value)}")
    return figure, (
        "Where the model is right the bars are level. A slope is a bias, a bowl too small a spread, a hump too large a "
        f"one. Of uniform, p: {p_text(found.pit_p_value)}, over {found.readings:,} readings."
    )
