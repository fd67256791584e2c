"""Pictures of many readings at the longest range: in the order in which they came, and how often each was read."""

from collections.abc import Iterator
from functools import partial

import numpy as np

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.draw.readings import FixedRange, draw_histogram, draw_in_order
from msp_lab.characterise.page.picture_data import Absent, Drawn, Entry, PictureData, placement_error_cm
from msp_lab.characterise.page.text import are, interval
from msp_range.arrays import Array
from msp_range.reading_model.mixture import ReadingModel

PEAK_RANGE_CM = 1.0
"""A reference's peak is marked where its true range is this near to the one of the readings [cm]."""


def entries() -> Iterator[Entry]:
    """Yield the pictures in the page's order."""
    for masked in (False, True):
        without = ", without codes for no echo" if masked else ""
        end = "_masked" if masked else ""
        for name, title, draw in (("in_order", "in order", in_order), ("histogram", "histogram", histogram)):
            title = f"Readings at the longest range, {title}{without}"
            yield f"longest_range_{name}{end}", title, partial(draw, masked=masked)


def _fixed_range(rows: PictureData) -> FixedRange:
    try:
        found = rows.of("maximum_range")
    except Absent as absent:
        raise Absent(f"{absent} It takes many readings of a large target at one long range.") from None
    ranges, counts = np.unique(rows.true_cm[found], return_counts=True)
    # Of several long ranges the one with the most readings, and of equal ones the longest.
    best = float(ranges[np.lexsort((ranges, counts))[-1]])
    chosen = found & (rows.true_cm == best)
    return FixedRange(best, rows.reading_cm[chosen], rows.missed[chosen])


def _readings(rows: PictureData, masked: bool) -> FixedRange:
    fixed = _fixed_range(rows)
    if masked and not fixed.kept_cm.size:
        raise Absent(f"All {fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm are codes for no echo.")
    if not np.any(np.isfinite(fixed.reading_cm)):
        raise Absent(f"None of the {fixed.reading_cm.size:,} pings at {fixed.true_range_cm:g} cm was answered.")
    return fixed


def _missed_percent(fixed: FixedRange) -> float:
    return 100.0 * np.count_nonzero(fixed.missed) / fixed.reading_cm.size


def in_order(findings: Findings, rows: PictureData, masked: bool) -> Drawn:
    """Draw the readings in order, with or without (``masked``) codes for no echo."""
    fixed = _readings(rows, masked)
    caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm"
    caption += f", of which {_missed_percent(fixed):.2g} % are codes for no echo" + (
        ", left out here." if masked else "."
    )
    return Drawn(
        draw_in_order(fixed, masked), caption, "Readings at the longest range in the order in which they came."
    )


def histogram(findings: Findings, rows: PictureData, masked: bool) -> Drawn:
    """Draw the histogram, with or without (``masked``) codes for no echo."""
    fixed, found, earlier = _readings(rows, masked), findings.maximum_range, rows.reference
    fitted = _probabilities(findings, rows, fixed.true_range_cm) if masked and findings.mixture is not None else None
    marked = None
    if earlier is not None and abs(fixed.true_range_cm - earlier.peak_range_cm) < PEAK_RANGE_CM:
        marked = earlier.name, earlier.peak_cm
    figure = draw_histogram(fixed, masked, fitted, marked)
    if found is None:
        caption = f"{fixed.reading_cm.size:,} readings at {fixed.true_range_cm:g} cm, "
        caption += f"{_missed_percent(fixed):.2g} % codes for no echo."
    elif masked:
        caption = f"Without the codes there {are(len(found.peaks_after), 'peak')}, at {interval(found.peak)}."
        if fitted is not None:
            caption += " Circles: what the mixture, fitted about these hits' own mean, expects in each centimetre."
    else:
        caption = (
            f"There {are(len(found.peaks_before), 'peak')}: "
            + ", ".join(f"{peak.reading_cm:g} cm ({100.0 * peak.share:.2g} %)" for peak in found.peaks_before)
            + f". {found.no_echo:,} readings of {rows.model.maximum_cm} and {found.saturated:,} of 255 are missed "
            "echoes."
        )
    return Drawn(figure, caption, "How often each centimetre was read at the longest range.")


def _probabilities(findings: Findings, rows: PictureData, true_cm: float) -> Array:
    """Probability of each reading from 0 cm on by the fitted model, about the range that the fit took it to be."""
    expected_cm = float(np.mean(rows.apparent_cm[rows.of("maximum_range") & (rows.true_cm == true_cm)]))
    expected_cm += placement_error_cm(findings, "maximum_range", true_cm)
    readings = np.arange(0.0, rows.model.maximum_cm + 1.0)
    model = ReadingModel.of(rows.model)
    return np.exp(model.log_prob(readings, {"true_range_cm": np.full(readings.size, expected_cm)}))
