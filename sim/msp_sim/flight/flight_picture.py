"""Draw a flight: all ranges over time, below them which readings were not used and why, and the errors where the truth
is known."""

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import cycle, pairwise
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from msp_range.arrays import Array
from msp_sim.flight.flight_log import USED, FlightResult, SensorTrack
from msp_sim.page.style import GREY, INK, PALE, SERIES, legend_below, new_figure, save, shaded, style

SHOWN_CM = 40.0
"""Half height of the plot of errors [cm]: the errors of hits fill it, and outliers of metres are left out."""
GAP_S = 1.0
"""Where nothing was known for longer than this the lines are interrupted [s]: the time after which the bridge itself
reports that there is no distance."""
MARKERS = "x+1v*s^Dp"
"""Markers of the reasons, the most frequent first; with more reasons than these the last is used again."""


@style()
def draw(flight: FlightResult, path: Path, title: str) -> None:
    """Write the picture of a flight as PNG; an older file is replaced."""
    is_truth_known = any(
        truth is not None for track in (*flight.tracks.values(), flight.fused) for truth in track.truth_m
    )
    reasons = [reason for reason, _ in Counter(_reasons(flight)).most_common()]
    ratios = [3.0, *([0.25 * len(flight.tracks) + 0.1] if reasons else []), *([2.0] if is_truth_known else [])]
    figure = new_figure(1.5 + 1.25 * sum(ratios), 9.6)
    top, *below = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
    _draw_ranges(top, flight)
    top.set_title(f"{title}: {_what_happened(flight)}")
    if reasons:
        _draw_rejected(below[0], flight, reasons)
    if is_truth_known:
        _draw_errors(below[-1], flight)
    edges = _edges(flight.fused)
    for first_s, last_s in edges:
        for axes in (top, *below):
            axes.axvspan(first_s, last_s, **shaded())
    if edges:
        top.fill_between([], [], [], label="sensors over different ground", **shaded())
    (below or [top])[-1].set_xlabel("time [s]")
    save(legend_below(figure), path)


def _coloured(flight: FlightResult) -> Iterator[tuple[str, SensorTrack, str]]:
    """Name, track and colour of each sensor."""
    for (name, track), (colour, _) in zip(flight.tracks.items(), cycle(SERIES), strict=False):
        yield name, track, colour


def _draw_ranges(top: Axes, flight: FlightResult) -> None:
    """Readings that were used, and the fused distance on the true one."""
    for name, track, colour in _coloured(flight):
        time_s, raw_m = _numbers(track.time_s), _numbers(track.raw_m)
        used = np.array([why in USED for why in track.why], dtype=bool)
        top.plot(time_s[used], raw_m[used], ".", color=colour, markersize=3, label=name)
        top.plot(time_s[~used], raw_m[~used], "x", color=colour, markersize=5)
    top.plot([], [], "x", color=GREY, label="a range that was not used")
    fused = flight.fused
    # Where the sensors are over different ground no single distance is true.
    truth = _interrupted(fused.time_s, _unless(fused, "edge", _numbers(fused.truth_m)))
    if any(each is not None for each in fused.truth_m):
        top.plot(*truth, "-", color=PALE, linewidth=5, label="true distance (fused)", zorder=0)
    if fused.time_s:
        heights = _interrupted(fused.time_s, _numbers(fused.filtered_m))
        top.plot(*heights, "-", color=INK, linewidth=1, label="fused")
    top.set_ylabel("range [m]")


def _draw_rejected(axes: Axes, flight: FlightResult, reasons: Sequence[str]) -> None:
    """A row for each sensor, and a marker for each reason."""
    for place, reason in enumerate(reasons):
        marker = MARKERS[min(place, len(MARKERS) - 1)]
        points = [
            (t, row)
            for row, track in enumerate(flight.tracks.values())
            for t, why in zip(track.time_s, track.why, strict=True)
            if why == reason
        ]
        colour, _ = SERIES[place % len(SERIES)]
        axes.plot(*zip(*points, strict=True), marker, color=colour, markerfacecolor="none", label=_words(reason))
    axes.set_yticks(range(len(flight.tracks)), list(flight.tracks))
    axes.set_ylim(len(flight.tracks) - 0.5, -0.5)
    axes.set_title("readings that were not used")
    columns = math.ceil(len(reasons) / 2)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.0, handletextpad=0.2)


def _draw_errors(axes: Axes, flight: FlightResult) -> None:
    """Errors of readings and of the fused distance."""
    for _, track, colour in _coloured(flight):
        errors_cm = 100 * (_numbers(track.raw_m) - _numbers(track.truth_m))
        errors_cm = _unless(track, "at_minimum", errors_cm)
        axes.plot(track.time_s, errors_cm, ".", color=colour, markersize=2, alpha=0.6)
    fused = flight.fused
    errors_cm = 100 * (_numbers(fused.filtered_m) - _numbers(fused.truth_m))
    known = np.isfinite(errors_cm)
    line = _interrupted(_numbers(fused.time_s)[known], _unless(fused, "edge", errors_cm)[known])
    axes.plot(*line, "-", color=INK, linewidth=1)
    axes.set_ylabel("error [cm]")
    axes.set_ylim(-SHOWN_CM, SHOWN_CM)
    of_line = "; line: fused" if known.any() else ""
    axes.set_title(f"error: range minus truth (dots: raw readings{of_line})")


def _what_happened(flight: FlightResult) -> str:
    """The flight in a few words: how many readings were used, silences, and reports to the pilot."""
    whys = [why for track in flight.tracks.values() for why in track.why]
    parts = [f"{sum(why in USED for why in whys)} of {len(whys)} readings used"]
    gaps_s = [late - early for early, late in pairwise(flight.fused.time_s) if late - early > GAP_S]
    if gaps_s:
        parts.append(f"{sum(gaps_s):.1f} s without a distance")
    bad = sum(severity in ("error", "warning") for _, severity, _ in flight.texts)
    if bad:
        parts.append(f"{bad} warning{'s' if bad > 1 else ''} to the pilot")
    return ", ".join(parts)


def _reasons(flight: FlightResult) -> Iterator[str]:
    for track in flight.tracks.values():
        yield from (why for why in track.why if why is not None and why not in USED)


def _words(reason: str) -> str:
    """A reason as a reader knows it; a code with what it stands for."""
    return {"suspect": "255: no echo, garbled?"}.get(reason, reason.replace("_", " "))


def _edges(fused: SensorTrack) -> list[tuple[float, float]]:
    """Spans of time in which the sensors are over different ground [s]."""
    spans: list[tuple[float, float]] = []
    for time_s, why in zip(fused.time_s, fused.why, strict=True):
        if why != "edge":
            continue
        if spans and time_s - spans[-1][1] < GAP_S:
            spans[-1] = (spans[-1][0], time_s)
        else:
            spans.append((time_s, time_s))
    return spans


def _interrupted(time_s: ArrayLike, values: Array) -> tuple[Array, Array]:
    """A line's points, with a gap where there is none for longer than `GAP_S`."""
    at_s = np.asarray(time_s, dtype=float)
    gaps = np.flatnonzero(np.diff(at_s) > GAP_S) + 1
    return np.insert(at_s, gaps, at_s[gaps]), np.insert(values, gaps, np.nan)


def _numbers(values: Sequence[float | None]) -> Array:
    return np.array(values, dtype=float)


def _unless(track: SensorTrack, why: str, values: Array) -> Array:
    """The values, NaN where the track has this reason."""
    return np.where(np.array(track.why, dtype=object) == why, np.nan, values)
