"""The plain flights with effects against what a pilot would work out by hand."""

from statistics import fmean, pstdev

import pytest

from tests.support.plain_effects import BASE, EFFECTS, fly

pytestmark = pytest.mark.slow


def errors(hidden: dict[str, dict[str, float]], **where: object) -> list[float]:
    """Of the hits, in the rows that are so."""
    flown = fly(hidden, 10, 200, 1)
    rows = range(len(flown["run"]))
    chosen = [k for k in rows if all(flown[name][k] == word for name, word in where.items())]
    return [
        error
        for k in chosen
        if abs(error := float(flown["reading_cm"][k]) - float(flown["true_range_cm"][k])) < 5.0 * BASE.sigma_cm
    ]


def test_without_effects_it_is_the_plain_sensor() -> None:
    assert fmean(errors({})) == pytest.approx(0.0, abs=0.12)
    assert pstdev(errors({})) == pytest.approx(BASE.sigma_cm, rel=0.06)
    assert fly({}, 2, 3, 5) == fly({}, 2, 3, 5)


def test_a_sensor_that_hangs_lower() -> None:
    hidden = {"mounting_offset": {"offset_cm": 1.5}}
    assert fmean(errors(hidden, sensor="rear")) == pytest.approx(1.5, abs=0.2)
    assert fmean(errors(hidden, sensor="front")) == pytest.approx(0.0, abs=0.2)


def test_rotor_noise_widens() -> None:
    """Throttle is 0.5 in the mean."""
    assert pstdev(errors({"rotor_noise": {"growth": 1.0}})) == pytest.approx(1.5 * BASE.sigma_cm, rel=0.1)


@pytest.mark.parametrize(
    ("name", "values", "code", "share"),
    [
        ("missed_by_target", {"log_odds": 3.0}, 765.0, 0.75 * 0.02 * (2.0 + 20.0 / (1.0 + 0.02 * 19.1)) / 3.0),
        ("lost_high_byte", {"share": 1.0}, 253.0, 0.75 * 0.02),
    ],
)
def test_codes(name: str, values: dict[str, float], code: float, share: float) -> None:
    flown = fly({name: values}, 20, 500, 2)
    assert fmean(each == code for each in flown["reading_cm"]) == pytest.approx(share, rel=0.15)


def test_twice_the_range() -> None:
    flown = fly({"multipath": {"share": 0.5, "sigma_cm": 1.0}}, 10, 100, 3)
    pairs = zip(flown["reading_cm"], flown["true_range_cm"], strict=True)
    near = [abs(float(str(reading)) - 2.0 * float(str(true))) < 4.0 for reading, true in pairs]
    assert fmean(near) == pytest.approx(0.5, abs=0.06)


@pytest.mark.parametrize("name", EFFECTS)
def test_every_effect_does_something(name: str) -> None:
    values = dict.fromkeys(("offset_cm", "delay_ms", "share", "growth", "log_odds"), 1.0)
    values |= {"time_constant_s": 300.0, "sigma_cm": 3.0}
    assert fly({name: values}, 3, 50, 4)["reading_cm"] != fly({}, 3, 50, 4)["reading_cm"]
