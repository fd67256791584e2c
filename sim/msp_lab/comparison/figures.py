"""The report's figures by number, each drawn from these readings with the report's own numbers in it.

A figure is a picture of `msp_lab.characterise.page` under the report's title, with a remark on what the report shows
there or gets wrong.
"""

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

import numpy as np

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, range_error
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.tables import compensation_cells
from msp_lab.comparison.report import MATERIALS, REPORT, implied_temperature_c
from msp_sim.page.page import Drawn, Entry
from msp_sim.page.table import PageTable
from msp_sim.page.text import number

_TWO_SENSORS = (
    (20, "simultaneous", "sensor 2 reads short, because it receives the earlier ping of sensor 1."),
    (21, "sequential", "the errors go away, at the price of the rate."),
)
_DENSITIES = (
    (3, "hit", "measurement noise", "eq 9; the probability of a whole centimetre is the integral over it (erratum 6)."),
    (4, "short", "unexpected obstacles", "eq 10; it has to end at the expected range (erratum 6)."),
    (5, "missed", "maximum range", "eq 11, a narrow interval; a missed echo is a code, and so a point mass."),
    (6, "random", "random measurement", "eq 12, which begins at 0; the sensor reports nothing under 20 cm."),
)

Figure = tuple[str, str, Callable[..., Drawn], Any, str]
"""File, title, function that draws it, its argument (None: it has none), and what the report shows there."""


def entries(rows: PictureData) -> Iterator[Entry]:
    """Yield the figures of chapters 4 and 5 in their order."""
    for name, title, draw, of, remark in _figures():
        yield name, title, partial(_with_remark, draw, [rows] if of is None else [rows, of], remark)


def _figures() -> Iterator[Figure]:
    remark = f"largest error {REPORT.largest_error_cm:g} cm apart from missed readings."
    yield "figure_4_04_range_error", "Figure 4.4: range error, all ranges", range_error.baseline, None, remark
    remark = "2000 readings at 500 cm, with missed ones that read 765 and 255."
    yield "figure_4_05_maximum_range", "Figure 4.5: maximum range measurements", longest_range.one_by_one, False, remark
    name, title = "figure_4_06_maximum_range", "Figure 4.6: maximum range histogram"
    yield name, title, longest_range.histogram, False, "the same two codes, and the histogram multi-modal for them."
    name, title = "figure_4_07_maximum_range", "Figure 4.7: maximum range measurements, missed reports masked"
    yield name, title, longest_range.one_by_one, True, ""
    name, title = "figure_4_08_maximum_range", "Figure 4.8: maximum range histogram, missed reports masked"
    yield name, title, longest_range.histogram, True, f"a peak near {REPORT.peak_cm:g} cm."
    for figure, (range_cm, angle_deg) in enumerate(REPORT.half_angle_deg.items(), start=9):
        name = f"figure_4_{figure:02d}_field_of_view_{range_cm:g}cm"
        title = f"Figure 4.{figure}: field of view at {range_cm:g} cm"
        yield name, title, field_of_view.sweep, range_cm, f"{angle_deg:g}°."
    remark = "plywood, asphalt and concrete cannot be distinguished."
    for figure, material in enumerate(MATERIALS, start=13):
        title = f"Figure 4.{figure}: range error, {material} target"
        yield f"figure_4_{figure}_{material}", title, range_error.material, material, remark
    name, title = "figure_4_16_room", "Figure 4.16: range error, room temperature"
    yield name, title, range_error.temperature, "room", "70 °F, no errors to speak of."
    name, title = "figure_4_17_hot", "Figure 4.17: range error, hot temperature"
    yield name, title, range_error.temperature, "hot", "115 °F in the box, errors of 1 to 2 cm."
    name, title = "figure_4_18_cold", "Figure 4.18: range error, cold temperature"
    yield name, title, range_error.temperature, "cold", "47 °F in the box, readings somewhat too far."
    name, title = "figure_4_19_vibration", "Figure 4.19: range error, vibration"
    yield name, title, range_error.vibration, None, "at 60 Hz effectively the same as the baseline."
    for figure, how, remark in _TWO_SENSORS:
        title = f"Figure 4.{figure}: range error, two sensors, {how} transmission"
        yield f"figure_4_{figure}_{how}", title, range_error.crosstalk, f"crosstalk_{how}", remark
    name, title = "section_4_3_8_external", "Section 4.3.8: range error, external ultrasound"
    yield name, title, range_error.external, None, "no figure, since its test was inconclusive."
    name, title = "figure_5_01_uncompensated", "Figure 5.1: ranging without temperature compensation"
    yield name, title, air.range_errors, False, ""
    yield "figure_5_02_compensated", "Figure 5.2: ranging with temperature compensation", air.range_errors, True, ""
    before, after = np.mean(list(REPORT.mean_error_cm.values()), axis=0)
    remark = f"mean size {before:.2f} cm without compensation and {after:.2f} cm with it."
    yield "table_5_1_compensation", "Table 5.1 as a picture", air.compensation, None, remark
    for figure, kind, title, remark in _DENSITIES:
        yield f"figure_5_{figure:02d}_{kind}", f"Figure 5.{figure}: {title} density", mixture.density, kind, remark


def _with_remark(draw: Callable[..., Drawn], data: Sequence[Any], remark: str) -> Drawn:
    """The picture with what the report shows there in its caption."""
    figure, caption = draw(*data)
    return figure, f"{caption} The report: {remark}" if remark else caption


def table_5_1(findings: Findings) -> PageTable:
    """Return Table 5.1 next to the report's."""
    return PageTable(
        name="table_5_1",
        title="Table 5.1: mean range error without and with temperature compensation",
        header=(
            "range [cm]",
            "uncompensated [cm]",
            "compensated [cm]",
            "implied air [°C]",
            "report: uncompensated [cm]",
            "report: compensated [cm]",
            "report: implied air [°C]",
        ),
        rows=tuple(
            (
                *compensation_cells(row),
                number(row.implied_c.value, 1),
                *(number(error_cm, 3) for error_cm in REPORT.mean_errors_at(row.range_cm) or (None, None)),
                number(implied_temperature_c(row.range_cm), 1),
            )
            for row in findings.temperature_compensation
        ),
        caption=(
            "In brackets 95 % intervals. Implied air: the one air temperature that would bring the mean error to 0, "
            "and for the report the one that takes its uncompensated number to its compensated one with a calibration "
            "at 20 °C (erratum 12). The report's row at 305 cm has the same error twice: it was not compensated."
        ),
        align="r",
    )
