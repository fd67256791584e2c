"""Pictures of the report's section 5.1 and 5.2.1: figures 5.1 to 5.6, and Table 5.1."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from msp_lab.characterise.findings import CompensationRow, Estimate, Findings, Mixture
from msp_lab.characterise.report.chapter4 import Entry, interval
from msp_lab.characterise.report.draw.accuracy import Compensated, draw_compensated
from msp_lab.characterise.report.draw.errors import ErrorAxes, Line, draw_errors, shared_limits_cm
from msp_lab.characterise.report.draw.mixture import (
    KINDS,
    Densities,
    draw_hit,
    draw_missed,
    draw_mixture,
    draw_random,
    draw_short,
)
from msp_lab.characterise.report.rows import Absent, Drawn, Rows, sentence, set_up_error_cm, summary
from msp_lab.characterise.temperature import REPORT_TABLE
from msp_range.acoustics.air import compensate_range
from msp_range.reading_model.mixture import ReadingModel
from msp_range.reading_model.sensor_model import SATURATED_CM
from msp_sim.page.page import PageTable

_MIXTURE_PARAMETERS = {
    "hit": ("weights.hit", "sigma_cm", "sigma_growth_cm_per_m"),
    "short": ("weights.short", "short_rate_per_m"),
    "missed": ("weights.missed", "saturated_fraction", "missed_growth_per_m"),
    "random": ("weights.random",),
}
"""Kind of reading -> its parameters, by their names in the sensor model file."""

_SYMBOLS = {
    "weights.hit": "z_hit",
    "weights.short": "z_short",
    "weights.missed": "z_max",
    "weights.random": "z_rand",
    "sigma_cm": "σ_hit",
    "short_rate_per_m": "λ_short",
}
"""Parameter -> its symbol in Probabilistic Robotics (Thrun, Burgard & Fox 2005, section 6.3)."""


def entries() -> Iterator[Entry]:
    """The section's pictures in its order."""
    yield (
        "figure_5_01_uncompensated",
        "Figure 5.1: ranging without temperature compensation",
        partial(_range, after=False),
    )
    yield "figure_5_02_compensated", "Figure 5.2: ranging with temperature compensation", partial(_range, after=True)
    yield "table_5_1_compensation", "Table 5.1 as a picture: what compensation takes away", _table_picture
    for number, kind, title in (
        (3, "hit", "measurement noise density"),
        (4, "short", "unexpected obstacles density"),
        (5, "missed", "maximum range density"),
        (6, "random", "random measurement density"),
    ):
        yield f"figure_5_{number:02d}_{kind}", f"Figure 5.{number}: {title}", partial(_density, kind=kind)


def _compensated_cm(rows: Rows) -> NDArray[np.float64]:
    """Readings after eq 7; NaN where the air's temperature is unknown."""
    air_c = rows.number("air_temperature_c")
    return 100.0 * compensate_range(rows.reading_cm / 100.0, air_c, rows.model.calibration_temperature_c)


def _range(findings: Findings, rows: Rows, after: bool) -> Drawn:
    found = rows.of("temperature_compensation")
    air_c = rows.number("air_temperature_c")
    known = found & np.isfinite(air_c)
    if after and not np.any(known):
        raise Absent("The readings have no air temperature (column air_temperature_c), and nothing can be compensated.")
    before = rows.errors(found)
    errors = rows.errors(known, reading_cm=_compensated_cm(rows)) if after else before
    everything = [before, rows.errors(known, reading_cm=_compensated_cm(rows))] if np.any(known) else [before]
    ranges = np.array(sorted(REPORT_TABLE), dtype=np.float64)
    report_cm = np.array([REPORT_TABLE[each][int(after)] for each in sorted(REPORT_TABLE)])
    low, high = shared_limits_cm(everything)
    limits = min(low, float(np.min(report_cm)) - 0.8), max(high, float(np.max(report_cm)) + 0.8)
    tested = np.unique(before.true_range_cm)
    # The report's points where they can be compared: next to a range that was measured.
    near = np.array([np.min(np.abs(tested - each)) <= 2.0 for each in ranges])
    points = [Line("the report's mean error (Table 5.1)", ranges[near], report_cm[near])] if np.any(near) else []
    figure = draw_errors([errors], ErrorAxes(limits_cm=limits, points=points))
    caption = summary(errors)
    if np.any(known):
        temperatures = air_c[known]
        caption += (
            f" Air {np.min(temperatures):.1f} to {np.max(temperatures):.1f} °C; the sensor assumes "
            f"{rows.model.calibration_temperature_c:g} °C."
        )
    return Drawn(
        figure, caption, f"Range error over true range {'with' if after else 'without'} temperature compensation."
    )


