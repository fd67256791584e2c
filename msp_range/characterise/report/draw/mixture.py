"""The four densities of the mixture as fitted (report figures 5.3-5.6), all of them together, and how well they fit."""

from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, MaxNLocator
from numpy.typing import NDArray
from scipy.stats import binom

from msp_range.page.style import GREEN, GREY, INK, ORANGE, OURS, PURPLE, REFERENCE, new_figure, note

_Array = NDArray[np.float64]

KINDS = ("hit", "unexpected", "max", "random")

_LOOKS = {"hit": (OURS, "-"), "unexpected": (ORANGE, "--"), "max": (PURPLE, "-"), "random": (GREEN, "-.")}


@dataclass(frozen=True)
class Densities:
    """Probabilities of each whole centimetre by each kind of reading, and what was read.

    Parameters
    ----------
    true_range_cm
        The true range that they are for, in the centimetres that the sensor reads: after calibration and air [cm].
    reading_cm
        Readings that the sensor can report, shape (k,).
    density
        By kind: probability of each reading if the reading is of this kind, shape (k,); its sum is 1.
    weight
        By kind: share of the readings.
    counts
        How often each was read at this range, shape (k,); None: there are no readings at one range.
    """

    true_range_cm: float
    reading_cm: _Array
    density: dict[str, _Array]
    weight: dict[str, float]
    counts: _Array | None


