"""The first sentence is for a pilot, and the lines say how sure it is, what to do next, and the numbers."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from msp_lab.gap.before_after import mean_hold_s, possible_causes, reading_age
from msp_lab.gap.conclusion import with_words
from msp_lab.gap.findings import (
    Alternative,
    CalibrationFinding,
    FittedValue,
    FoundEffect,
    GapFindings,
    Measure,
    PossibleCause,
    ReadingAge,
    UnknownEffect,
)
from msp_lab.gap.measures import HeldOutReadings, residual_autocorrelation
from msp_lab.gap.runs import previous
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_sim.effects import CATALOGUE
from msp_sim.effects.own import effects_of_file
from msp_sim.effects.plain import plain_finding
from msp_sim.model.model import Model
from msp_sim.model.trial import strong_values
from tests.support.measured import MODEL, readings
from tests.unit.test_gap_findings import gap

OWN = Path(__file__).parents[1] / "third_party" / "package" / "sonar_extras" / "supply_sag.py"
PLAIN = Model.of(load_sensor_model(MODEL).model_copy(update={"effects": ()}))


def effect(name: str, gain: float = 0.1, verdict: str = "named", **values: float) -> FoundEffect:
    units = {each.name: each.unit for each in CATALOGUE[name].parameters}
    fitted = {key: FittedValue(value, 0.9 * value, 1.1 * value, units[key]) for key, value in values.items()}
    return FoundEffect(name, verdict, fitted, gain, 9.0, experiment=CATALOGUE[name].experiment)  # type: ignore[arg-type]


LATE = effect("latency", 0.2, delay_ms=325.0)
REPEATED = effect("stale", 0.1, share=0.74)


def findings(**changes: object) -> GapFindings:
    measured = replace(gap(0.015), nats_per_reading=Measure(0.5, 0.015, 0.01))
    return replace(GapFindings("explained", 2000, 10, measured, (REPEATED, LATE)), **changes)  # type: ignore[arg-type]


def test_the_first_sentence_is_for_a_pilot() -> None:
    assert with_words(findings()).sentence == (
        "Readings are 0.33 s behind the reference and three of four readings are repeats of the one before; "
        "that is all of the disagreement that these readings can show."
    )


def test_with_many_findings_the_largest_three_are_in_the_sentence() -> None:
    many = tuple(effect("clutter", 0.01 * k, share=0.01, location_cm=10.0 * k, sigma_cm=2.0) for k in range(1, 6))
    said = with_words(findings(effects=many)).sentence
    assert "at 50 cm, 1 % of readings are of something at 40 cm and 1 % of readings are of something at 30 cm" in said
    assert "20 cm" not in said
    assert "and there are 2 more findings" in said


def test_what_is_only_suggested_is_not_in_the_sentence() -> None:
    doubted = replace(LATE, verdict="suggested", doubt="delay_ms may be 0")
    said = with_words(findings(effects=(REPEATED, doubted)))
    assert "behind" not in said.sentence
    alone = with_words(findings(effects=(doubted,), verdict="unexplained"))
    assert alone.sentence.endswith("it may be that readings are 0.33 s behind the reference.")
    assert alone.next_step.startswith("to decide whether readings are 0.33 s behind the reference (delay_ms may be 0)")


def test_alternatives_are_in_the_sentence_and_the_session_that_decides_is_next() -> None:
    scale = effect("range_scale", verdict="indistinguishable", scale_pct=0.8)
    scale = replace(scale, alternatives=(Alternative("bend", 1.0),), experiment="to tell range_scale from bend: X")
    said = with_words(findings(effects=(scale,)))
    assert said.sentence.startswith("Ranges read 0.8 % too long (or it is bend); ")
    assert said.next_step == "msp-lab design DIR plans the session that decides: range scale or bend"


def test_there_are_at_most_five_lines_and_they_have_the_numbers() -> None:
    number = CalibrationFinding("sigma_cm", "sigma_cm is 2.1", 1.9, 2.1, 2.0, 2.2, "cm")
    said = with_words(findings(age=ReadingAge(0.326, 0.146), calibration=(number,) * 5))
    assert len(said.summary) == 5
    assert said.summary == (
        f"How sure: {said.how_sure}",
        f"Next: {said.next_step}",
        "Gap 0.5 to 0.015 nats per reading (noise floor 0.01)",
        "Bias 2 to 0.05 cm (noise floor 0.06); spread off by a factor 1 (noise floor 1.1)",
        "A reading is 0.47 s old: 0.33 s behind the reference, held for 0.15 s on average. Refitted: scatter (sigma) "
        "1.9 to 2.1 cm, scatter (sigma) 1.9 to 2.1 cm, scatter (sigma) 1.9 to 2.1 cm and 2 more",
    )


def test_a_bias_that_grew_is_a_warning() -> None:
    grown = replace(gap(0.015), bias_cm=Measure(3.9, 16.6, 0.9))
    said = with_words(findings(gap=grown, verdict="partly explained"))
    assert said.next_step == "find out why the bias grew to 16.6 cm before you fly with this model"


def test_an_unknown_effect_has_its_size_and_the_column_that_would_name_it() -> None:
    curve = ((0.0, -0.5, -0.6, -0.4), (50.0, 1.5, 1.4, 1.6))
    unknown = UnknownEffect(
        "bias", ("neighbour_lag_ms",), "x", 0.3, curve, (("crosstalk", "neighbour_range_cm"),), z=8.0
    )
    said = with_words(findings(effects=(), unknown=(unknown,), verdict="partly explained"))
    assert said.sentence == (
        "The error changes by 2 cm over the neighbour lag in an unknown way; that is 97 % of the disagreement, and the "
        "rest is not explained."
    )
    assert said.next_step == (
        "record neighbour_range_cm: crosstalk needs it and depends on the same neighbour lag, a likely cause"
    )


@pytest.mark.parametrize(("size", "words"), [(2.0, "by a factor of 7.4"), (8.1, "by at least a factor of 1,000")])
def test_odds_that_are_as_good_as_certain_have_no_measured_factor(size: float, words: str) -> None:
    unknown = UnknownEffect("random", ("throttle",), "x", 0.3, ((0.0, -size, -9.0, 9.0), (1.0, 0.0, -9.0, 9.0)), z=8.0)
    said = with_words(findings(effects=(), unknown=(unknown,), verdict="partly explained"))
    assert said.sentence.startswith(f"The share of random readings changes {words} over the throttle in an unknown way")


@pytest.mark.parametrize(
    ("low", "high", "why", "next_step"),
    [
        (
            0.45,
            0.55,
            "throttle did not vary enough to say why",
            "to see whether it is rotor noise: the vehicle tied down over a floor, with",
        ),
        (0.0, 1.0, "no recorded column says why", "record more context"),
    ],
)
def test_what_calibration_absorbs_is_not_nothing(low: float, high: float, why: str, next_step: str) -> None:
    """More scatter and more short readings over a throttle that hardly changes may be rotor noise and prop wash."""
    numbers = (
        CalibrationFinding("sigma_cm", "", 1.9, 2.4, 2.3, 2.5, "cm"),
        CalibrationFinding("weights.short", "", 0.01, 0.04, 0.03, 0.05),
    )
    # All columns that could show a cause, spread out, but the throttle as it is given.
    contexts = {"throttle": np.linspace(low, high, 100)}
    for each in ("incidence_deg", "vibration_hz"):
        contexts[each] = np.linspace(-40.0, 200.0, 100)
    causes = possible_causes(numbers, PLAIN, contexts)
    assert {each.effect for each in causes if each.column == "throttle"} == (
        {"rotor_noise", "prop_wash"} if high - low < 0.5 else set()
    )
    said = with_words(findings(verdict="absorbed", effects=(), calibration=numbers, causes=causes))
    assert said.sentence == f"The disagreement is absorbed in scatter (sigma) and short readings; {why}."
    assert said.next_step.startswith(next_step)


def test_a_column_that_was_not_recorded_comes_after_one_that_did_not_vary() -> None:
    numbers = (CalibrationFinding("sigma_cm", "", 1.9, 2.4, 2.3, 2.5, "cm"),)
    causes = possible_causes(numbers, PLAIN, {"incidence_deg": np.zeros(50)})
    assert (causes[0].column, causes[0].recorded) == ("incidence_deg", True)
    assert {each.column for each in causes[1:]} == {"throttle", "vibration_hz"}
    assert not any(each.recorded for each in causes[1:])


def test_no_column_makes_the_scatter_smaller() -> None:
    assert not possible_causes((CalibrationFinding("sigma_cm", "", 1.0, 0.2, 0.18, 0.22, "cm"),), PLAIN, {})


@pytest.mark.parametrize(("spread_cm", "asked"), [(5.0, True), (100.0, False)])
def test_an_offset_may_be_a_scale_where_the_range_hardly_varied(spread_cm: float, asked: bool) -> None:
    numbers = (CalibrationFinding("offset_cm", "", 0.0, 2.0, 1.8, 2.2, "cm"),)
    contexts = {"true_range_cm": np.linspace(200.0 - spread_cm, 200.0 + spread_cm, 1000)}
    causes = possible_causes(numbers, PLAIN, contexts)
    assert [each.effect for each in causes if each.column == "true_range_cm"] == ["range_scale"] * asked
    if asked:
        # The plainest first.
        assert causes[0] == PossibleCause("offset_cm", "range_scale", "true_range_cm", True, causes[0].experiment)
        said = with_words(findings(verdict="absorbed", effects=(), calibration=numbers, causes=causes))
        assert said.sentence.endswith("constant offset; true range did not vary enough to say why.")
        assert said.next_step.startswith("to see whether it is range scale: ranges from 50 to 500 cm")


def test_every_effect_has_its_own_words_with_its_number() -> None:
    for each in CATALOGUE.values():
        one, other = (plain_finding(each, strong_values(each, size), "front") for size in (0.1, 0.3))
        assert each.finding
        assert one != other, f"{each.name} says the same of another size"
        assert not one.endswith(".")
        assert "{" not in one


def test_an_own_effect_brings_its_words_along() -> None:
    (own,) = effects_of_file(OWN)
    assert plain_finding(own, {"sag_pct": 2.5}) == "full throttle makes ranges 2.5 % too short"
    without = replace(own, finding="")
    assert plain_finding(without, {"sag_pct": 2.5}).endswith("ranges read too short (sag pct 2.5 %)")


def held(n: int, rows_per_value: int, delay_s: float, rng: np.random.Generator) -> HeldOutReadings:
    """A target in steady motion, whose readings are late and each of which stays for some rows of 0.1 s."""
    time_s = 0.1 * np.arange(n)
    rate = np.where(np.arange(n) // 100 % 2 == 0, 40.0, -40.0)
    range_cm = 100.0 + np.cumsum(rate) * 0.1 + 400.0 * (rate[0] < 0.0)
    measured_s = time_s - 0.1 * (np.arange(n) % rows_per_value)
    fresh = np.round(np.interp(measured_s - delay_s, time_s, range_cm) + rng.normal(0.0, 2.0, n))
    reading_cm = fresh[np.arange(n) - np.arange(n) % rows_per_value]
    contexts = {"time_s": time_s, "true_range_cm": range_cm, "range_rate_cm_s": rate}
    contexts["previous_reading_cm"] = previous(contexts, reading_cm)
    return HeldOutReadings(reading_cm, contexts, np.zeros(n, dtype=np.intp))


@pytest.mark.parametrize("rows_per_value", [1, 3, 5])
def test_the_age_of_a_reading_is_latency_and_mean_hold(rows_per_value: int) -> None:
    table = held(3000, rows_per_value, 0.3, np.random.default_rng(1))
    share = 1.0 - 1.0 / rows_per_value
    model = PLAIN.adding("latency", delay_ms=300.0).adding("stale", share=max(share, 1e-6))
    expected_s = 0.1 * (rows_per_value - 1) / 2.0
    assert mean_hold_s(model, table) == pytest.approx(expected_s, abs=0.015)
    age = reading_age(findings(), model, table)
    assert age is not None
    assert age.total_s == pytest.approx(0.325 + expected_s, abs=0.015)
    assert reading_age(findings(effects=(LATE,)), model, table) is None
    doubted = replace(REPEATED, verdict="suggested")
    assert reading_age(findings(effects=(LATE, doubted)), model, table) is None


def test_autocorrelation_is_there_before_and_gone_after() -> None:
    """Noise that is alike from one reading to the next, against a model without and with that correlation."""
    sensor = load_sensor_model(MODEL)
    mixture = sensor.reading_model.model_copy(update={"correlation": 0.7, "correlation_spacing_s": 0.1})
    right = Model.of(sensor.model_copy(update={"reading_model": mixture, "effects": ()}))
    columns = readings(3000, 2)
    contexts = {name: column for name, column in columns.items() if name != "reading_cm"}
    reading_cm = right.sample(contexts, np.random.default_rng(4))
    table = HeldOutReadings(reading_cm, contexts, np.zeros(3000, dtype=np.intp))
    before, after = (residual_autocorrelation(each, table, np.random.default_rng(5)) for each in (PLAIN, right))
    assert before.apart[:3] == pytest.approx([0.1, 0.2, 0.3])
    assert 0.45 < before.value[0] < 0.72
    assert before.value[0] > before.value[1] > before.value[2] > before.band[2]
    assert np.abs(after.value).max() < 2.0 * after.band[0]