def table_5_1(findings: Findings) -> PageTable | None:
    """Table 5.1 beside the report's; None without rows."""
    rows = findings.temperature_compensation
    if not rows:
        return None

    def cells(row: CompensationRow) -> tuple[str, ...]:
        return (
            f"{row.range_cm:g}",
            interval(row.uncompensated),
            "–" if row.compensated is None else interval(row.compensated),
            "–" if row.thermometer_c is None else f"{row.thermometer_c:.1f}",
            f"{row.implied_c.value:.1f}",
            _number(row.report_uncompensated_cm, 3),
            _number(row.report_compensated_cm, 3),
            _number(row.report_implied_c, 1),
        )

    notes = " ".join(f"{row.range_cm:g} cm: {row.note}." for row in rows if row.note)
    return PageTable(
        name="table_5_1",
        title="Table 5.1: mean range error without and with temperature compensation",
        header=(
            "range [cm]",
            "uncompensated [cm]",
            "compensated [cm]",
            "thermometer [°C]",
            "implied air [°C]",
            "report: uncompensated [cm]",
            "report: compensated [cm]",
            "report: implied air [°C]",
        ),
        rows=tuple(cells(row) for row in rows),
        caption=(
            "In brackets 95 % intervals. Implied air: the one air temperature that would bring the mean error to 0, "
            "and for the report the one that takes its uncompensated number to its compensated one with a calibration "
            f"at 20 °C. {notes}"
        ),
        words=0,
    )


def _table_picture(findings: Findings, rows: Rows) -> Drawn:
    table = findings.temperature_compensation
    if not table:
        raise Absent(
            findings.absent.get("temperature_compensation", "No readings of temperature compensation are in the data.")
        )

    def column(pick: Callable[[CompensationRow], float | None]) -> NDArray[np.float64]:
        values = (pick(row) for row in table)
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)

    def after(pick: Callable[[Estimate], float | None]) -> NDArray[np.float64]:
        return column(lambda row: None if row.compensated is None else pick(row.compensated))

    picture = Compensated(
        range_cm=column(lambda row: row.range_cm),
        before_cm=column(lambda row: row.uncompensated.value),
        before_low_cm=column(lambda row: row.uncompensated.low),
        before_high_cm=column(lambda row: row.uncompensated.high),
        after_cm=after(lambda compensated: compensated.value),
        after_low_cm=after(lambda compensated: compensated.low),
        after_high_cm=after(lambda compensated: compensated.high),
        report_before_cm=column(lambda row: row.report_uncompensated_cm),
        report_after_cm=column(lambda row: row.report_compensated_cm),
    )
    after_cm = picture.after_cm[np.isfinite(picture.after_cm)]
    caption = f"Mean size of the error of the ranges: {np.mean(np.abs(picture.before_cm)):.2f} cm without compensation"
    caption += f", {np.mean(np.abs(after_cm)):.2f} cm with it." if after_cm.size else "."
    report = np.array(list(REPORT_TABLE.values()))
    caption += f" The report's: {np.mean(report[:, 0]):.2f} and {np.mean(report[:, 1]):.2f} cm."
    return Drawn(draw_compensated(picture), caption, "Mean errors by range, without and with compensation.")


def densities(findings: Findings, rows: Rows) -> tuple[Densities, NDArray[np.float64]]:
    """The fitted mixture at one range, and the probability of each reading by all of it.

    Raises
    ------
    Absent
        Nothing was fitted.
    """
    if findings.mixture is None:
        raise Absent(sentence(findings.absent.get("mixture", "the mixture was not fitted")))
    condition, true_cm = _one_range(rows)
    chosen = rows.of(condition) & (rows.true_cm == true_cm)
    minimum_cm, maximum_cm = rows.model.minimum_cm, rows.model.maximum_cm
    k = np.arange(float(minimum_cm), maximum_cm + 1.0)
    # About the range that the fit took it to be.
    apparent_cm = float(np.mean(rows.apparent_cm[chosen])) + set_up_error_cm(findings, condition, true_cm)
    contexts = {"true_range_cm": np.full(k.size, apparent_cm)}
    whole = ReadingModel.of(rows.model)
    mixture = whole.rows(contexts["true_range_cm"])
    hit, short, _, random = mixture.kinds(k, k)
    # The garbled code is drawn with the mass that it comes from.
    missed = np.exp(replace(mixture, log_weights=(-np.inf, -np.inf, 0.0, -np.inf)).log_prob(k))
    density = dict(zip(KINDS, (hit.p, short.p, missed, random.p), strict=True))
    # The model knows whole centimetres within the sensor's limits, and so do the counts.
    readings = np.rint(rows.reading_cm[chosen])
    readings = readings[(readings >= minimum_cm) & (readings <= maximum_cm)].astype(int) - minimum_cm
    counts = np.bincount(readings, minlength=k.size).astype(np.float64)
    peak_cm = float(np.sum(k * density["hit"]))
    fitted = Densities(
        true_range_cm=peak_cm,
        reading_cm=k,
        density=density,
        weight={kind: float(share) for kind, share in zip(KINDS, whole.shares(apparent_cm), strict=True)},
        counts=counts if readings.size else None,
    )
    return fitted, np.exp(whole.log_prob(k, contexts))


