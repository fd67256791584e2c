"""What a person is shown while a point is read: outliers, doubts, and nothing where all is well."""

from collections import Counter

import numpy as np
import pytest

from msp_lab.campaigns.terminal import histogram
from msp_lab.campaigns.watch import FIRST_LOOK, Outlier, PointWatch
from msp_range.reading import Reading, Status


def reading(reading_cm: float) -> Reading:
    if reading_cm == 765:
        return Reading(0.0, "a", Status.NO_ECHO, raw=765)
    return Reading(0.0, "a", Status.OK, reading_cm / 100, raw=reading_cm, suspect=reading_cm == 255)


def watched(*readings_cm: float, expected_cm: float = 120.0) -> tuple[PointWatch, list[Outlier]]:
    watch = PointWatch("a", (expected_cm, expected_cm))
    return watch, [found for each in readings_cm if (found := watch.update(reading(each))) is not None]


def test_quiet_readings_raise_no_doubt() -> None:
    watch, found = watched(*np.rint(np.random.default_rng(1).normal(120.0, 0.5, 500)).astype(int).tolist())
    assert (found, watch.warnings()) == ([], [])
    assert watch.median_cm == 120


def test_noise_is_not_called_outliers() -> None:
    watch, found = watched(*np.rint(np.random.default_rng(2).normal(300.0, 8.0, 2000)).astype(int).tolist())
    assert len(found) <= 2
    assert watch.median_cm == pytest.approx(300, abs=1)


def test_what_is_far_beyond_the_noise_is_an_outlier() -> None:
    noise = np.rint(np.random.default_rng(3).normal(300.0, 2.0, 200)).astype(int).tolist()
    _, found = watched(*noise, 318, 282)
    # 6 standard deviations of 2 cm.
    assert [each.reading_cm for each in found] == [318, 282]


def test_an_outlier_is_flagged_as_it_comes() -> None:
    _, found = watched(*[120] * FIRST_LOOK, 187, 64, 255)
    assert [(each.number, each.reading_cm) for each in found] == [(9, 187), (10, 64), (11, 255)]
    assert [each.why for each in found] == [
        "67 cm longer than the others",
        "56 cm shorter than the others",
        "a missed echo reported as 255, or an object there",
    ]


def test_255_at_255_is_no_outlier() -> None:
    _, found = watched(*[255] * 50, expected_cm=255.0)
    assert found == []


def test_missed_echoes_and_faults_are_counted_apart() -> None:
    watch, _ = watched(*[120] * 20, 765, 765)
    watch.update(Reading(0.0, "a", Status.CLOCK_FAULT, raw=0x8000 | 120))
    watch.update(Reading(0.0, "a", Status.NO_ANSWER))
    assert (watch.read, watch.no_echo, watch.failed.total()) == (22, 2, 2)
    assert watch.warnings() == [
        "a: no echo in 2 of 22 readings",
        "a: 1 pings without a usable answer (clock_fault), asked again",
        "a: 1 pings without a usable answer (no_answer), asked again",
    ]


@pytest.mark.parametrize(("read_cm", "doubted"), [(120, False), (128, False), (131, True), (107, True)])
def test_a_median_that_does_not_fit_the_reference(read_cm: int, doubted: bool) -> None:
    watch, _ = watched(*[read_cm] * 10)
    assert any("the reference is 120 cm" in doubt for doubt in watch.warnings()) == doubted


def test_beyond_the_beam_nothing_is_reported_of_the_reference() -> None:
    watch, _ = watched(*[765] * 30, 400, 401)
    assert not any("reference" in doubt for doubt in watch.warnings())


@pytest.mark.parametrize("values", [[5], [5, 6], [5, 5, 9], [1, 2, 3, 4], [7, 7, 8, 8], [1, 1, 1, 9, 9, 9]])
def test_median_of_counts(values: list[int]) -> None:
    watch, _ = watched(*[each + 100 for each in values])
    assert watch.median_cm == np.median(values) + 100


def labels_and_counts(watch: PointWatch) -> list[list[str]]:
    return [[str(cell).strip() for cell in histogram(watch).columns[i].cells] for i in (0, 2)]


def test_the_histogram_has_a_line_for_each_centimetre_and_one_for_the_rest() -> None:
    watch, _ = watched(*[120] * 30, *[122] * 4, 60, 400, 765)
    labels, counts = labels_and_counts(watch)
    assert labels == ["shorter", "120 cm", "121 cm", "122 cm", "longer", "no echo"]
    assert counts == ["1", "30", "0", "4", "1", "1"]


def test_readings_in_millimetres_are_counted_by_the_centimetre() -> None:
    watch, _ = watched(120.4, 119.8, 120.3, 121.2)
    assert labels_and_counts(watch) == [["120 cm", "121 cm"], ["3", "1"]]


def test_the_median_of_many_readings_is_found_from_their_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The screen asks for it several times a second, all night."""
    watch, _ = watched(*[120, 121, 122] * 40, 187)

    def no_readings(counts: Counter[int]) -> None:
        raise AssertionError("all readings are gone through")

    monkeypatch.setattr(Counter, "elements", no_readings)
    assert watch.median_cm == 121.0
