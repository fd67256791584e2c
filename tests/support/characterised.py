"""Readings of a whole campaign and what was found in them, for tests of the report: plain sampling, plain statistics.

Shares no code with the simulator or the analyses. The numbers are those of the characterization report where it has
some.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from msp_lab.characterise.findings import (
    AnglePoint,
    Baseline,
    BreakawayAngle,
    CalibrationFindings,
    CompensationRow,
    FactorEffect,
    FieldOfView,
    Findings,
    HeldOut,
    HotBox,
    HotBoxRow,
    MaximumRange,
    Mixture,
    MixtureParameter,
    Oblique,
    Peak,
    Question,
    SonarFit,
    SonarRow,
    Verdict,
)
from msp_lab.characterise.point_findings import IntervalEstimate, PointResult
from msp_lab.readings.intake import SourceFile
from msp_range.recording.csv_form import MeasuredData
from tests.support.known import known

BASELINE_CM = tuple(range(40, 261, 20))
ANGLES_DEG = tuple(round(1.8 * step, 1) for step in range(-13, 14))
BREAKAWAY_DEG = {50.0: 23.4, 100.0: 18.0, 150.0: 14.4, 200.0: 12.6}
NAN = math.nan


def measured(seed: int = 1, most: int = 20000) -> MeasuredData:
    """The report's campaign: all its conditions, 100 readings a point and `most` at the maximum range."""
    rng = np.random.default_rng(seed)
    parts = list(_campaign(rng, most))
    names = parts[0].keys()
    columns = {name: np.concatenate([part[name] for part in parts]) for name in names}
    columns["time_s"] = np.arange(len(columns["reading_cm"])) * 0.1
    return MeasuredData(columns)


def _campaign(rng: np.random.Generator, most: int) -> Iterator[dict[str, Any]]:
    setup = {range_cm: rng.normal(0.0, 0.15) for range_cm in BASELINE_CM}
    for range_cm in BASELINE_CM:
        yield _point(rng, "baseline", range_cm, setup[range_cm])
    yield _point(rng, "maximum_range", 500, 1.6, n=most, missed=0.03, sigma=1.4, short=0.004, random=0.003)
    for z, angle in BREAKAWAY_DEG.items():
        for theta in ANGLES_DEG:
            beyond = abs(theta) > angle + 0.1
            slant = z / math.cos(math.radians(theta)) - z
            yield _point(
                rng,
                "field_of_view",
                z,
                0.3 * slant,
                n=50,
                missed=0.85 if beyond else 0.01,
                incidence=theta,
                target="wall",
                sigma=0.4 + (3.0 if beyond else 0.0),
            )
    for material in ("plywood", "asphalt", "concrete"):
        for z in BASELINE_CM:
            yield _point(rng, "material", z, rng.normal(0.0, 0.15), target=material, missed=0.004)
    for air_c in (21.1, 46.1, 8.3):
        for z in BASELINE_CM:
            shift = -0.5 * 30.0 * (air_c - 21.1) / 294.0
            yield _point(rng, "temperature", z, shift + rng.normal(0, 0.1), air=air_c, far=21.1)
    for z in (305, 335, 366, 396, 427):
        air_c = 15.5 + rng.normal(0, 0.2)
        yield _point(
            rng, "temperature_compensation", z, z * (math.sqrt(295.65 / (air_c + 273.15)) - 1.0), air=air_c, sigma=0.6
        )
    for z in BASELINE_CM:
        yield _point(rng, "vibration", z, setup[z], vibration=60.0)
    for condition in ("crosstalk_simultaneous", "crosstalk_sequential"):
        for sensor in ("left", "right"):
            for z in BASELINE_CM:
                part = _point(rng, condition, z, 0.0, sensor=sensor)
                if condition.endswith("simultaneous") and sensor == "right":
                    hit = rng.random(len(part["reading_cm"])) < 0.4
                    part["reading_cm"][hit] = np.maximum(np.rint(z * 0.6 - rng.gamma(2.0, 6.0, hit.sum())), 20)
                yield part
    for level in (NAN, 80.0, 110.0):
        for z in BASELINE_CM[::4]:
            yield _point(rng, "external_interference", z, 0.0, missed=0.0 if level < 100 else 0.1, level=level)


