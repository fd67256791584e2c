"""A flight as a picture: ranges over time with what was held back, and the errors below where the truth is known."""

from pathlib import Path

from msp_sim.flight.flight_log import Flight
from msp_sim.page.style import GREY, INK, PALE, SERIES, legend_below, new_figure, png, style

SHOWN_CM = 40.0
"""Errors beyond this are not shown [cm]."""
USED = (None, "at_minimum")
"""Why a reading was not held back."""


def draw(flight: Flight, path: Path, title: str) -> None:
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
            held = [(t, raw) for t, raw, _, why in ranges if raw is not None and why not in USED]
            errors_cm = [
                (t, 100 * (raw - truth))
                for t, raw, truth, why in ranges
                if raw is not None and truth is not None and why != "at_minimum"
            ]
            top.plot(*_columns(used), ".", color=colour, markersize=3, label=name)
            top.plot(*_columns(held), "x", color=colour, markersize=5)
            for bottom in below:
                bottom.plot(*_columns(errors_cm), ".", color=colour, markersize=2, alpha=0.6)
        fused = flight.fused
        if fused.time_s:
            heights = list(zip(fused.time_s, fused.filtered_m, fused.truth_m, strict=True))
            truth = [(t, truth) for t, _, truth in heights if truth is not None]
            errors_cm = [(t, 100 * (m - truth)) for t, m, truth in heights if m is not None and truth is not None]
            if truth:
                top.plot(*_columns(truth), "-", color=PALE, linewidth=5, label="truth, down axis", zorder=0)
            top.plot(fused.time_s, fused.filtered_m, "-", color=INK, linewidth=1, label="fused")
            for bottom in below:
                bottom.plot(*_columns(errors_cm), "-", color=INK, linewidth=1)
        top.plot([], [], "x", color=GREY, label="held back")
        top.set_ylabel("range [m]")
        top.set_title(title)
        for bottom in below:
            bottom.set_ylabel("error [cm]")
            bottom.set_ylim(-SHOWN_CM, SHOWN_CM)
            line = "; line: fused" if any(truth is not None for truth in flight.fused.truth_m) else ""
            bottom.set_title(
                f"reading minus truth (dots: as the sensor gave it{line}; beyond {SHOWN_CM:g} cm not shown)"
            )
        (below or [top])[-1].set_xlabel("time [s]")
        legend_below(figure)
        path.write_bytes(png(figure))


def _columns(rows: list[tuple[float, float]]) -> tuple[list[float], list[float]]:
    return [row[0] for row in rows], [row[1] for row in rows]
