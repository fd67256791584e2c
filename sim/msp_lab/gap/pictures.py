"""The gap in pictures: residuals before and after, the probability integral transform, the selection path, slices.

Findings, both models and the held-out readings enter, figures leave. Nothing is decided here; needs the extra ``lab``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from msp_lab.gap.autocorrelation import labelled, places
from msp_lab.gap.cells import Partition, partitions
from msp_lab.gap.findings import GapFindings, Slice, UnknownEffect, error_name
from msp_lab.gap.labels import axis_label, step_name
from msp_lab.gap.measures import HeldOutReadings
from msp_lab.gap.tables import shown_slices, slice_with_count
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Array
from msp_sim.effects import CATALOGUE
from msp_sim.model.model import Model
from msp_sim.page.style import BLUE, GREY, INK, PALE, VERMILION, legend_below, new_figure, note

BEFORE, AFTER = VERMILION, BLUE
REPLICATES = 12
"""Tables drawn for what the model expects in a picture: enough for its band to be smooth."""
DOTS = 4000
"""Readings shown as dots: more make a file larger and a picture darker."""
PIT_BINS = 20
NO_HIT_SIGMAS = 4.0
"""A reading farther from the model's centre is no hit, in pictures of the outliers: 1 in 16,000 hits is."""
CLOSEST = 0.04
"""Two points of a picture are at least so far apart, as a share of its width."""


@dataclass(frozen=True)
class Subject:
    """A context column to draw over, and whether it is about outliers or about bias and spread."""

    column: str
    of_outliers: bool


def subjects(findings: GapFindings, readings: HeldOutReadings, most: int = 3) -> list[Subject]:
    """The columns of the effects found, of unknown effects, or else of the slice that differs most."""
    found: list[Subject] = []
    for each in findings.effects:
        effect = CATALOGUE.get(each.name)
        if effect is None:
            continue
        columns = [each for each in (*effect.requires, *((effect.per,) if effect.per else ())) if each != "run"]
        special = [name for name in columns if name not in ("true_range_cm", PREVIOUS)] or ["true_range_cm"]
        found.append(Subject(special[0], not {"bias", "spread"} & set(effect.channels)))
    found += [Subject(each.variables[0], each.channel not in ("bias", "spread")) for each in findings.unknown]
    for piece in findings.slices:
        if piece.variables:
            found.append(Subject(piece.variables[0], piece.channel not in ("bias", "spread")))
            break
    found.append(Subject("true_range_cm", False))
    known = [each for each in dict.fromkeys(found) if each.column in readings.contexts]
    usable = [each for each in known if len(partitions(readings.contexts, [each.column], pairs=False)) > 1]
    wanted = max(1, min(most, len(findings.effects) + len(findings.unknown)))
    # First one with single readings in it: a share of outliers has to be explained before it can be read.
    return sorted(usable[:wanted], key=lambda each: each.of_outliers)


def draw_residuals(
    wanted: Sequence[Subject],
    before: Model,
    after: Model,
    readings: HeldOutReadings,
    rng: np.random.Generator,
    added: str,
) -> Figure:
    """One row a context: what is measured against what the model expects, before on the left and after on the right.

    `added` labels the model after.
    """
    figure = new_figure(0.8 + 2.45 * len(wanted))
    rows = figure.subplots(len(wanted), 2, sharey="row", squeeze=False)
    for subject, (left, right) in zip(wanted, rows, strict=True):
        part = _apart(partitions(readings.contexts, [subject.column], pairs=False)[1])
        drawn = _draw_share if subject.of_outliers else _draw_residual
        limits = []
        for axes, model, colour in ((left, before, BEFORE), (right, after, AFTER)):
            middle, error, ends = drawn(axes, model, readings, part, rng)
            label = "measured, before" if colour == BEFORE else "measured, after"
            at = _bin_places(part)
            axes.errorbar(at, middle, error, fmt="o", color=colour, markersize=4.5, label=label, zorder=5)
            if part.centres is None:
                names = [label.split(" ", 1)[-1] for label in part.labels]
                axes.set_xticks(range(len(names)), names, rotation=0 if len(names) < 5 else 60)
            axes.set_xlabel(axis_label(subject.column))
            limits.append(ends)
        left.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
        left.set_ylabel("outliers [%]" if subject.of_outliers else "reading − expected [cm]")
    rows[0][0].set_title("before: given model")
    rows[0][1].set_title(f"after: {added}")
    legend_below(figure, labelled(figure))
    return figure