def _point(
    rng: np.random.Generator,
    condition: str,
    z: float,
    bias: float,
    n: int = 100,
    missed: float = 0.002,
    sigma: float = 0.45,
    short: float = 0.0,
    random: float = 0.0,
    incidence: float = 0.0,
    target: str = "plywood",
    air: float = 20.5,
    far: float = NAN,
    vibration: float = 0.0,
    sensor: str = "left",
    level: float = NAN,
) -> dict[str, Any]:
    readings = np.rint(rng.normal(z + bias, sigma, n))
    kind = rng.random(n)
    shorts = kind < short
    readings[shorts] = np.rint(rng.uniform(20, z, shorts.sum()))
    spread = (kind >= short) & (kind < short + random)
    readings[spread] = rng.integers(20, 766, spread.sum())
    gone = kind > 1.0 - missed
    readings[gone] = np.where(rng.random(gone.sum()) < 0.25, 255, 765)
    words = {"sensor": sensor, "run": condition, "condition": condition, "target": target}
    numbers = {
        "reading_cm": readings,
        "true_range_cm": z,
        "incidence_deg": incidence,
        "air_temperature_c": air,
        "target_temperature_c": far,
        "vibration_hz": vibration,
        "external_level_db": level,
    }
    columns = {name: np.full(n, word, dtype="<U32") for name, word in words.items()}
    columns |= {name: np.broadcast_to(np.asarray(value, float), n).copy() for name, value in numbers.items()}
    return columns


def _estimate(values: ArrayLike, unit: str = "cm", of: str = "readings") -> IntervalEstimate:
    values = np.asarray(values, float)
    mean, half = float(np.mean(values)), 1.96 * float(np.std(values)) / math.sqrt(values.size)
    return IntervalEstimate(mean, mean - half, mean + half, unit, values.size, of)


def _about(value: float, half: float, unit: str = "") -> IntervalEstimate:
    return IntervalEstimate(value, value - half, value + half, unit, 12, "points")


def found_in(data: MeasuredData) -> Findings:
    """Findings of `measured` readings, by means and counts only."""
    points = tuple(_points(data))
    baseline = tuple(each for each in points if each.condition == "baseline")
    return Findings(
        sensor="MB1242",
        date="2026-10-05",
        calibration_temperature_c=22.5,
        sources=(SourceFile("campaign.csv", "0" * 64, len(data)),),
        points=points,
        baseline=Baseline(
            baseline,
            _about(0.02, 0.07, "cm"),
            _about(0.45, 0.02, "cm"),
            _about(0.13, 0.05, "cm"),
            _about(0.002, 0.002),
            _about(0.0, 0.001),
            2.0,
            1.0,
        ),
        calibration=_calibration(baseline),
        mixture=_mixture(),
        maximum_range=_maximum(data),
        field_of_view=_field_of_view(data),
        sonar=SonarFit(
            9.0023,
            0.0136294,
            5.74512,
            tuple(
                SonarRow(z, angle, fitted, left)
                for (z, angle), fitted, left in zip(
                    BREAKAWAY_DEG.items(), (23.4, 17.9, 14.5, 12.5), (24.5, 17.7, 14.7, 11.7), strict=True
                )
            ),
            tuple((200.0 + 25 * i, max(12.6 - 0.45 * i, 11.3)) for i in range(1, 24)),
            True,
            "Three parameters for four points.",
        ),
        questions=tuple(_questions()),
        hot_boxes=(_box("46 C", 46.1), _box("8 C", 8.3)),
        temperature_compensation=tuple(_compensation(data)),
        warnings=("The reference is a tape measure, good to 0.2 cm.",),
    )