def draw_hit(densities: Densities) -> Figure:
    """The measurement noise (5.3): the Gaussian's probability of each centimetre, beside the share that was read."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["hit"]
    shown = _bulk(k, p, 1e-5)
    axes.bar(k[shown], p[shown], width=0.9, color=OURS, alpha=0.45, label="fitted: integral over each centimetre")
    if densities.counts is not None:
        near = densities.counts * shown
        _observed(axes, k[shown], near[shown], float(np.sum(near)))
    axes.axvline(densities.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    return _finish(figure, axes, "probability of a centimetre")


def draw_unexpected(densities: Densities) -> Figure:
    """Unexpected obstacles (5.4): the exponential that ends at the expected range."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["unexpected"]
    inside = k <= densities.true_range_cm + 0.5
    end = 0.5 + densities.true_range_cm
    axes.fill_between(k[inside], 0.0, p[inside], step="mid", color=ORANGE, alpha=0.35, linewidth=0)
    axes.step(k[inside], p[inside], where="mid", color=ORANGE, label="fitted, if a reading is of this kind")
    if densities.counts is not None:
        # Where the hits begin nothing else can be told from them.
        hits = _bulk(k, densities.density["hit"], 1e-7)
        before = k < float(k[hits][0]) if np.any(hits) else inside
        _binned(axes, densities, before, _kinds_expected(densities, before, "unexpected"), "unexpected")
    axes.axvline(densities.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.set_xlim(0.0, end * 1.06)
    return _finish(figure, axes, "probability of a centimetre")


def draw_max(densities: Densities, codes: dict[float, float]) -> Figure:
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
    axes.vlines(values, 0.0, [100.0 * codes[value] for value in values], color=PURPLE, linewidth=9, alpha=0.5)
    axes.plot([], [], color=PURPLE, linewidth=6, alpha=0.5, label="fitted point mass")
    if densities.counts is not None:
        total = float(np.sum(densities.counts))
        for value in values:
            count = float(np.sum(densities.counts[k == value]))
            low, high = _share_interval(count, total)
            axes.errorbar(
                [value], [100.0 * count / total], yerr=[[100.0 * (count / total - low)], [100.0 * (high - count / total)]],
                marker="o", markersize=6, color=INK, markerfacecolor="white", capsize=4, linestyle="none", zorder=5,
                label="read, and its 95 % interval" if value == values[0] else None,
            )  # fmt: skip
    for value in values:
        axes.annotate(
            f"{value:g} cm", (value, 100.0 * codes[value]), xytext=(9, 0), textcoords="offset points", fontsize=8.5
        )
    axes.axvline(densities.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.set_xlim(0.0, float(k[-1]) * 1.1)
    axes.margins(y=0.2)
    return _finish(figure, axes, "share of all readings [%]")


def draw_random(densities: Densities) -> Figure:
    """Random readings (5.6): the same for each centimetre that the sensor can report, from its minimum and not from 0."""
    figure, axes = _axes()
    k, p = densities.reading_cm, densities.density["random"]
    axes.fill_between(k, 0.0, p, step="mid", color=GREEN, alpha=0.3, linewidth=0)
    axes.step(k, p, where="mid", color=GREEN, label="fitted, if a reading is of this kind")
    if densities.counts is not None:
        hits = _bulk(k, densities.density["hit"], 1e-7)
        after = (k > float(k[hits][-1])) & (k < k[-1]) if np.any(hits) else k < k[-1]
        _binned(axes, densities, after, _kinds_expected(densities, after, "random"), "random")
    for edge in (k[0], k[-1]):
        axes.annotate(f"{edge:g} cm", (edge, float(p[0])), xytext=(0, 6), textcoords="offset points", ha="center", fontsize=8)
    axes.axvline(densities.true_range_cm, color=REFERENCE, linestyle="--", label="expected reading")
    axes.set_xlim(0.0, float(k[-1]) * 1.06)
    axes.margins(y=0.25)
    return _finish(figure, axes, "probability of a centimetre")


def draw_mixture(densities: Densities, total: _Array) -> Figure:
    """All four together on a logarithmic scale, with what was read.

    Parameters
    ----------
    densities
        Of the fitted model.
    total
        Probability of each reading by the whole model, codes in it, shape (k,).
    """
    figure = new_figure(4.0)
    axes = figure.subplots()
    k = densities.reading_cm
    least = 1e-7
    if densities.counts is not None:
        n = float(np.sum(densities.counts))
        least = 0.2 / n
        seen = densities.counts > 0
        axes.plot(
            k[seen], densities.counts[seen] / n, linestyle="none", marker="o", markersize=3.0, color=GREY, zorder=2,
            markeredgewidth=0, alpha=0.8, label=f"share read ({n:,.0f} readings; a dot a centimetre)",
        )  # fmt: skip
    for kind in KINDS:
        colour, dashes = _LOOKS[kind]
        p = densities.weight[kind] * densities.density[kind]
        label = f"{kind}, weight {densities.weight[kind]:.3g}"
        if kind == "max":
            axes.vlines(k[p > 0], least, p[p > 0], color=colour, linewidth=5, alpha=0.6, label=label, zorder=3)
        else:
            axes.plot(k, np.where(p > least / 10, p, np.nan), dashes, color=colour, label=label, zorder=3)
    axes.plot(k, total, color=INK, linewidth=0.8, label="all together", zorder=4)
    axes.set_yscale("log")
    axes.set_ylim(least, 2.0)
    axes.set_xlim(0.0, float(k[-1]) * 1.03)
    axes.set_xlabel("reading [cm]")
    axes.set_ylabel("probability of a centimetre")
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def draw_pit(counts: _Array, p_value: float) -> Figure:
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
    low, high = binom.ppf([0.025, 0.975], n, 1.0 / bins) / (n / bins)
    axes.axhspan(low, high, color=REFERENCE, alpha=0.15, linewidth=0, label="95 % of each bar if the model is right")
    axes.axhline(1.0, color=REFERENCE, linewidth=1.0)
    heights = counts / (n / bins)
    axes.bar(left, heights, width=0.94 / bins, align="edge", color=OURS, alpha=0.75, label=f"{n:,.0f} readings", zorder=2)
    reach = max(float(np.max(np.abs(heights - 1.0))), 1.0 - low) * 1.35
    axes.set_ylim(max(0.0, 1.0 - reach), 1.0 + reach)
    axes.set_xlim(0.0, 1.0)
    axes.set_xlabel("probability that the fitted model gives to a smaller reading (randomised within a centimetre)")
    axes.set_ylabel("readings over expected")
    axes.grid(axis="x", visible=False)
    note(axes, f"p of uniform = {p_value:.2g}")
    figure.legend(loc="outside lower center", ncols=2)
    return figure


def _axes():  # type: ignore[no-untyped-def]
    figure = new_figure(3.2)
    return figure, figure.subplots()


def _finish(figure: Figure, axes, label: str) -> Figure:  # type: ignore[no-untyped-def]
    axes.set_xlabel("reading [cm]")
    axes.set_ylabel(label)
    axes.set_ylim(bottom=0.0)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda tick, _: f"{tick:.3g}"))
    axes.grid(axis="x", visible=False)
    figure.legend(loc="outside lower center", ncols=3)
    return figure