def draw_pit(before: Model, after: Model, readings: HeldOutReadings, rng: np.random.Generator, added: str) -> Figure:
    """Histograms of the randomised probability integral transform: flat where the model is right."""
    figure = new_figure(2.9)
    left, right = figure.subplots(1, 2, sharey=True)
    expected = len(readings) / PIT_BINS
    deviation = 1.96 * np.sqrt(expected * (1.0 - 1.0 / PIT_BINS))
    for axes, model, colour, title in (
        (left, before, BEFORE, "before: given model"),
        (right, after, AFTER, f"after: {added}"),
    ):
        counts, edges = np.histogram(places(model, readings, rng), PIT_BINS, (0.0, 1.0))
        axes.axhspan(
            (expected - deviation) / expected,
            (expected + deviation) / expected,
            color=PALE,
            label="random variation (95 %)",
        )
        axes.stairs(counts / expected, edges, fill=True, color=colour, alpha=0.75)
        axes.axhline(1.0, color=INK, linewidth=0.8)
        axes.set_title(title)
        axes.set_xlabel("place among the expected: 0 nearest, 1 farthest")
    left.set_ylabel("readings, relative to expected")
    left.set_ylim(0.0, max(1.6, left.get_ylim()[1]))
    legend_below(figure)
    return figure


def draw_path(findings: GapFindings) -> Figure:
    """The gap after each step, with the noise floor."""
    steps = [each for each in findings.selection_path if each.nats_per_reading is not None]
    assert findings.gap is not None
    floor = findings.gap.nats_per_reading.noise_floor or 1e-4
    names = [step_name(each.added) for each in steps]
    least = floor / 4.0
    widths = [max(each.nats_per_reading or 0.0, least) for each in steps]
    figure = new_figure(1.2 + 0.36 * len(steps))
    axes = figure.subplots()
    axes.set_xscale("log")
    axes.axvspan(least, floor, color=PALE, label="noise floor: random variation alone (95 %)")
    colours = [BEFORE, *([AFTER] * (len(steps) - 1))]
    axes.barh(range(len(steps)), widths, left=0.0, height=0.6, color=colours)
    axes.set_xlim(least, max(widths) * 2.2)
    for place, (each, width) in enumerate(zip(steps, widths, strict=True)):
        shown = each.nats_per_reading or 0.0
        text = f"{shown:.2g}" if shown > least else "none left"
        axes.annotate(
            text, (width, place), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5, color=INK
        )
    axes.set_yticks(range(len(steps)), names)
    axes.invert_yaxis()
    axes.grid(axis="y", visible=False)
    _plain_decades(axes)
    axes.set_xlabel("gap on held-out runs [nats per reading], logarithmic")
    legend_below(figure)
    return figure


def draw_slices(findings: GapFindings) -> Figure:
    """Bias and ratios of each slice, before and after, with their errors."""
    slices = shown_slices(findings)
    figure = new_figure(1.3 + 0.3 * len(slices))
    left, right = figure.subplots(1, 2, sharey=True)
    places = np.arange(len(slices))
    ratios = _ratio_columns(slices)
    many = len(ratios) > 1
    for axes, names, label in (
        (left, ("bias_cm",), "bias [cm]"),
        (right, ratios, "ratio to the model (1 is right)"),
    ):
        for column, marker in zip(names, "o" if axes is left else "sD^v", strict=False):
            what = column.removeprefix("log_").removeprefix("odds_").removesuffix("_cm")
            # None, for what is not known, becomes NaN.
            values = np.array([getattr(each, column) for each in slices], dtype=float)
            errors = np.array([getattr(each, error_name(column)) for each in slices], dtype=float)
            later = np.array([each.after.get(column) for each in slices], dtype=float)
            ends = np.array([values - 1.96 * errors, values + 1.96 * errors])
            if column != "bias_cm":
                with np.errstate(over="ignore"):
                    values, ends, later = np.exp(values), np.exp(ends), np.exp(later)
            offset = 0.0 if column == "bias_cm" else 0.16 * (names.index(column) - (len(names) - 1) / 2.0)
            prefix = f"{what}, " if many else ""
            axes.hlines(places + offset, *ends, color=BEFORE, linewidth=1.0, alpha=0.6)
            axes.plot(values, places + offset, marker, color=BEFORE, label=f"{prefix}before, 95 % interval")
            axes.plot(later, places + offset, marker, color=AFTER, label=f"{prefix}after", markerfacecolor="white")
        axes.axvline(0.0 if axes is left else 1.0, color=INK, linewidth=0.8)
        axes.set_xlabel(label)
        axes.grid(axis="y", visible=False)
    right.set_xscale("log")
    low, high = right.get_xlim()
    right.set_xlim(max(min(low, 0.5), 0.02), min(max(high, 2.0), 100.0))
    _plain_decades(right)
    left.set_yticks(places, [slice_with_count(each) for each in slices])
    left.invert_yaxis()
    legend_below(figure, labelled(figure))
    return figure


