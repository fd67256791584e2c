"""Where a finding shows: the slices that it changes, and the place in words, of what a plain sampler was given."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from msp_lab.gap.cells import partitions
from msp_lab.gap.findings import FittedValue, FoundEffect, GapFindings, UnknownEffect, Verdict
from msp_lab.gap.measures import HeldOutReadings, Measures, measure, replicates
from msp_lab.gap.slices import located, ranked
from msp_sim.model.model import Model, Term, load_model, make_curve_term, make_term
from tests.support.measured import MODEL, readings

GIVEN = load_model(MODEL)
COUNT = len(GIVEN.effects)


def step(columns: dict[str, Any]) -> np.ndarray:
    return np.where(columns["throttle"] > 0.7, 1.5, 0.0)


def tables(bias: Any = step, n: int = 3000, **more: Any) -> HeldOutReadings:
    columns = readings(n, 3, bias=bias)
    contexts = {name: columns[name] for name in ("true_range_cm", "throttle")} | more
    return HeldOutReadings(columns["reading_cm"], contexts, (np.arange(n) * 50 // n).astype(np.intp))


def shown_by(model: Model, table: HeldOutReadings) -> Measures:
    parts = partitions(table.contexts)
    return measure(model, table, parts, replicates(model, table, parts, 5, np.random.default_rng(7)))


def effect(name: str, of: str | None = None) -> FoundEffect:
    return FoundEffect(name, "named", {"x": FittedValue(1.0, 0.9, 1.1, "cm")}, 0.1, 9.0, of=of)


OVER_THROTTLE = make_curve_term("bias", ["throttle"], [[0.0, 0.69, 0.71, 1.0]], [0.0, 0.0, 1.5, 1.5])
THROTTLE = UnknownEffect("bias", ("throttle",), "", 0.1, z=9.0)


def found(
    table: HeldOutReadings, *terms: Term, verdict: Verdict = "explained", **parts: tuple[Any, ...]
) -> GapFindings:
    slices = ranked(shown_by(GIVEN, table), np.random.default_rng(1))
    extended = replace(GIVEN, effects=(*GIVEN.effects, *terms))
    findings = GapFindings(
        verdict, 3000, 50, slices=slices, effects=parts.get("effects", ()), unknown=parts.get("unknown", ())
    )
    return located(findings, extended, COUNT, shown_by(extended, table))


def over(findings: GapFindings, column: str) -> dict[str, bool]:
    return {each.where: each.differs for each in findings.slices if each.variables == (column,)}


def test_all_slices_of_one_column_are_listed_and_those_that_a_finding_changes_differ() -> None:
    findings = found(tables(), OVER_THROTTLE, unknown=(THROTTLE,))
    throttle = over(findings, "throttle")
    assert len(throttle) == 12
    for where, differs in throttle.items():
        low, high = map(float, where.removeprefix("throttle ").split(" to "))
        if not low < 0.7 < high:
            assert differs == (low > 0.69), where
    by = {each.by for each in findings.slices if each.variables == ("throttle",)}
    assert by == {(), ("curve of bias over throttle",)}
    # It moves readings at all ranges, by 0.45 cm on average.
    assert all(over(findings, "true_range_cm").values())
    assert findings.unknown[0].where.startswith("throttle from 0.")
    assert 0.6 < float(findings.unknown[0].where.removeprefix("throttle from ")) < 0.75


def test_noise_that_is_sure_by_accident_is_nowhere_once_all_is_explained() -> None:
    """A slice with a small p-value, which nothing that was found changes."""
    table = tables()
    columns = dict(table.contexts)
    columns["humidity_pct"] = np.where(np.arange(3000) % 2, 30.0, 70.0)
    table = replace(table, contexts=columns, reading_cm=table.reading_cm + 2.0 * (columns["humidity_pct"] == 30.0))
    scale = make_term("missed_with_range", None, {"log_odds_per_m": 0.0, "from_cm": 20.0})
    cases: tuple[tuple[Verdict, bool], ...] = (("explained", False), ("partly explained", True))
    for verdict, expected in cases:
        findings = found(table, scale, verdict=verdict, effects=(effect("missed_with_range"),))
        assert over(findings, "humidity_pct")["humidity_pct 30"] is expected
        assert findings.effects[0].where == ""


def test_before_anything_is_found_slices_differ_by_their_p_values() -> None:
    findings = found(tables(), OVER_THROTTLE, verdict="unexplained")
    for each in findings.slices:
        assert each.differs == (each.p_value is not None and each.p_value < 0.05)
        assert each.by == ()
    assert any(over(findings, "throttle").values())


def test_what_is_only_suggested_says_where_and_changes_no_slice() -> None:
    table = tables(lambda columns: 0.01 * columns["true_range_cm"])
    scale = make_term("range_scale", None, {"scale_pct": 1.0})
    other = make_term("missed", None, {"log_odds": 0.0})
    suggested = replace(effect("range_scale"), verdict="suggested")
    for one, by in ((suggested, {()}), (effect("range_scale"), {("range_scale",)})):
        findings = found(table, scale, other, effects=(one, effect("missed")))
        assert {each.by for each in findings.slices if each.variables == ("true_range_cm",)} == by
        # 1 % of 40 cm is 0.4 cm and of 500 cm 5 cm.
        assert findings.effects[0].where.startswith("everywhere, most at true range from 2")
        assert findings.effects[0].where.endswith(" cm")


@pytest.mark.parametrize(
    ("column", "moved", "where"),
    [
        (["left", "right", "front", "rear"], {"left": 2.0}, "sensor left"),
        (["left", "right"], {"left": 2.0, "right": 0.0}, "sensor left"),
    ],
)
def test_a_place_of_words(column: list[str], moved: dict[str, float], where: str) -> None:
    sensor = np.array(column)[np.arange(3000) % len(column)]
    table = tables(lambda _: np.array([moved.get(each, 0.0) for each in sensor]), sensor=sensor)
    term = make_term("mounting_offset", "left", {"offset_cm": 2.0})
    findings = found(table, term, effects=(effect("mounting_offset", "left"),))
    assert findings.effects[0].where == where
    assert over(findings, "sensor") == {f"sensor {each}": each == "left" for each in column}


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ([1.5, 1.5, 0.0, 0.0, 1.5], "battery 1, 2 and 5"),
        ([1.5, 1.5, 1.5, 1.5, 1.5], "everywhere"),
        ([0.0, 0.0, 0.0, 0.0, 0.0], ""),
        ([0.6, 0.6, 1.5, 0.6, 0.6], "everywhere, most at battery 3"),
        ([1.5, 0.6, 1.5, 0.6, 1.5], "everywhere"),
    ],
)
def test_a_place_of_a_few_numbers(values: list[float], where: str) -> None:
    battery = 1.0 + np.arange(3000) % 5
    table = tables(lambda _: np.array(values)[battery.astype(int) - 1], battery=battery)
    term = make_curve_term("bias", ["battery"], [[1.0, 2.0, 3.0, 4.0, 5.0]], values)
    findings = found(table, term, unknown=(UnknownEffect("bias", ("battery",), "", 0.1, z=9.0),))
    assert findings.unknown[0].where == where


def test_ranges_have_the_digits_in_which_they_differ_and_many_are_counted() -> None:
    """A board that warms by 0.4 °C; what changes with every second twelfth of that is at no one place."""
    board_c = np.linspace(41.05, 41.45, 3000)[np.random.default_rng(1).permutation(3000)]
    knots = np.linspace(41.05, 41.45, 13)
    for values, expected in (
        (np.where(np.arange(13) > 9, 1.5, 0.0), "board temperature from 41.35 °C"),
        (np.where(np.arange(13) % 4 > 1, 1.5, 0.0), "of 12 parts of board temperature 41.05 to 41.45 °C"),
    ):
        off_cm = np.interp(board_c, knots, values)
        table = tables(lambda _, off_cm=off_cm: off_cm, board_temperature_c=board_c)
        term = make_curve_term("bias", ["board_temperature_c"], [knots.tolist()], values.tolist())
        unknown = UnknownEffect("bias", ("board_temperature_c",), "", 0.1, z=9.0)
        assert expected in found(table, term, unknown=(unknown,)).unknown[0].where


def test_a_ripple_is_everywhere() -> None:
    term = make_curve_term("bias", ["true_range_cm"], [{"period": 23.0}], [1.0, 1.0])
    table = tables(lambda columns: np.sqrt(2.0) * np.cos(2.0 * np.pi * columns["true_range_cm"] / 23.0 - np.pi / 4.0))
    unknown = UnknownEffect("bias", ("true_range_cm",), "", 0.1, z=9.0, period=23.0)
    assert found(table, term, unknown=(unknown,)).unknown[0].where == "everywhere"
    assert found(table, term, unknown=(replace(unknown, period=9.0),)).unknown[0].where == "", "another one"


def test_two_ranges_of_a_number_with_its_unit() -> None:
    tilt_deg = np.linspace(-15.0, 15.0, 3000)[np.random.default_rng(1).permutation(3000)]
    term = make_term("slant_range", None, {"share": 1.0})
    table = tables(
        lambda columns: columns["true_range_cm"] * (1.0 / np.cos(np.radians(tilt_deg)) - 1.0), incidence_deg=tilt_deg
    )
    findings = found(table, term, effects=(effect("slant_range"),))
    where = findings.effects[0].where
    assert where.startswith("incidence up to -")
    assert " and from " in where
    assert where.endswith("°")
    assert ", most up to -7" in where
