"""The report's figures by number, each drawn from these readings with the report's own numbers in it.

A figure is a picture of `msp_lab.characterise.page` under the report's title, with a remark on what the report shows
there or gets wrong.
"""

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, range_error
from msp_lab.characterise.page.picture_data import Drawn, Entry, Maker, PictureData
from msp_lab.characterise.page.text import interval, number
from msp_lab.characterise.question_findings import CompensationRow
from msp_lab.comparison.report import MATERIALS, REPORT, implied_temperature_c
from msp_sim.page.page import PageTable

_TEMPERATURES = (
    (16, "room", "70 °F, no errors to speak of."),
    (17, "hot", "115 °F in the box, errors of 1 to 2 cm."),
    (18, "cold", "47 °F in the box, readings somewhat too far."),
)
_DENSITIES = (
    (3, "hit", "measurement noise", "eq 9; the probability of a whole centimetre is the integral over it (erratum 6)"),
    (4, "short", "unexpected obstacles", "eq 10; it has to end at the expected range (erratum 6)"),
    (5, "missed", "maximum range", "eq 11, a narrow interval; a missed echo is a code, and so a point mass"),
    (6, "random", "random measurement", "eq 12, which begins at 0; the sensor reports nothing under 20 cm"),
)


def entries() -> Iterator[Entry]:
    """Yield the figures of chapters 4 and 5 in their order, each with what the report shows there in its caption."""
    for name, title, make, remark in (*_chapter_4(), *_chapter_5()):
        yield name, title, _with(make, remark) if remark else make


_Figure = tuple[str, str, Maker, str]
"""Name, title, the picture, and what the report shows there."""


def _chapter_4() -> Iterator[_Figure]:
    largest = f"largest error {REPORT.largest_error_cm:g} cm apart from missed readings."
    yield "figure_4_04_range_error", "Figure 4.4: range error, all ranges", range_error.baseline, largest
    two_codes = "2000 readings at 500 cm, with missed ones that read 765 and 255."
    multi_modal = "the same two codes, and the histogram multi-modal for them."
    for figure, make, what, remark in (
        (5, longest_range.in_order, "measurements", two_codes),
        (6, longest_range.histogram, "histogram", multi_modal),
        (7, longest_range.in_order, "measurements, missed reports masked", ""),
        (8, longest_range.histogram, "histogram, missed reports masked", f"a peak near {REPORT.peak_cm:g} cm."),
    ):
        name = f"figure_4_{figure:02d}_maximum_range"
        yield name, f"Figure 4.{figure}: maximum range {what}", partial(make, masked=figure > 6), remark
    for figure, (range_cm, angle_deg) in enumerate(REPORT.half_angle_deg.items(), start=9):
        name = f"figure_4_{figure:02d}_field_of_view_{range_cm:g}cm"
        title = f"Figure 4.{figure}: field of view at {range_cm:g} cm"
        yield name, title, partial(field_of_view.sweep, range_cm=range_cm), f"{angle_deg:g}°."
    indistinguishable = "plywood, asphalt and concrete cannot be distinguished."
    range_error_of = "Figure 4.{}: range error, {}".format
    for figure, material in enumerate(MATERIALS, start=13):
        make = partial(range_error.material, name=material)
        yield f"figure_4_{figure}_{material}", range_error_of(figure, f"{material} target"), make, indistinguishable
    for figure, kind, remark in _TEMPERATURES:
        make = partial(range_error.temperature, kind=kind)
        yield f"figure_4_{figure}_{kind}", range_error_of(figure, f"{kind} temperature"), make, remark
    as_baseline = "at 60 Hz effectively the same as the baseline."
    yield "figure_4_19_vibration", range_error_of(19, "vibration"), range_error.vibration, as_baseline
    for figure, how, remark in (
        (20, "simultaneous", "sensor 2 reads short, because it receives the earlier ping of sensor 1."),
        (21, "sequential", "the errors go away, at the price of the rate."),
    ):
        make = partial(range_error.crosstalk, condition=f"crosstalk_{how}")
        yield f"figure_4_{figure}_{how}", range_error_of(figure, f"two sensors, {how} transmission"), make, remark
    external = "Section 4.3.8: range error, external ultrasound"
    yield "section_4_3_8_external", external, range_error.external, "no figure, since its test was inconclusive."


def _chapter_5() -> Iterator[_Figure]:
    for figure, what, how in ((1, "uncompensated", "without"), (2, "compensated", "with")):
        title = f"Figure 5.{figure}: ranging {how} temperature compensation"
        yield f"figure_5_{figure:02d}_{what}", title, partial(air.range_errors, after=how == "with"), ""
    yield "table_5_1_compensation", "Table 5.1 as a picture", air.compensation, _mean_errors()
    for figure, kind, title, remark in _DENSITIES:
        make = partial(mixture.density, kind=kind)
        yield f"figure_5_{figure:02d}_{kind}", f"Figure 5.{figure}: {title} density", make, f"{remark}."


def table_5_1(findings: Findings) -> PageTable | None:
    """Return Table 5.1 next to the report's; None without rows."""
    rows = findings.temperature_compensation
    if not rows:
        return None

    def cells(row: CompensationRow) -> tuple[str, ...]:
        pair = REPORT.mean_errors_at(row.range_cm) or (None, None)
        return (
            f"{row.range_cm:g}",
            interval(row.uncompensated),
            "–" if row.compensated is None else interval(row.compensated),
            number(row.implied_c.value, 1),
            number(pair[0], 3),
            number(pair[1], 3),
            number(implied_temperature_c(row.range_cm), 1),
        )

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
        rows=tuple(cells(row) for row in rows),
        caption=(
            "In brackets 95 % intervals. Implied air: the one air temperature that would bring the mean error to 0, "
            "and for the report the one that takes its uncompensated number to its compensated one with a calibration "
            "at 20 °C (erratum 12). The report's row at 305 cm has the same error twice: it was not compensated."
        ),
        words=0,
    )


def _mean_errors() -> str:
    pairs = REPORT.mean_error_cm.values()
    before, after = (sum(each[i] for each in pairs) / len(pairs) for i in (0, 1))
    return f"mean size {before:.2f} cm without compensation and {after:.2f} cm with it."


def _with(make: Maker, remark: str) -> Maker:
    """The picture with what the report shows there in its caption."""

    def made(findings: Findings, rows: PictureData) -> Drawn:
        drawn = make(findings, rows)
        return replace(drawn, caption=f"{drawn.caption} The report: {remark}")

    return made
