"""Draw a flight: all ranges over time, below them which readings were not used and why, and the errors where the truth
is known."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import cycle, product
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from msp_range.arrays import Array
from msp_sim.flight.flight_log import USED, FlightResult, SensorTrack
from msp_sim.page.style import GREY, INK, PALE, SERIES, new_panels, save, shaded, style

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
    tracks = {name: _Arrays(track) for name, track in flight.tracks.items()}
    fused = _Arrays(flight.fused)
    is_truth_known = any(np.isfinite(track.truth_m).any() for track in (*tracks.values(), fused))
    reasons = [reason for reason, _ in sum(flight.rejected.values(), Counter[str]()).most_common()]
    ratios = [3.0, *([0.25 * len(tracks) + 0.1] if reasons else []), *([2.0] if is_truth_known else [])]
    figure, panels = new_panels(1.5 + 1.25 * sum(ratios), len(ratios), width_in=9.6, sharex=True, height_ratios=ratios)
    _draw_ranges(panels[0], tracks, fused)
    panels[0].set_title(f"{title}: {_what_happened(flight)}")
    if reasons:
        _draw_rejected(panels[1], tracks, reasons)
    if is_truth_known:
        _draw_errors(panels[-1], tracks, fused)
    for span, axes in product(_edges(fused), panels):
        axes.axvspan(*span, label="sensors over different ground", **shaded())
    panels[-1].set_xlabel("time [s]")
    save(figure, path)


class _Arrays:
    """The columns of a track, NaN where nothing is known."""

    def __init__(self, track: SensorTrack) -> None:
        self.time_s, self.raw_m, self.filtered_m, self.truth_m = (
            np.array(column, dtype=float) for column in (track.time_s, track.raw_m, track.filtered_m, track.truth_m)
        )
        self.why = np.array(track.why, dtype=object)

    def errors_cm(self, values_m: Array, without: str) -> Array:
        """Errors of values; NaN where the track has a reason for which they are none."""
        return np.where(self.why == without, np.nan, 100.0 * (values_m - self.truth_m))


def _draw_ranges(top: Axes, tracks: Mapping[str, _Arrays], fused: _Arrays) -> None:
    """Readings that were used, and the fused distance on the true one."""
    for (name, track), (colour, _) in zip(tracks.items(), cycle(SERIES), strict=False):
        used = np.array([why in USED for why in track.why], dtype=bool)
        top.plot(track.time_s[used], track.raw_m[used], ".", color=colour, markersize=3, label=name)
        top.plot(track.time_s[~used], track.raw_m[~used], "x", color=colour, markersize=5)
    top.plot([], [], "x", color=GREY, label="a range that was not used")
    if np.isfinite(fused.truth_m).any():
        # Where the sensors are over different ground no single distance is true.
        truth = _interrupted(fused.time_s, np.where(fused.why == "edge", np.nan, fused.truth_m))
        top.plot(*truth, color=PALE, linewidth=5, label="true distance (fused)", zorder=0)
    if fused.time_s.size:
        top.plot(*_interrupted(fused.time_s, fused.filtered_m), color=INK, linewidth=1, label="fused")
    top.set_ylabel("range [m]")


def _draw_rejected(axes: Axes, tracks: Mapping[str, _Arrays], reasons: Sequence[str]) -> None:
    """A row for each sensor, and a marker for each reason."""
    for place, reason in enumerate(reasons):
        rows = [np.full(np.count_nonzero(track.why == reason), row) for row, track in enumerate(tracks.values())]
        times_s = np.concatenate([track.time_s[track.why == reason] for track in tracks.values()])
        marker, (colour, _) = MARKERS[min(place, len(MARKERS) - 1)], SERIES[place % len(SERIES)]
        # A reason as a reader knows it; a code with what it stands for.
        words = {"suspect": "255: no echo, garbled?"}.get(reason, reason.replace("_", " "))
        axes.plot(times_s, np.concatenate(rows), marker, color=colour, fillstyle="none", label=words)
    axes.set_yticks(range(len(tracks)), list(tracks))
    axes.set(ylim=(len(tracks) - 0.5, -0.5), title="readings that were not used")
    columns = math.ceil(len(reasons) / 2)
    axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=columns, borderaxespad=0.0, handletextpad=0.2)


def _draw_errors(axes: Axes, tracks: Mapping[str, _Arrays], fused: _Arrays) -> None:
    """Errors of readings and of the fused distance."""
    for track, (colour, _) in zip(tracks.values(), cycle(SERIES), strict=False):
        errors_cm = track.errors_cm(track.raw_m, "at_minimum")
        axes.plot(track.time_s, errors_cm, ".", color=colour, markersize=2, alpha=0.6)
    known = np.isfinite(fused.errors_cm(fused.filtered_m, ""))
    line = _interrupted(fused.time_s[known], fused.errors_cm(fused.filtered_m, "edge")[known])
    axes.plot(*line, color=INK, linewidth=1)
    of_line = "; line: fused" if known.any() else ""
    axes.set(ylabel="error [cm]", ylim=(-SHOWN_CM, SHOWN_CM))
    axes.set_title(f"error: range minus truth (dots: raw readings{of_line})")


def _what_happened(flight: FlightResult) -> str:
    """The flight in a few words: how many readings were used, silences, and reports to the pilot."""
    readings = sum(len(track.why) for track in flight.tracks.values())
    used = readings - sum(each.total() for each in flight.rejected.values())
    parts = [f"{used} of {readings} readings used"]
    gaps_s = np.diff(flight.fused.time_s)
    silent_s = float(np.sum(gaps_s[gaps_s > GAP_S]))
    if silent_s:
        parts.append(f"{silent_s:.1f} s without a distance")
    bad = sum(severity in ("error", "warning") for _, severity, _ in flight.texts)
    if bad:
        parts.append(f"{bad} warning{'s' if bad > 1 else ''} to the pilot")
    return ", ".join(parts)


def _edges(fused: _Arrays) -> list[tuple[float, float]]:
    """Spans of time in which the sensors are over different ground [s]."""
    at_s = fused.time_s[fused.why == "edge"]
    spans = np.split(at_s, np.flatnonzero(np.diff(at_s) >= GAP_S) + 1)
    return [(float(span[0]), float(span[-1])) for span in spans if span.size]


def _interrupted(time_s: Array, values: Array) -> tuple[Array, Array]:
    """A line's points, with a gap where there is none for longer than `GAP_S`."""
    gaps = np.flatnonzero(np.diff(time_s) > GAP_S) + 1
    return np.insert(time_s, gaps, time_s[gaps]), np.insert(values, gaps, np.nan)