def _plain_decades(axes: Axes) -> None:
    """Ticks at 1, 2 and 5 of each decade of a logarithmic axis, as plain numbers."""
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:g}")


def draw_curve(each: UnknownEffect) -> Figure:
    """An unknown effect over its variable, with its band."""
    figure = new_figure(2.8)
    axes = figure.subplots()
    value, curve, low, high = np.array(each.curve).T
    axes.fill_between(value, low, high, color=PALE, label="95 % band")
    axes.plot(value, curve, color=BLUE, marker="o", label="fitted")
    axes.axhline(0.0, color=INK, linewidth=0.8)
    axes.set_xlabel(axis_label(each.variables[0]))
    axes.set_ylabel(
        {"bias": "bias [cm]", "spread": "log of the spread"}.get(each.channel, f"log odds of {each.channel}")
    )
    legend_below(figure)
    return figure


def _draw_residual(
    axes: Axes, model: Model, readings: HeldOutReadings, part: Partition, rng: np.random.Generator
) -> tuple[Array, Array, tuple[float, float]]:
    """Residuals as dots, and the band where the model expects two of three; medians of bins with errors, and limits."""
    centre = _centre(model, readings)
    residual = readings.reading_cm - centre
    numbers = part.centres is not None
    x = np.asarray(readings.contexts[part.variables[0]] if numbers else part.cell, dtype=float)
    low, middle, high, error = _of_bins(residual, part)
    expected = np.stack(
        [_of_bins(model.sample(readings.contexts, rng) - centre, part)[:3] for _ in range(REPLICATES)]
    ).mean(axis=0)
    wide = 1.6 * float(np.nanmedian(np.concatenate([high - low, expected[2] - expected[0]])))
    far = np.abs(middle[np.isfinite(middle)])
    # One bin of outliers must not flatten all others to a line.
    reach = float(far[far <= 8.0 * np.median(far) + 2.0 * wide].max()) + wide + 1.0
    shown = rng.permutation(len(readings))[:DOTS]
    jitter = 0.0 if numbers else rng.uniform(-0.25, 0.25, shown.size)
    axes.plot(x[shown] + jitter, residual[shown], ".", color=GREY, markersize=1.6, alpha=0.35, rasterized=True)
    _draw_expected(axes, part, expected[0], expected[1], expected[2], "expected, two of three readings")
    outside = float(np.mean(np.abs(residual) > reach))
    if outside > 0.0:
        note(axes, f"{100.0 * outside:.2g} % outside of the picture", y=0.03)
    return middle, 1.96 * error, (-reach, reach)


