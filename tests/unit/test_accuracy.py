"""Baseline accuracy, and peaks at the longest range before and after missed echoes are masked."""

import numpy as np
import pytest

from msp_lab.characterise.accuracy import baseline, longest_reliable_cm, maximum_range, peaks
from msp_lab.characterise.points import sort_into_points
from tests.support.known import contains
from tests.support.plain_bench import point, table
from tests.support.shipped import SENSOR


def test_765_and_255_are_masked_to_one_peak() -> None:
    rng = np.random.default_rng(1)
    part = point(
        rng,
        500,
        n=20_000,
        error_cm=3.0,
        sigma_cm=1.5,
        missed=0.02,
        saturated=0.006,
        stray=0.01,
        condition="maximum_range",
    )
    found = maximum_range(sort_into_points(table(part), SENSOR), SENSOR)
    assert found is not None
    assert [each.reading_cm for each in found.peaks_before] == [503.0, 765.0, 255.0]
    assert [each.reading_cm for each in found.peaks_after] == [503.0]
    assert (found.no_echo, found.saturated) == (
        (part["reading_cm"] == 765).sum(),
        (part["reading_cm"] == 255).sum(),
    )
    assert contains(found.peak, 503.0)
    assert sum(count for _, count in found.histogram) == found.readings == 20_000


def test_a_peak_between_two_centimetres_is_reported_as_both() -> None:
    readings = np.repeat([502.0, 503.0, 504.0, 505.0], [100, 1000, 960, 90])
    part = point(np.random.default_rng(3), 500, n=readings.size, condition="maximum_range") | {"reading_cm": readings}
    found = maximum_range(sort_into_points(table(part), SENSOR), SENSOR)
    assert found is not None
    # 1000 and 960 differ by less than 1.96 times the root of their sum, 87.
    assert (found.peak.low, found.peak.value, found.peak.high) == (503.0, 503.0, 504.0)


def test_two_surfaces_stay_two_peaks() -> None:
    rng = np.random.default_rng(2)
    two = np.concatenate([np.rint(rng.normal(503, 1.5, 900)), np.rint(rng.normal(470, 1.5, 300))])
    found = peaks(two, 745.0)
    assert [abs(each.reading_cm - at) <= 1 for each, at in zip(found, (503, 470), strict=True)] == [True, True]
    assert [each.share for each in found] == pytest.approx([0.75, 0.25], abs=0.01)


def test_strays_over_the_whole_range_are_no_peak() -> None:
    rng = np.random.default_rng(3)
    assert peaks(np.rint(rng.uniform(20, 765, 300)), 745.0) == ()


def test_the_baseline_has_its_numbers() -> None:
    rng = np.random.default_rng(4)
    setup_cm = rng.normal(0.5, 0.3, 12)
    parts = [point(rng, 40 + 20 * i, error_cm=setup_cm[i], missed=0.02, n=200) for i in range(12)]
    found = baseline(sort_into_points(table(*parts), SENSOR))
    assert found is not None
    assert contains(found.bias, 0.5)
    assert found.spread.value == pytest.approx(0.6, abs=0.05)
    assert found.between_points is not None
    assert found.between_points.value == pytest.approx(0.3, abs=0.15)
    assert contains(found.missed, 0.02)
    assert 1.0 <= abs(found.largest_hit_error_cm) <= 4.0


def test_the_longest_range_that_is_echo() -> None:
    rng = np.random.default_rng(5)
    data = table(point(rng, 300), point(rng, 400, missed=0.1), point(rng, 500, missed=0.6))
    assert longest_reliable_cm(sort_into_points(data, SENSOR), 765.0) == 400.0
    assert longest_reliable_cm([], 765.0) is None
