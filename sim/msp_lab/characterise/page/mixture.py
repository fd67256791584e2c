"""Pictures of the fitted mixture: its four densities, all of them together, and how well they fit."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from msp_lab.characterise.findings import Mixture
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.text import interval
from msp_lab.characterise.points import PointReadings
from msp_lab.estimates import wilson
from msp_lab.mixture_fit.parameters import KINDS
from msp_lab.readings.resolution import to_step
from msp_range.arrays import Array, Flags, Indices
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import (
    DOTS,
    GREEN,
    INK,
    ORANGE,
    OURS,
    PURPLE,
    REFERENCE,
    draw_pit_bars,
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
SINGLE_CM = 25.0
"""This near to the expected reading each centimetre is shown by itself [cm]."""


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
    total: Array
    """Probability of each reading by the whole model, codes in it, shape (k,)."""
    codes: list[float]
    """Readings that are codes for no echo [cm]."""
    counts: Array
    """How often each was read, shape (k,)."""

    @property
    def parts(self) -> dict[str, Array]:
        """By kind: probability of each reading of this kind, of all readings."""
        return {kind: self.weight[kind] * self.density[kind] for kind in KINDS}

    def bulk(self, share_of_peak: float) -> Indices:
        """Places of the readings of which the probability by the hits is more than this share of the peak's."""
        return np.flatnonzero(self.density["hit"] > share_of_peak * np.max(self.density["hit"]))


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
    here = [each for each in set_ups if each.condition == condition and math.isclose(each.true_range_cm, true_cm)]
    apparent_cm = mean_cm + sum(each.error_cm for each in here) / max(len(here), 1)
    # Drawn, and counted, in whole centimetres, whatever the step of the model.
    whole = replace(ReadingModel.of(rows.model), resolution_cm=1.0, minimum_cm=minimum_cm, maximum_cm=maximum_cm)
    at_each = [_probabilities(whole, k, apparent_cm + step_cm) for step_cm in steps_cm]
    *by_each_kind, total = np.average(at_each, axis=0, weights=rows_at)
    by_kind = dict(zip(KINDS, by_each_kind, strict=True))
    # The model knows whole centimetres within the sensor's limits, and so do the counts.
    readings = to_step(reading_cm, 1.0)
    readings = readings[(readings >= minimum_cm) & (readings <= maximum_cm)].astype(int) - minimum_cm
    garbled = rows.model.reading_model.saturated_fraction > 0.0
    return Densities(
        true_range_cm=float(np.sum(k * by_kind["hit"])),
        reading_cm=k,
        density=by_kind,
        weight=dict(zip(KINDS, whole.shares(apparent_cm), strict=True)),
        total=total,
        codes=[rows.model.maximum_cm, *([SATURATED_CM] if garbled else [])],
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
    """Probability of each reading by each kind alone, and by all of the mixture, at a range."""
    mixture = whole.rows(np.full(k.size, apparent_cm))
    hit, short, _, random = mixture.kinds(k, k)
    # The garbled code is drawn with the mass that it comes from.
    missed = np.exp(replace(mixture, log_weights=(-np.inf, -np.inf, 0.0, -np.inf)).log_prob(k))
    return [hit.p, short.p, missed, random.p, np.exp(mixture.log_prob(k))]


def density(rows: PictureData, kind: str) -> Drawn:
    """Draw the density of a kind of reading, with what was read."""
    caption = _fitted(rows.needed(rows.findings.mixture, "mixture"), kind)
    fitted = densities(rows)
    figure, axes = new_axes(3.2, "reading [cm]", "probability of a centimetre")
    k, p = fitted.reading_cm, fitted.density[kind]
    bulk = fitted.bulk(1e-7)
    shown = fitted.bulk(1e-5) if kind == "hit" else np.flatnonzero(p)
    if kind == "missed":
        _draw_missed(axes, fitted)
    else:
        axes.fill_between(k[shown], 0.0, p[shown], step="mid", **shaded(_KINDS[kind].colour))
        axes.step(k[shown], p[shown], where="mid", color=_KINDS[kind].colour, label="fitted, if it is of this kind")
    if kind == "hit":
        _dots(axes, fitted, shown[:, None], "share read, and its 95 % interval", of=shown)
    elif kind == "short":
        # Nothing else can be distinguished from the hits where they begin.
        _binned(axes, fitted, kind, slice(1, bulk[0]))
        axes.set_xlim(0.0, (0.5 + fitted.true_range_cm) * 1.06)
    elif kind == "random":
        # Beyond the hits only random readings and codes are left.
        _binned(axes, fitted, kind, slice(bulk[-1] + 1, -1))
        for edge, side, x in ((k[0], "right", -4), (k[-1], "left", 4)):
            label(axes, f"{edge:g} cm", (edge, 0.0), (x, 4), ha=side)
        axes.set_xlim(min(0.0, k[0] - 0.08 * k[-1]), k[-1] * 1.08)
        axes.margins(y=0.25)
    if kind in ("short", "random") and fitted.weight[kind] < NO_WEIGHT:
        rate = ",\nand its rate is the starting model's" if kind == "short" else ""
        note(axes, f"weight 0: no reading was found to be of this kind{rate}", y=0.9)
    axes.axvline(fitted.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter("{x:.3g}")
    axes.grid(axis="x", visible=False)
    return figure, f"{caption} {_KINDS[kind].remark.format(k[0])}".strip()


def _fitted(mixture: Mixture, kind: str) -> str:
    """The parameters of a kind, in a sentence."""
    found = {parameter.name: parameter for parameter in mixture.parameters}
    shown = [
        f"{name} = {interval(found[name].fitted)}{' (at its bound)' if found[name].at_bound else ''}"
        for name in _KINDS[kind].parameters
        if name in found
    ]
    return f"Fitted: {'; '.join(shown)}." if shown else ""


def _draw_missed(axes: Axes, fitted: Densities) -> None:
    """Maximum range (5.5): the mass at the code, which a sensor may garble into a second one."""
    k, places = fitted.reading_cm, np.flatnonzero(np.isin(fitted.reading_cm, fitted.codes))
    percent = 100.0 * fitted.total[places]
    axes.set_ylabel("share of all readings [%]")
    axes.bar(k[places], percent, width=14.0, color=_KINDS["missed"].colour, alpha=0.5, label="fitted mass")
    _dots(axes, fitted, places[:, None], "read, and its 95 % interval", 100.0, omits_none=False)
    for place, height in zip(places, percent, strict=True):
        words = f"{k[place]:g} cm\nfitted {height:.2f} %"
        if np.any(fitted.counts):
            words += f"\nread {100.0 * fitted.counts[place] / np.sum(fitted.counts):.2f} %"
        side, ha = (-1, "right") if k[place] > 0.85 * k[-1] else (1, "left")
        label(axes, words, (k[place], height), (14 * side, 2), va="bottom", ha=ha)
    axes.set_xlim(0.0, k[-1] * 1.06)
    axes.margins(y=0.3)


def _binned(axes: Axes, fitted: Densities, kind: str, where: slice) -> None:
    """What was read in a stretch, in broad bins, as the density of one kind.

    The readings of a kind cannot be identified one by one: a bin's count is multiplied by the share of the kind in it,
    by the fitted model, and the codes are left out.
    """
    parts, weight = fitted.parts, fitted.weight[kind]
    places = np.arange(fitted.reading_cm.size)[where]
    places = places[parts["missed"][places] == 0.0]
    if places.size < 2 or weight < NO_WEIGHT:
        return
    of_all = np.sum(list(parts.values()), axis=0)
    bins = [
        cells for cells in np.array_split(places, max(min(places.size // 20, 16), 1)) if np.sum(of_all[cells]) > 0.0
    ]
    scales = [np.sum(parts[kind][cells]) / np.sum(of_all[cells]) / (weight * cells.size) for cells in bins]
    _dots(axes, fitted, bins, "read, in bins, times the model's share of this kind", scales, omits_none=False)


def _dots(
    axes: Axes,
    fitted: Densities,
    bins: Iterable[Indices],
    words: str,
    scale: ArrayLike = 1.0,
    *,
    of: Indices | slice = slice(None),
    omits_none: bool = True,
) -> None:
    """Shares of the readings in bins times a scale, each with its interval.

    The readings are those ``of`` some centimetres; bins without any may be omitted.
    """
    total, pairs = np.sum(fitted.counts[of]), []
    if not total:
        return
    for cells in bins:
        count = np.sum(fitted.counts[cells])
        pairs.append((np.mean(fitted.reading_cm[cells]), count / total, *wilson(count, total)))
    k, *shares = np.array(pairs).reshape(-1, 4).T
    share, low, high = np.array(shares) * np.asarray(scale)
    shown = (share > 0.0) | (not omits_none)
    reach = np.array([share - low, high - share])
    axes.errorbar(k[shown], share[shown], reach[:, shown], label=words, **DOTS)


def _whole_mixture(rows: PictureData) -> Drawn:
    """All four densities together on a logarithmic scale, with what was read."""
    found, fitted = rows.needed(rows.findings.mixture, "mixture"), densities(rows)
    figure, axes = new_axes(4.2, "reading [cm]", "probability of a centimetre")
    k, parts = fitted.reading_cm, fitted.parts
    is_code = np.isin(k, fitted.codes)
    plain = np.concatenate([p[~is_code & (p > 0.0)] for p in (parts["short"], parts["random"])])
    least = 0.2 * np.min(plain) if plain.size else 1e-7
    bins = _fine_and_broad((np.abs(k - fitted.true_range_cm) <= SINGLE_CM) | is_code)
    words = f"read ({np.sum(fitted.counts):,.0f} readings)"
    _dots(axes, fitted, bins, words, [1.0 / cells.size for cells in bins])
    for kind, p in parts.items():
        look: dict[str, Any] = {"color": _KINDS[kind].colour, "label": f"{kind}, weight {fitted.weight[kind]:.3g}"}
        if kind == "missed":
            axes.vlines(k[p > least], least, p[p > least], linewidth=5, alpha=0.6, **look)
        else:
            axes.plot(k, np.where((p > least) & ~is_code, p, np.nan), _KINDS[kind].dashes, **look)
    axes.plot(k, np.where(is_code, np.nan, fitted.total), color=INK, linewidth=0.8, label="all together")
    axes.set_yscale("log")
    axes.set_ylim(least, 2.0)
    axes.set_xlim(0.0, k[-1] * 1.03)
    return figure, (
        f"The fitted mixture at {fitted.true_range_cm:.0f} cm and what was read there. Fitted to "
        f"{found.readings:,} readings. {sentence(found.conditional)}"
    )


def _fine_and_broad(single: Flags) -> list[Indices]:
    """Bins of one centimetre where it is single, elsewhere of some 25, in which few readings look like few."""
    stretches = np.split(np.arange(single.size), np.flatnonzero(np.diff(single.astype(int))) + 1)
    parts = [stretch.size if single[stretch[0]] else max(stretch.size // 25, 1) for stretch in stretches]
    return [cells for stretch, count in zip(stretches, parts, strict=True) for cells in np.array_split(stretch, count)]


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