def _points(data: MeasuredData) -> Iterator[PointResult]:
    keys = np.unique(
        np.stack(
            [
                data["condition"],
                data["sensor"],
                data["target"],
                data["true_range_cm"].astype(str),
                data["incidence_deg"].astype(str),
                data["air_temperature_c"].round(1).astype(str),
            ]
        ),
        axis=1,
    )
    for condition, sensor, target, z, incidence, air in keys.T:
        here = (
            (data["condition"] == condition)
            & (data["sensor"] == sensor)
            & (data["target"] == target)
            & (data["true_range_cm"] == float(z))
            & (data["incidence_deg"] == float(incidence))
            & (data["air_temperature_c"].round(1) == float(air))
        )
        readings = data["reading_cm"][here]
        hits = readings[np.abs(readings - float(z)) < 15]
        codes = np.isin(readings, (255, 765))
        yield PointResult(
            condition,
            sensor,
            condition,
            target if condition == "material" else "",
            float(z),
            float(incidence),
            float(air),
            None,
            readings.size,
            hits.size,
            int(np.sum(readings < float(z) - 15)),
            int(np.sum((readings > float(z) + 15) & ~codes)),
            int(np.sum(readings == 765)),
            int(np.sum(readings == 255)),
            0,
            _estimate(hits - float(z)) if hits.size else None,
            _about(0.45, 0.03, "cm"),
            None,
            None,
        )


def _calibration(points: tuple[PointResult, ...]) -> CalibrationFindings:
    return CalibrationFindings(
        "none",
        (),
        "A straight line predicts points that it has not seen no better than nothing does.",
        _about(0.02, 0.07, "cm"),
        _about(-0.05, 0.2, "cm"),
        _about(1.0004, 0.0011),
        _about(0.45, 0.02, "cm"),
        IntervalEstimate(1.0, None, None, "cm", 12),
        "all readings are whole",
        _about(0.3, 0.1, "cm"),
        0.42,
        0.2,
        (
            HeldOut("none", 0.13, None),
            HeldOut("offset and scale", 0.15, _about(-0.005, 0.01, "cm^2")),
            HeldOut("piecewise linear", 0.19, _about(-0.01, 0.01, "cm^2")),
        ),
        "range",
        tuple(each.true_range_cm for each in points),
        tuple(each.true_range_cm + known(each.error).value for each in points),
        tuple(0.045 for _ in points),
    )


def _mixture() -> Mixture:
    parameters = (
        ("weights.hit", 0.963, 0.003, "", 0.96),
        ("weights.short", 0.004, 0.001, "", 0.01),
        ("weights.missed", 0.03, 0.0025, "", 0.02),
        ("weights.random", 0.003, 0.001, "", 0.01),
        ("sigma_cm", 1.4, 0.015, "cm", 1.9445),
        ("short_rate_per_m", 0.12, 0.1, "1/m", 0.5),
        ("saturated_fraction", 0.25, 0.03, "", 0.25),
    )
    counts = np.random.default_rng(3).multinomial(20000, np.full(20, 0.05))
    return Mixture(
        tuple(
            MixtureParameter(name, _about(value, half, unit), before) for name, value, half, unit, before in parameters
        ),
        20000,
        -39000.0,
        tuple(int(each) for each in counts),
        0.41,
        "Nothing was said to depend on range.",
    )


def _maximum(data: MeasuredData) -> MaximumRange:
    readings = data["reading_cm"][data["condition"] == "maximum_range"]
    values, counts = np.unique(readings, return_counts=True)
    pairs = tuple((int(value), int(count)) for value, count in zip(values, counts, strict=True))
    peaks = tuple(Peak(float(code), float(np.mean(readings == code))) for code in (765, 255))
    bulk = Peak(502.0, 0.96)
    return MaximumRange(
        500.0,
        readings.size,
        pairs,
        int(np.sum(readings == 765)),
        int(np.sum(readings == 255)),
        (bulk, *peaks),
        (bulk,),
        IntervalEstimate(502.0, 501.0, 502.0, "cm", readings.size),
    )


def _field_of_view(data: MeasuredData) -> FieldOfView:
    points = []
    chosen = data.select(data["condition"] == "field_of_view")
    for z in BREAKAWAY_DEG:
        for theta in ANGLES_DEG:
            readings = chosen["reading_cm"][(chosen["true_range_cm"] == z) & (chosen["incidence_deg"] == theta)]
            good = np.abs(readings - z) < 6
            share = float(np.mean(good))
            beyond = max(abs(theta) - BREAKAWAY_DEG[z], 0.0)
            points.append(
                AnglePoint(
                    z,
                    theta,
                    readings.size,
                    _about(share, 0.05),
                    share > 0.5,
                    None,
                    z * 1.002 / math.cos(math.radians(theta)),
                    z * 1.002 / math.cos(math.radians(beyond)),
                )
            )
    angles = []
    for z, angle in BREAKAWAY_DEG.items():
        end = angle + 1.8 if angle < 23.4 else None
        side = IntervalEstimate(angle, angle, end, "deg", 27, "points")
        angles.append(BreakawayAngle(z, side, side, side))
    oblique = Oblique(
        "unknown", _about(0.3, 0.05), 1.1, 0.8, "Readings lie between the range along the axis and the nearest point."
    )
    return FieldOfView(
        "More than half of the readings lie within 5 cm of the wall.", tuple(points), tuple(angles), oblique
    )


