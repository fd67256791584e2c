"""Draw a flight: all ranges over time, rejected readings marked, and below them the errors where the truth is known."""

import math
from pathlib import Path

from msp_sim.flight.flight_log import FlightResult
from msp_sim.page.style import GREY, INK, PALE, SERIES, legend_below, new_figure, png, style

SHOWN_CM = 40.0
"""Half height of the lower plot [cm]: the errors of hits fill it, and outliers of metres are left out."""
USED = (None, "at_minimum")
"""Values of `Track.why` for readings that the filter used."""


def draw(flight: FlightResult, path: Path, title: str) -> None:
    """Write the picture of a flight as PNG; an older file is replaced."""
    with style():
        tracks = (*flight.tracks.values(), flight.fused)
        is_truth_known = any(truth is not None for track in tracks for truth in track.truth_m)
        figure = new_figure(6.5 if is_truth_known else 4.5, 9.6)
        ratios = (3, 2) if is_truth_known else (3,)
        top, *below = figure.subplots(len(ratios), 1, sharex=True, squeeze=False, height_ratios=ratios)[:, 0]
        for number, (name, track) in enumerate(flight.tracks.items()):
            colour, _ = SERIES[number % len(SERIES)]
            ranges = list(zip(track.time_s, track.raw_m, track.truth_m, track.why, strict=True))
            used = [(t, raw) for t, raw, _, why in ranges if raw is not None and why in USED]
            rejected = [(t, raw) for t, raw, _, why in ranges if raw is not None and why not in USED]
            errors_cm = [
                (t, 100 * (raw - truth))
                for t, raw, truth, why in ranges
                if raw is not None and truth is not None and why != "at_minimum"
            ]
            top.plot(*_columns(used), ".", color=colour, markersize=3, label=name)
            top.plot(*_columns(rejected), "x", color=colour, markersize=5)
            for bottom in below:
                bottom.plot(*_columns(errors_cm), ".", color=colour, markersize=2, alpha=0.6)
        fused = flight.fused
        if fused.time_s:
            heights = list(zip(fused.time_s, fused.filtered_m, fused.truth_m, fused.why, strict=True))
            truth = [(t, truth) for t, _, truth, _ in heights if truth is not None]
            # At an edge of the ground the sensors are over different heights: no error there, and a gap in the line.
            errors_cm = [
                (t, math.nan if why == "edge" else 100 * (m - truth))
                for t, m, truth, why in heights
                if m is not None and truth is not None
            ]
            if truth:
                top.plot(*_columns(truth), "-", color=PALE, linewidth=5, label="true distance (fused)", zorder=0)
            top.plot(fused.time_s, fused.filtered_m, "-", color=INK, linewidth=1, label="fused")
            for bottom in below:
                bottom.plot(*_columns(errors_cm), "-", color=INK, linewidth=1)
        top.plot([], [], "x", color=GREY, label="rejected")
        top.set_ylabel("range [m]")
        top.set_title(title)
        for bottom in below:
            bottom.set_ylabel("error [cm]")
            bottom.set_ylim(-SHOWN_CM, SHOWN_CM)
            line = "; line: fused, interrupted at edges of the ground" if any(flight.fused.truth_m) else ""
            bottom.set_title(f"error: range minus truth (dots: raw readings{line})")
        (below or [top])[-1].set_xlabel("time [s]")
        legend_below(figure)
        path.write_bytes(png(figure))


def _columns(rows: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [row[0] for row in rows], [row[1] for row in rows]
