"""Answers with a byte lost or mixed up on the bus: which are taken for the ground's."""

import pytest

from msp_range.fusion.garbled import GarbledAnswers

KNOWN_M2 = 0.01**2
"""With it an answer must be within 7 cm: 4 cm and three deviations."""
UNSURE_M2 = 0.10**2
"""34 cm would be close enough: a ground that is known so badly explains no answer."""


@pytest.mark.parametrize(
    ("answers_m", "off_m"),
    [
        ([5.02], 0.02),
        ([4.94], -0.06),
        ([5.06], 0.06),
        ([5.08], None),
        ([4.92], None),
        # The nearest of several counts, on either side.
        ([7.59, 5.03, 4.98, 7.57], -0.02),
        ([7.59, 4.95], -0.05),
        ([], None),
    ],
)
def test_an_answer_is_garbled_where_it_would_be_the_grounds_without_the_fault(
    answers_m: list[float], off_m: float | None
) -> None:
    found = GarbledAnswers().innovation_m(3.0, answers_m, 5.0, KNOWN_M2)
    assert found == (None if off_m is None else pytest.approx(off_m))


def test_how_close_it_must_be_follows_what_is_known_of_the_ground() -> None:
    assert GarbledAnswers().innovation_m(3.0, [5.14], 5.0, 0.04**2) == pytest.approx(0.14)
    assert GarbledAnswers().innovation_m(3.0, [5.18], 5.0, 0.04**2) is None
    # 0.04 + 3 * 0.069 is just below 25 cm, and one millimetre more of deviation above it.
    assert GarbledAnswers().innovation_m(3.0, [5.01], 5.0, 0.069**2) is not None
    assert GarbledAnswers().innovation_m(3.0, [5.01], 5.0, 0.071**2) is None


def test_on_a_bus_that_garbled_an_answer_others_are_believed_more_easily_for_ten_seconds() -> None:
    def after(wait_s: float, off_m: float) -> float | None:
        answers = GarbledAnswers()
        assert answers.innovation_m(3.0, [5.0], 5.0, KNOWN_M2) is not None
        return answers.innovation_m(3.0 + wait_s, [5.0 + off_m], 5.0, UNSURE_M2)

    assert after(9.9, 0.24) == pytest.approx(0.24)
    assert after(9.9, -0.24) == pytest.approx(-0.24)
    assert after(9.9, 0.26) is None
    assert after(10.1, 0.05) is None
    assert after(10.1, 0.24) is None


def test_each_garbled_answer_begins_the_ten_seconds_anew_and_one_that_is_not_does_not() -> None:
    answers = GarbledAnswers()
    for time_s in (0.0, 8.0, 16.0, 24.0):
        answers.innovation_m(time_s, [5.0], 5.0, KNOWN_M2 if time_s == 0.0 else UNSURE_M2)
    assert answers.innovation_m(32.0, [5.1], 5.0, UNSURE_M2) is not None
    answers = GarbledAnswers()
    answers.innovation_m(0.0, [5.0], 5.0, KNOWN_M2)
    assert answers.innovation_m(8.0, [6.0], 5.0, UNSURE_M2) is None
    assert answers.innovation_m(8.0, [], 5.0, UNSURE_M2) is None
    assert answers.innovation_m(12.0, [5.1], 5.0, UNSURE_M2) is None


def test_a_bus_that_never_garbled_anything_is_not_believed_to() -> None:
    assert GarbledAnswers().innovation_m(0.0, [5.1], 5.0, UNSURE_M2) is None