def _bulk(k: _Array, p: _Array, share_of_peak: float) -> NDArray[np.bool_]:
    """Readings whose probability is not next to nothing; where the model has no peak, all."""
    if not np.max(p) > 0.0:
        return np.ones(k.size, dtype=bool)
    return np.asarray(p > share_of_peak * np.max(p))


def _observed(axes, k: _Array, counts: _Array, total: float) -> None:  # type: ignore[no-untyped-def]
    share = counts / max(total, 1.0)
    intervals = np.array([_share_interval(float(count), total) for count in counts])
    axes.errorbar(
        k, share, yerr=[share - intervals[:, 0], intervals[:, 1] - share], linestyle="none", marker="o", markersize=4.5,
        color=INK, markerfacecolor="white", elinewidth=1.0, capsize=2.5, zorder=5,
        label="share read, and its 95 % interval",
    )  # fmt: skip


def _kinds_expected(densities: Densities, where: NDArray[np.bool_], kind: str) -> float:
    """Share of the readings in a stretch that are of a kind, by the fitted model."""
    parts = {each: float(np.sum(densities.weight[each] * densities.density[each][where])) for each in KINDS}
    total = sum(parts.values())
    return parts[kind] / total if total > 0.0 else 0.0


def _binned(axes, densities: Densities, where: NDArray[np.bool_], share: float, kind: str) -> None:  # type: ignore[no-untyped-def]
    """What was read in a stretch, in broad bins, without what the model says is of another kind.

    The readings of a kind cannot be told one by one: each bin's count is taken times the share of the kind in it.
    """
    assert densities.counts is not None
    k = densities.reading_cm[where]
    n = float(np.sum(densities.counts))
    weight = densities.weight[kind]
    if k.size < 2 or weight <= 0.0 or share <= 0.0:
        return
    bins = np.array_split(np.arange(k.size), max(min(k.size // 20, 16), 1))
    counts = densities.counts[where]
    shown = False
    for cells in bins:
        of_all = sum(float(np.sum(densities.weight[each] * densities.density[each][where][cells])) for each in KINDS)
        of_kind = float(np.sum(weight * densities.density[kind][where][cells]))
        scale = of_kind / of_all / (weight * cells.size) if of_all > 0.0 else 0.0
        count = float(np.sum(counts[cells]))
        low, high = _share_interval(count, n)
        centre = float(np.mean(k[cells]))
        value = scale * count / n
        axes.errorbar(
            [centre], [value], yerr=[[value - scale * low], [scale * high - value]], marker="o", markersize=4.5, color=INK,
            markerfacecolor="white", elinewidth=1.0, capsize=2.5, linestyle="none", zorder=5,
            label=None if shown else "read, in bins, by the model's share of this kind",
        )  # fmt: skip
        shown = True


def _share_interval(count: float, total: float) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if total <= 0.0:
        return 0.0, 1.0
    z2 = 1.96**2
    share = count / total
    centre = (share + z2 / (2 * total)) / (1 + z2 / total)
    half = np.sqrt(share * (1 - share) / total + z2 / (4 * total**2)) * 1.96 / (1 + z2 / total)
    return max(float(centre - half), 0.0), min(float(centre + half), 1.0)
