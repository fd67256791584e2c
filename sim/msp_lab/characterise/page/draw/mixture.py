"""The four densities of the mixture as fitted, all of them together, and how well they fit."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import ArrayLike
from scipy.stats import binom

from msp_lab.characterise.estimates import wilson
from msp_range.arrays import Array, Flags
from msp_sim.page.style import (
    DOTS,
    GREEN,
    INK,
    ORANGE,
    OURS,
    PURPLE,
    REFERENCE,
    legend_below,
    new_figure,
    note,
    p_text,
    signed,
)

KINDS = ("hit", "short", "missed", "random")

_LOOKS = {"hit": (OURS, "-"), "short": (ORANGE, "--"), "missed": (PURPLE, "-"), "random": (GREEN, "-.")}

NO_WEIGHT = 1e-7
"""A smaller weight is that of a kind that was not seen."""

SINGLE_CM = 25.0
"""This near to the expected reading each centimetre is shown by itself [cm]."""


@dataclass(frozen=True)
class Densities:
    """Probabilities of each whole centimetre by each kind of reading, and what was read."""

    true_range_cm: float
    """The true range that they are for, in the centimetres that the sensor reads: after calibration and air [cm]."""
    reading_cm: Array
    """Readings that the sensor can report, shape (k,)."""
    density: dict[str, Array]
    """By kind: probability of each reading if the reading is of this kind, shape (k,); its sum is 1."""
    weight: dict[str, float]
    """By kind: share of the readings."""
    counts: Array | None
    """How often each was read at this range, shape (k,); None: there are no readings at one range."""


def draw_hit(densities: Densities) -> Figure:
    """The hits: the Gaussian's probability of each centimetre, next to the share that was read."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["hit"]
    shown = _bulk(p, 1e-5)
    axes.bar(k[shown], p[shown], width=0.9, color=OURS, alpha=0.45, label="fitted: integral over each centimetre")
    if densities.counts is not None:
        near = densities.counts[shown]
        _dots(axes, k[shown], near, float(np.sum(near)), "share read, and its 95 % interval", omits_none=True)
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return _finish(figure, axes, densities)


def draw_short(densities: Densities) -> Figure:
    """Unexpected obstacles (5.4): the exponential that ends at the expected range."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["short"]
    inside = k <= densities.true_range_cm + 0.5
    _curve(axes, k[inside], p[inside], ORANGE, 0.35)
    # Nothing else can be distinguished from the hits where they begin.
    hits = _bulk(densities.density["hit"], 1e-7)
    _binned(axes, densities, (k < k[hits][0]) & (k > k[0]), "short")
    if densities.weight["short"] < NO_WEIGHT:
        note(axes, "weight 0: no reading was found to be of this kind,\nand its rate is the starting model's")
    axes.set_xlim(0.0, (0.5 + densities.true_range_cm) * 1.06)
    return _finish(figure, axes, densities)


def draw_missed(densities: Densities, codes: dict[float, float]) -> Figure:
    """Maximum range (5.5): the mass at the code, which a sensor may garble into a second one.

    Parameters
    ----------
    densities
        Of the fitted model.
    codes
        Code [cm] -> probability of reading it, by the fitted model, of all readings.
    """
    figure, axes = _axes()
    k = densities.reading_cm
    values = list(codes)
    total = 0.0 if densities.counts is None else float(np.sum(densities.counts))
    axes.bar(
        values, [100.0 * codes[value] for value in values], width=14.0, color=PURPLE, alpha=0.5, label="fitted mass"
    )
    for value in values:
        words = f"{value:g} cm\nfitted {100.0 * codes[value]:.2f} %"
        if densities.counts is not None and total:
            count = float(np.sum(densities.counts[k == value]))
            label = "read, and its 95 % interval" if value == values[0] else None
            _dots(axes, [value], [count], total, label, 100.0)
            words += f"\nread {100.0 * count / total:.2f} %"
        side = -1 if value > 0.85 * k[-1] else 1
        axes.annotate(
            words,
            (value, 100.0 * codes[value]),
            xytext=(14 * side, 2),
            textcoords="offset points",
            fontsize=8,
            va="bottom",
            ha="right" if side < 0 else "left",
        )
    axes.set_xlim(0.0, float(k[-1]) * 1.06)
    axes.margins(y=0.3)
    return _finish(figure, axes, densities, "share of all readings [%]")


def draw_random(densities: Densities) -> Figure:
    """Random readings: the same for each centimetre that the sensor can report, from its minimum and not 0."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["random"]
    _curve(axes, k, p, GREEN, 0.3)
    # Beyond the hits only random readings and codes are left.
    hits = _bulk(densities.density["hit"], 1e-7)
    _binned(axes, densities, (k > k[hits][-1]) & (k < k[-1]), "random")
    if densities.weight["random"] < NO_WEIGHT:
        note(axes, "weight 0: no reading was found to be of this kind", y=0.9)
    for edge, side in ((k[0], "right"), (k[-1], "left")):
        axes.annotate(
            f"{edge:g} cm",
            (edge, 0.0),
            xytext=(-4 if side == "right" else 4, 4),
            textcoords="offset points",
            ha=side,
            fontsize=8,
        )
    axes.set_xlim(min(0.0, k[0] - 0.08 * k[-1]), float(k[-1]) * 1.08)
    axes.margins(y=0.25)
    return _finish(figure, axes, densities)