def _one_range(rows: Rows) -> tuple[str, float]:
    """Condition and true range: most readings of the maximum range, else a middle one of the baseline."""
    condition = "maximum_range"
    try:
        found = rows.of(condition)
    except Absent:
        condition = "baseline"
        found = rows.of(condition)
    ranges, counts = np.unique(rows.true_cm[found], return_counts=True)
    much = ranges[counts >= 0.5 * np.max(counts)]
    return condition, float(much[much.size // 2])


def _density(findings: Findings, rows: Rows, kind: str) -> Drawn:
    fitted, total = densities(findings, rows)
    assert findings.mixture is not None
    caption = _parameters(findings.mixture, kind)
    if kind == "hit":
        figure = draw_hit(fitted)
        caption += " Report eq 9; here the probability of a whole centimetre is the integral over it (erratum 6)."
    elif kind == "short":
        figure = draw_short(fitted)
        caption += " Report eq 10; here it ends at the expected range and is normalised up to there (erratum 6)."
    elif kind == "missed":
        codes = _codes(rows)
        figure = draw_missed(fitted, {code: float(total[fitted.reading_cm == code][0]) for code in codes})
        caption += " Report eq 11; here a point mass, since a missed echo is a code and not a narrow interval."
    else:
        figure = draw_random(fitted)
        caption += f" Report eq 12, which begins at 0; this sensor reports nothing under {rows.model.minimum_cm} cm."
    return Drawn(figure, caption, f"The fitted density of {kind} readings, with what was read.")


def _codes(rows: Rows) -> list[float]:
    """Readings that mean no echo [cm]."""
    garbled = rows.model.reading_model.saturated_fraction > 0.0
    return [float(rows.model.maximum_cm), *([float(SATURATED_CM)] if garbled else [])]


def draw_whole_mixture(findings: Findings, rows: Rows) -> Drawn:
    """All four densities together."""
    fitted, total = densities(findings, rows)
    assert findings.mixture is not None
    caption = (
        f"The fitted mixture at {fitted.true_range_cm:.0f} cm and what was read there. Fitted to "
        f"{findings.mixture.readings:,} readings. {sentence(findings.mixture.conditional)}"
    )
    return Drawn(
        draw_mixture(fitted, total, _codes(rows)), caption, "Probability of each centimetre by the fitted mixture."
    )


def mixture_table(mixture: Mixture) -> PageTable:
    """The fitted parameters with intervals, and what the model said before."""
    return PageTable(
        name="mixture_parameters",
        title="Parameters of the mixture",
        header=("parameter", "Thrun", "fitted, 95 % interval", "before"),
        rows=tuple(
            (
                each.name,
                _SYMBOLS.get(each.name, "–"),
                interval(each.fitted),
                "–" if each.before is None else f"{each.before:.4g}",
            )
            for each in mixture.parameters
        ),
        caption=" ".join(
            [
                f"Maximum likelihood from {mixture.readings:,} readings, names as in the sensor model file. The report "
                "gives no values: in its quiet room it saw none of the noise that the mixture describes, and added it.",
                *map(sentence, mixture.notes),
            ]
        ),
    )


def _parameters(mixture: Mixture, kind: str) -> str:
    found = {each.name: each.fitted for each in mixture.parameters}
    shown = [f"{name} = {interval(found[name])}" for name in _MIXTURE_PARAMETERS[kind] if name in found]
    return f"Fitted: {'; '.join(shown)}." if shown else ""


def _number(value: float | None, digits: int) -> str:
    return "–" if value is None else f"{value:.{digits}f}".replace("-", "−")