def _draw_share(
    axes: Axes, model: Model, readings: HeldOutReadings, part: Partition, rng: np.random.Generator
) -> tuple[Array, Array, tuple[float, float]]:
    """The share of readings that are no hit as expected; as measured, its errors, and limits of both."""
    centre = _centre(model, readings)
    sigma_cm = np.concatenate([rows.sigma_cm for _, rows in model.chunks(readings.contexts)])

    def share(reading_cm: Array) -> Array:
        with np.errstate(invalid="ignore"):
            no_hit = ~(np.abs(reading_cm - centre) <= NO_HIT_SIGMAS * sigma_cm + 0.5)
        return np.bincount(part.cell, no_hit, len(part.labels)) / np.maximum(part.counts, 1)

    shares = np.stack([share(model.sample(readings.contexts, rng)) for _ in range(4 * REPLICATES)])
    measured = share(readings.reading_cm)
    counts = np.maximum(part.counts, 1)
    error = 1.96 * np.sqrt(np.maximum(measured * (1.0 - measured), 0.5 / counts) / counts)
    drawn = np.isfinite(_bin_places(part))
    low, high = np.quantile(shares, [0.025, 0.975], axis=0)
    _draw_expected(axes, part, 100.0 * low, 100.0 * shares.mean(axis=0), 100.0 * high, "expected share (95 %)")
    most = 1.15 * 100.0 * float(max((measured + error)[drawn].max(), high[drawn].max()))
    return 100.0 * measured, 100.0 * error, (0.0, most)


def _draw_expected(axes: Axes, part: Partition, low: Array, middle: Array, high: Array, label: str) -> None:
    """What the model expects in each cell: a line and a band over numbers, a box for each word."""
    at = _bin_places(part)
    if part.centres is None:
        axes.bar(at, high - low, 0.7, low, color=PALE, zorder=0, label=label)
        axes.hlines(middle, at - 0.35, at + 0.35, color=INK, linewidth=1.0, label="expected")
        return
    order = np.argsort(at)
    axes.fill_between(at[order], low[order], high[order], color=PALE, zorder=0, label=label)
    axes.plot(at[order], middle[order], color=INK, linewidth=1.0, label="expected")


def _of_bins(residual: Array, part: Partition) -> tuple[Array, Array, Array, Array]:
    """The quantiles 1/6, 1/2 and 5/6 of each bin, and the standard error of the middle one."""
    order = np.argsort(part.cell, kind="stable")
    pieces = np.split(order, np.cumsum(part.counts)[:-1])
    quantiles = np.array(
        [
            np.nanquantile(residual[rows], [1 / 6, 0.25, 0.5, 0.75, 5 / 6]) if rows.size else [np.nan] * 5
            for rows in pieces
        ]
    )
    spread = (quantiles[:, 3] - quantiles[:, 1]) / 1.349
    error = 1.2533 * np.maximum(spread, 0.3) / np.sqrt(np.maximum(part.counts, 1))
    return quantiles[:, 0], quantiles[:, 2], quantiles[:, 4], error


def _centre(model: Model, readings: HeldOutReadings) -> Array:
    """The centre of each reading's hit [cm], within the sensor's limits."""
    centre_cm = np.concatenate([rows.centre_cm for _, rows in model.chunks(readings.contexts)])
    return np.asarray(np.clip(centre_cm, model.sensor.minimum_cm, model.sensor.maximum_cm), dtype=np.float64)


def _apart(part: Partition) -> Partition:
    """A partition whose cells lie so far apart that their points do not cover each other."""
    if part.centres is None or np.isfinite(part.centres).sum() < 2:
        return part
    least = float(np.ptp(part.centres[np.isfinite(part.centres)])) * CLOSEST
    order = np.argsort(part.centres)
    group, groups = np.empty(order.size, dtype=np.intp), 0
    begun = np.nan
    for cell in order.tolist():
        if not abs(part.centres[cell] - begun) < least:
            begun, groups = part.centres[cell], groups + 1
        group[cell] = groups - 1
    members = [np.flatnonzero(group == number) for number in range(groups)]
    counts = part.counts
    centres = [float(np.average(part.centres[each], weights=np.maximum(counts[each], 1))) for each in members]
    labels = tuple(part.labels[each[0]] for each in members)
    return Partition(part.variables, labels, group[part.cell], np.array(centres))


def _bin_places(part: Partition) -> Array:
    return np.arange(len(part.labels), dtype=float) if part.centres is None else part.centres


def _ratio_columns(slices: Sequence[Slice]) -> tuple[str, ...]:
    """The spread, and those odds in which some slice differs most."""
    found = ["log_spread"]
    for channel in ("short", "missed", "random"):
        if any(each.channel == channel for each in slices):
            found.append(f"log_odds_{channel}")
    return tuple(found)
