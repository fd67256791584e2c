"""The gap in pictures: residuals before and after, the probability integral transform, the selection path, slices.

Each figure is drawn from the findings, both models and the held-out readings. Nothing is decided here; needs the extra
``lab``.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, NullLocator

from msp_lab.gap.cell_fits import quantiles_of
from msp_lab.gap.cells import Partition, partitions
from msp_lab.gap.findings import GapFindings, Slice, UnknownEffect, error_name
from msp_lab.gap.labels import axis_label, channel_label, name_of, step_name
from msp_lab.gap.measures import HeldOutReadings, places, residual_autocorrelation
from msp_lab.gap.tables import shown_slices, slice_with_count
from msp_lab.readings.intake import PREVIOUS
from msp_range.arrays import Array
from msp_sim.effects import CATALOGUE
from msp_sim.intervals import Z
from msp_sim.model.model import Model
from msp_sim.page.page import Absent, Drawn, Entry
from msp_sim.page.style import (
    BLUE,
    GREY,
    INK,
    VERMILION,
    draw_pit_bars,
    intervals,
    line_at_zero,
    new_axes,
    new_panels,
    note,
    shaded,
)

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
MOST_SUBJECTS = 3
"""Contexts that are drawn; each costs a row of panels as high as a third of a screen."""


@dataclass(frozen=True)
class Subject:
    """A context column to draw over, and whether it is about outliers or about bias and spread."""

    column: str
    of_outliers: bool


@dataclass(frozen=True)
class BeforeAfter:
    """The given and the extended model, and the held-out readings that both are drawn with."""

    before: Model
    after: Model
    added: str
    """What the model after has, in words."""
    readings: HeldOutReadings
    rng: np.random.Generator

    def panels(self, height_in: float, rows: int = 1) -> tuple[Figure, Iterator[tuple[list[Axes], Model, str, str]]]:
        """A figure with a column of axes for each model; of each column its axes, the model, its colour and a word."""
        figure, axes = new_panels(height_in, rows, 2, sharey="row")
        axes[0].set_title("before: given model")
        axes[1].set_title(f"after: {self.added}")
        return figure, zip(
            (axes[::2], axes[1::2]), (self.before, self.after), (BEFORE, AFTER), ("before", "after"), strict=True
        )


def entries(findings: GapFindings, both: BeforeAfter) -> Iterator[Entry]:
    """Yield the pictures of the page."""
    wanted = subjects(findings, both.readings)
    yield "lead", "" if wanted else "Readings against the model", partial(_residuals, wanted[:1], both)
    if wanted[1:]:
        yield "residuals", "Over other contexts", partial(_residuals, wanted[1:], both)
    yield "path", "The gap after each step", partial(_path, findings)
    yield "pit", "All readings, before and after", partial(_pit, both)
    yield "autocorrelation", "Do errors repeat?", partial(_autocorrelation, both)
    yield "slices", "Slices of context", partial(_slices, shown_slices(findings))
    for number, unknown in enumerate(findings.unknown, start=1):
        if unknown.curve:
            title = f"Unknown effect {number}: {unknown.channel} over {name_of(unknown.variables[0])}"
            yield f"unknown-{number}", title, partial(_curve, unknown)


def subjects(findings: GapFindings, readings: HeldOutReadings) -> list[Subject]:
    """The columns of the effects found, of unknown effects, or else of the slice that differs most."""
    found: list[Subject] = []
    for found_effect in findings.effects:
        effect = CATALOGUE.get(found_effect.name)
        if effect is None:
            continue
        columns = [column for column in (*effect.requires, *((effect.per,) if effect.per else ())) if column != "run"]
        special = [name for name in columns if name not in ("true_range_cm", PREVIOUS)] or ["true_range_cm"]
        found.append(Subject(special[0], not {"bias", "spread"} & set(effect.channels)))
    first = next((piece for piece in findings.slices if piece.variables), None)
    others: list[UnknownEffect | Slice] = [*findings.unknown, *([first] if first else [])]
    found += [Subject(other.variables[0], other.channel not in ("bias", "spread")) for other in others]
    found.append(Subject("true_range_cm", False))
    known = [subject for subject in dict.fromkeys(found) if subject.column in readings.contexts]
    usable = [subject for subject in known if len(partitions(readings.contexts, [subject.column], pairs=False)) > 1]
    wanted = max(1, min(MOST_SUBJECTS, len(findings.effects) + len(findings.unknown)))
    # First one with single readings in it: a share of outliers has to be explained before it can be read.
    return sorted(usable[:wanted], key=lambda subject: subject.of_outliers)


def _residuals(wanted: Sequence[Subject], both: BeforeAfter) -> Drawn:
    """One row a context: what is measured against what the model expects, before on the left and after on the right."""
    if not wanted:
        raise Absent("No context column varies")
    figure, columns = both.panels(0.8 + 2.45 * len(wanted), len(wanted))
    parts = [_apart(partitions(both.readings.contexts, [subject.column], pairs=False)[1]) for subject in wanted]
    for column, model, colour, word in columns:
        for axes, subject, part in zip(column, wanted, parts, strict=True):
            draw = _draw_share if subject.of_outliers else _draw_residual
            value, ends = draw(axes, model, both, part)
            intervals(axes, _bin_places(part), value, ends, color=colour, label=f"measured, {word}")
            if part.centres is None:
                names = [label.split(" ", 1)[-1] for label in part.labels]
                axes.set_xticks(range(len(names)), names, rotation=0 if len(names) < 5 else 60)
            axes.set_xlabel(axis_label(subject.column))
            if word == "before":
                axes.set_ylabel("outliers [%]" if subject.of_outliers else "reading − expected [cm]")
    return figure, (
        "Readings of held-out runs, on which no value was fitted: left the given model, right "
        f"{both.added}. Line and grey band are what the model expects: where the coloured points lie on the line, it "
        "does what the sensor does. Outliers are farther from the surface than scatter explains."
    )


def _pit(both: BeforeAfter) -> Drawn:
    """Histograms of the randomised probability integral transform: flat where the model is right."""
    figure, columns = both.panels(2.9)
    for (axes,), model, colour, _ in columns:
        draw_pit_bars(axes, np.histogram(places(model, both.readings, both.rng), PIT_BINS, (0.0, 1.0))[0], colour, 0.0)
        axes.set_xlabel("place among the expected: 0 nearest, 1 farthest")
        axes.label_outer()
    axes.set_ylim(0.0, max(1.6, axes.get_ylim()[1]))
    return figure, (
        "Where each reading lies among those that the model expects there, from the nearest to the farthest. Flat "
        "where the model is right. A slope: readings are too far or too near. A U: they scatter more than that. "
        "High ends: outliers that the model does not have."
    )


def _autocorrelation(both: BeforeAfter) -> Drawn:
    """Correlation of errors over the time between two readings."""
    figure, columns = both.panels(2.9)
    for (axes,), model, colour, word in columns:
        found = residual_autocorrelation(model, both.readings, both.rng)
        if not found.apart.size:
            raise Absent("There are too few readings in a row")
        axes.fill_between(found.apart, -found.band, found.band, label="independent errors (95 %)", **shaded())
        axes.vlines(found.apart, 0.0, found.value, color=colour)
        axes.plot(found.apart, found.value, "o", color=colour, label=f"measured, {word}")
        line_at_zero(axes)
        axes.set_xlim(left=0.0)
        axes.set_xlabel("time between two readings [s]" if found.in_seconds else "readings between")
    figure.axes[0].set_ylabel("correlation of the errors")
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, -0.2), max(high, 0.5))
    return figure, (
        "How alike the errors of two readings of a sensor are, over the time between them: 1 is the same error "
        "again, 0 is independent. After, the points should lie in the grey band: then nothing is left that one "
        "reading says about the next."
    )


def _path(findings: GapFindings) -> Drawn:
    """The gap after each step, with the noise floor."""
    steps = [step for step in findings.selection_path if step.nats_per_reading is not None]
    floor = findings.nats.noise_floor or 1e-4
    least = floor / 4.0
    widths = [max(step.nats_per_reading or 0.0, least) for step in steps]
    figure, axes = new_axes(1.2 + 0.36 * len(steps), "gap on held-out runs [nats per reading], logarithmic")
    axes.axvspan(least, floor, label="noise floor: random variation alone (95 %)", **shaded())
    bars = axes.barh(range(len(steps)), widths, height=0.6, color=[BEFORE, *[AFTER] * (len(steps) - 1)])
    shown = [f"{width:.2g}" if width > least else "none left" for width in widths]
    axes.bar_label(bars, shown, padding=4, fontsize=8.5, color=INK)
    axes.set_yticks(range(len(steps)), [step_name(step.added) for step in steps])
    axes.set(xscale="log", xlim=(least, max(widths) * 2.2))
    axes.invert_yaxis()
    _plain_decades(axes)
    return figure, (
        "How much better each reading could still be predicted after each addition (in nats, the natural logarithm "
        "of a probability). The first and the last are measured, the others are what the later steps gain. Readings "
        "that the final model draws itself show a gap up to the grey band."
    )


def _slices(slices: Sequence[Slice]) -> Drawn:
    """Bias and ratios of each slice, before and after, with their errors."""
    if len(slices) < 2:
        raise Absent("No slice of context differs from the model.")
    figure, (left, right) = new_panels(1.3 + 0.3 * len(slices), 1, 2, sharey=True)
    # The spread, and those odds in which some slice differs most.
    odds = [kind for kind in ("short", "missed", "random") if kind in {one.channel for one in slices}]
    _draw_slices(left, slices, "bias_cm", "", 0.0, "o")
    for place, (name, marker) in enumerate(zip(["spread", *odds], "sD^v", strict=False)):
        column = f"log_odds_{name}" if name in odds else "log_spread"
        shift = 0.16 * (place - len(odds) / 2.0)
        _draw_slices(right, slices, column, f"{name}, " if odds else "", shift, marker)
    left.axvline(0.0, color=INK, linewidth=0.8)
    right.axvline(1.0, color=INK, linewidth=0.8)
    left.set_xlabel("bias [cm]")
    right.set(xscale="log", xlabel="ratio to the model (1 is right)")
    low, high = right.get_xlim()
    right.set_xlim(max(min(low, 0.5), 0.02), min(max(high, 2.0), 100.0))
    _plain_decades(right)
    left.set_yticks(range(len(slices)), [slice_with_count(piece) for piece in slices])
    left.invert_yaxis()
    return figure, (
        "Parts of the readings that differ from the given model, the most certain ones first, with 95 % "
        "intervals; open marks: with what was added. In brackets the number of readings."
    )


def _draw_slices(axes: Axes, slices: Sequence[Slice], column: str, what: str, shift: float, marker: str) -> None:
    """One number of each slice with its interval, and the same number after; the exponential of a logarithm."""
    # None, for what is not known, becomes NaN.
    value, error, after = np.array(
        [(getattr(piece, column), getattr(piece, error_name(column)), piece.after.get(column)) for piece in slices],
        dtype=float,
    ).T
    shown = np.array([value, after, value - Z * error, value + Z * error])
    if column != "bias_cm":
        with np.errstate(over="ignore"):
            shown = np.exp(shown)
    rows = np.arange(len(slices)) + shift
    words = f"{what}before, 95 % interval"
    intervals(axes, rows, shown[0], shown[2:], across=True, color=BEFORE, marker=marker, label=words)
    axes.plot(shown[1], rows, marker, color=AFTER, label=f"{what}after", markerfacecolor="white", zorder=6)


def _plain_decades(axes: Axes) -> None:
    """Ticks at 1, 2 and 5 of each decade of a logarithmic axis, as plain numbers."""
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")


def _curve(unknown: UnknownEffect) -> Drawn:
    """An unknown effect over its variable, with its band."""
    figure, axes = new_axes(2.8, axis_label(unknown.variables[0]), channel_label(unknown.channel))
    value, curve, low, high = np.array(unknown.curve).T
    axes.fill_between(value, low, high, label="95 % band", **shaded())
    axes.plot(value, curve, color=BLUE, marker="o", label="fitted")
    line_at_zero(axes)
    return figure, f"No effect of the catalogue explains it. Its formula: {unknown.formula}."


def _draw_residual(axes: Axes, model: Model, both: BeforeAfter, part: Partition) -> tuple[Array, Array]:
    """Residuals as dots, and the band where the model expects two of three; return medians of bins and intervals."""
    readings, rng = both.readings, both.rng
    centre = _centre(model, readings)
    residual = readings.reading_cm - centre
    low, lower, middle, upper, high = _of_bins(residual, part)
    drawn = [_of_bins(model.sample(readings.contexts, rng) - centre, part)[::2] for _ in range(REPLICATES)]
    expected = np.mean(drawn, axis=0)
    wide = 1.6 * float(np.nanmedian(np.concatenate([high - low, expected[2] - expected[0]])))
    far = np.abs(middle[np.isfinite(middle)])
    # One bin of outliers must not flatten all others to a line.
    reach = float(far[far <= 8.0 * np.median(far) + 2.0 * wide].max()) + wide + 1.0
    shown = rng.permutation(len(readings))[:DOTS]
    if part.centres is None:
        x = part.cell[shown] + rng.uniform(-0.25, 0.25, shown.size)
    else:
        x = readings.contexts[part.variables[0]][shown]
    axes.plot(x, residual[shown], ".", color=GREY, markersize=1.6, alpha=0.35, rasterized=True)
    _draw_expected(axes, part, expected, "expected, two of three readings")
    outside = float(np.mean(np.abs(residual) > reach))
    if outside > 0.0:
        note(axes, f"{100.0 * outside:.2g} % outside of the picture", y=0.03)
    _widen(axes, -reach, reach)
    # Of a median, from the quartiles of a normal distribution.
    half = Z * 1.2533 * np.maximum((upper - lower) / 1.349, 0.3) / np.sqrt(np.maximum(part.counts, 1))
    return middle, np.array([middle - half, middle + half])


def _draw_share(axes: Axes, model: Model, both: BeforeAfter, part: Partition) -> tuple[Array, Array]:
    """The expected share of readings that are no hit; return the measured one with its intervals."""
    readings = both.readings
    centre = _centre(model, readings)
    sigma_cm = np.concatenate([rows.sigma_cm for _, rows in model.chunks(readings.contexts)])
    counts = np.maximum(part.counts, 1)

    def percent(reading_cm: Array) -> Array:
        with np.errstate(invalid="ignore"):
            no_hit = ~(np.abs(reading_cm - centre) <= NO_HIT_SIGMAS * sigma_cm + 0.5)
        return 100.0 * np.bincount(part.cell, no_hit, len(part.labels)) / counts

    drawn = np.stack([percent(model.sample(readings.contexts, both.rng)) for _ in range(4 * REPLICATES)])
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    _draw_expected(axes, part, np.array([low, drawn.mean(axis=0), high]), "expected share (95 %)")
    measured = percent(readings.reading_cm)
    half = 100.0 * Z * np.sqrt(np.maximum(measured * (100.0 - measured) / 1e4, 0.5 / counts) / counts)
    here = np.isfinite(_bin_places(part))
    _widen(axes, 0.0, 1.15 * float(max((measured + half)[here].max(), high[here].max())))
    return measured, np.array([measured - half, measured + half])


def _widen(axes: Axes, low: float, high: float) -> None:
    """Limits of an axis that two panels share: those that the first one set, wider where this one needs it."""
    if not axes.get_autoscaley_on():
        low, high = min(low, axes.get_ylim()[0]), max(high, axes.get_ylim()[1])
    axes.set_ylim(low, high)


def _draw_expected(axes: Axes, part: Partition, expected: Array, words: str) -> None:
    """What the model expects in each cell (3, k): a line and a band over numbers, a box for each word."""
    at = _bin_places(part)
    order = np.argsort(at)
    at, (low, middle, high) = at[order], expected[:, order]
    if part.centres is None:
        axes.bar(at, high - low, 0.7, low, label=words, **shaded())
        axes.hlines(middle, at - 0.35, at + 0.35, color=INK, linewidth=1.0, label="expected")
    else:
        axes.fill_between(at, low, high, label=words, **shaded())
        axes.plot(at, middle, color=INK, linewidth=1.0, label="expected")


def _of_bins(residual: Array, part: Partition) -> Array:
    """The quantiles 1/6, 1/4, 1/2, 3/4 and 5/6 of each bin, (5, k)."""
    order = np.argsort(part.cell, kind="stable")
    return quantiles_of(residual[order], part.counts, (1 / 6, 0.25, 0.5, 0.75, 5 / 6), np.nan)


def _centre(model: Model, readings: HeldOutReadings) -> Array:
    """The centre of each reading's hit [cm], within the sensor's limits."""
    centre_cm = np.concatenate([rows.centre_cm for _, rows in model.chunks(readings.contexts)])
    return np.asarray(np.clip(centre_cm, model.sensor.minimum_cm, model.sensor.maximum_cm), dtype=np.float64)


def _apart(part: Partition) -> Partition:
    """A partition whose cells lie so far apart that their points do not cover each other."""
    if part.centres is None or np.isfinite(part.centres).sum() < 2:
        return part
    least = float(np.ptp(part.centres[np.isfinite(part.centres)])) * CLOSEST
    group, groups, begun = np.empty(part.centres.size, dtype=np.intp), -1, np.nan
    for cell in np.argsort(part.centres).tolist():
        if not abs(part.centres[cell] - begun) < least:
            begun, groups = part.centres[cell], groups + 1
        group[cell] = groups
    weight = np.maximum(part.counts, 1)
    centres = np.bincount(group, weight * part.centres) / np.bincount(group, weight)
    labels = tuple(part.labels[first] for first in np.unique(group, return_index=True)[1])
    return Partition(part.variables, labels, group[part.cell], centres)


def _bin_places(part: Partition) -> Array:
    return np.arange(len(part.labels), dtype=float) if part.centres is None else part.centres