def _questions() -> Iterator[Question]:
    def effects(bias: float, verdict: Verdict, missed: float = 1.2) -> tuple[FactorEffect, ...]:
        return (
            FactorEffect("bias", _about(bias, 0.12, "cm"), 0.3, 1.0, 0.5, verdict, 0.25),
            FactorEffect(
                "spread",
                IntervalEstimate(1.03, 0.97, 1.09, "", 12, "points"),
                0.3,
                1.0,
                1.25,
                "does not matter",
                1.1,
            ),
            FactorEffect(
                "missed",
                IntervalEstimate(missed, missed / 4, missed * 4, "", 1200),
                0.6,
                1.0,
                2.0,
                "cannot tell",
                4.0,
            ),
            FactorEffect("outliers", None, None, None, 2.0, "cannot tell", None),
        )

    some: tuple[tuple[str, str, str, str, str, float, Verdict], ...] = (
        ("material", "Does the material matter?", "asphalt", "plywood", "", 0.06, "does not matter"),
        ("material", "Does the material matter?", "concrete", "plywood", "", -0.04, "does not matter"),
        ("temperature", "Does hot air at the sensor matter?", "46 C", "21 C", "", -1.25, "matters"),
        ("temperature", "Does cold air at the sensor matter?", "8 C", "21 C", "", 0.63, "matters"),
        ("vibration", "Does vibration matter?", "60 Hz", "0 Hz", "", 0.01, "does not matter"),
        (
            "crosstalk_simultaneous",
            "Do two sensors that ping at once disturb each other?",
            "at once",
            "alone",
            "right",
            -21.0,
            "matters",
        ),
        (
            "crosstalk_sequential",
            "Do two sensors that ping in turn disturb each other?",
            "in turn",
            "alone",
            "right",
            0.0,
            "does not matter",
        ),
        ("external_interference", "Does external ultrasound matter?", "110 dB", "quiet", "", 0.1, "cannot tell"),
    )
    for name, question, level, reference, sensor, bias, verdict in some:
        yield Question(
            name,
            question,
            level,
            reference,
            sensor,
            12,
            effects(bias, verdict),
            verdict,
            f"{level} against {reference}: {bias:+.2f} cm.",
        )


def _box(level: str, box_c: float) -> HotBox:
    rows = tuple(
        HotBoxRow(
            z,
            _about(-0.5 * 30 * (box_c - 21.1) / 294, 0.15, "cm"),
            -0.5 * z * (box_c - 21.1) / 294,
            -0.25 * z * (box_c - 21.1) / 294,
            -0.5 * 30 * (box_c - 21.1) / 294,
        )
        for z in BASELINE_CM
    )
    return HotBox(
        level,
        box_c,
        21.1,
        False,
        _about(30.0, 4.0, "cm"),
        _about(-0.1, 0.1, "%"),
        4.0 if box_c > 21 else -2.2,
        "and not",
        rows,
        "confined",
        f"Air of {box_c:.0f} C over 30 cm before the sensor explains the errors.",
    )


def _compensation(data: MeasuredData) -> Iterator[CompensationRow]:
    chosen = data.select(data["condition"] == "temperature_compensation")
    for z in (305, 335, 366, 396, 427):
        here = (chosen["true_range_cm"] == z) & (np.abs(chosen["reading_cm"] - z) < 20)
        readings, air = chosen["reading_cm"][here], chosen["air_temperature_c"][here]
        compensated = readings * np.sqrt((air + 273.15) / 295.65)
        yield CompensationRow(
            z,
            _estimate(readings - z),
            _estimate(compensated - z),
            float(air.mean()),
            _about(15.4, 0.3, "C"),
            "no thermometer" if z == 305 else "",
        )