def draw_mixture(densities: Densities, total: Array, codes: Sequence[float]) -> Figure:
    """All four together on a logarithmic scale, with what was read.

    Parameters
    ----------
    densities
        Of the fitted model.
    total
        Probability of each reading by the whole model, codes in it, shape (k,).
    codes
        Readings that are codes for no echo [cm].
    """
    figure = new_figure(4.2)
    axes = figure.subplots()
    k = densities.reading_cm
    is_code = np.isin(k, codes)
    parts = {kind: densities.weight[kind] * densities.density[kind] for kind in KINDS}
    plain = np.concatenate([p[~is_code & (p > 0.0)] for kind, p in parts.items() if kind in ("random", "short")])
    least = 0.2 * float(np.min(plain)) if plain.size else 1e-7
    if densities.counts is not None:
        n = float(np.sum(densities.counts))
        single = (np.abs(k - densities.true_range_cm) <= SINGLE_CM) | is_code
        _dots(axes, k[single], densities.counts[single], n, f"read ({n:,.0f} readings)", omits_none=True)
        # Rare readings in bins: a single reading of a centimetre looks like more than it is.
        for stretch in np.split(np.arange(k.size), np.flatnonzero(np.diff(single.astype(int))) + 1):
            if single[stretch[0]]:
                continue
            for cells in np.array_split(stretch, max(stretch.size // 25, 1)):
                count = float(np.sum(densities.counts[cells]))
                _dots(axes, [k[cells].mean()], [count], n, None, 1.0 / cells.size, omits_none=True)
    for kind, p in parts.items():
        colour, dashes = _LOOKS[kind]
        label = f"{kind}, weight {densities.weight[kind]:.3g}"
        if kind == "missed":
            axes.vlines(k[p > least], least, p[p > least], color=colour, linewidth=5, alpha=0.6, label=label, zorder=3)
        else:
            axes.plot(k, np.where((p > least) & ~is_code, p, np.nan), dashes, color=colour, label=label, zorder=3)
    axes.plot(k, np.where(is_code, np.nan, total), color=INK, linewidth=0.8, label="all together", zorder=4)
    axes.set_yscale("log")
    axes.set_ylim(least, 2.0)
    axes.set_xlim(0.0, float(k[-1]) * 1.03)
    axes.set_xlabel("reading [cm]")
    axes.set_ylabel("probability of a centimetre")
    legend_below(figure)
    return figure


def draw_pit(counts: Array, p_value: float) -> Figure:
    """Histogram of the randomised PIT: flat where the model fits.

    Parameters
    ----------
    counts
        Readings in equal bins of [0, 1].
    p_value
        Of uniformity.
    """
    figure = new_figure(3.2)
    axes = figure.subplots()
    bins, n = counts.size, float(np.sum(counts))
    left = np.arange(bins) / bins
    low, high = 100.0 * (binom.ppf([0.025, 0.975], n, 1.0 / bins) / (n / bins) - 1.0)
    axes.axhspan(low, high, color=REFERENCE, alpha=0.15, linewidth=0, label="95 % of each bar if the model is right")
    axes.axhline(0.0, color=REFERENCE, linewidth=1.0)
    excess = 100.0 * (counts / (n / bins) - 1.0)
    axes.bar(
        left, excess, width=0.94 / bins, align="edge", color=OURS, alpha=0.75, label=f"{n:,.0f} readings", zorder=2
    )
    reach = max(float(np.max(np.abs(excess))), high) * 1.3
    axes.set_ylim(-reach, reach)
    axes.yaxis.set_major_formatter(signed)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("probability that the fitted model gives to a smaller reading (randomised within a centimetre)")
    axes.set_ylabel("readings more than expected [%]")
    axes.grid(axis="x", visible=False)
    note(axes, f"p of uniform: {p_text(p_value)}")
    legend_below(figure)
    return figure


def _axes() -> tuple[Figure, Axes]:
    figure = new_figure(3.2)
    return figure, figure.subplots()


def _finish(figure: Figure, axes: Axes, densities: Densities, label: str = "probability of a centimetre") -> Figure:
    axes.axvline(densities.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.set_xlabel("reading [cm]")
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter("{x:.3g}")
    axes.grid(axis="x", visible=False)
    legend_below(figure)
    return figure


def _curve(axes: Axes, reading_cm: Array, p: Array, colour: str, alpha: float) -> None:
    """Probabilities of centimetres as a line with the ground below it."""
    axes.fill_between(reading_cm, 0.0, p, step="mid", color=colour, alpha=alpha, linewidth=0)
    axes.step(reading_cm, p, where="mid", color=colour, label="fitted, if a reading is of this kind")


def _bulk(p: Array, share_of_peak: float) -> Flags:
    """Readings with a probability that is visible next to the peak's."""
    return np.asarray(p > share_of_peak * np.max(p))


def _dots(
    axes: Axes,
    reading_cm: ArrayLike,
    counts: ArrayLike,
    total: float,
    label: str | None,
    scale: float = 1.0,
    *,
    omits_none: bool = False,
) -> None:
    """Shares of the readings times a scale, each with its interval; those of which there are none may be omitted."""
    read = [(k, n) for k, n in zip(np.ravel(reading_cm), np.ravel(counts), strict=True) if n or not omits_none]
    shares = np.array([scale * n / total for _, n in read])
    low, high = scale * np.array([wilson(float(n), total) for _, n in read]).reshape(-1, 2).T
    axes.errorbar([k for k, _ in read], shares, yerr=[shares - low, high - shares], label=label, **DOTS)


def _binned(axes: Axes, densities: Densities, where: Flags, kind: str) -> None:
    """What was read in a stretch, in broad bins, as the density of one kind.

    The readings of a kind cannot be identified one by one: a bin's count is multiplied by the share of the kind in it,
    by the fitted model, and the codes are left out.
    """
    if densities.counts is None:
        return
    parts = {each: densities.weight[each] * densities.density[each] for each in KINDS}
    where = where & (parts["missed"] == 0.0)
    n, weight = float(np.sum(densities.counts)), densities.weight[kind]
    places = np.flatnonzero(where)
    if places.size < 2 or weight < NO_WEIGHT:
        return
    shown = False
    for cells in np.array_split(places, max(min(places.size // 20, 16), 1)):
        of_all = sum(float(np.sum(part[cells])) for part in parts.values())
        if of_all <= 0.0:
            continue
        scale = float(np.sum(parts[kind][cells])) / of_all / (weight * cells.size)
        count = float(np.sum(densities.counts[cells]))
        label = None if shown else "read, in bins, times the model's share of this kind"
        _dots(axes, [np.mean(densities.reading_cm[cells])], [count], n, label, scale)
        shown = True
