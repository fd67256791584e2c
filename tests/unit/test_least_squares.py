"""Levenberg and Marquardt's method against scipy's, on what the bridge fits and on what is known to be hard."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from scipy.optimize import least_squares as scipys

from msp_range.acoustics import sonar
from msp_range.acoustics.beam import BreakawayTable
from msp_range.acoustics.least_squares import least_squares


@pytest.mark.parametrize(
    ("lower", "expected"),
    [((-np.inf, -np.inf), (1.0, 1.0)), ((1.5, -np.inf), (1.5, 2.25)), ((-np.inf, 2.0), (1.4137, 2.0))],
)
def test_rosenbrocks_valley(lower: tuple[float, float], expected: tuple[float, float]) -> None:
    def valley(p: Any) -> list[float]:
        return [10 * (p[1] - p[0] ** 2), 1 - p[0]]

    assert least_squares(valley, [2.0, 9.0], lower) == pytest.approx(expected, abs=1e-4)


def test_a_parameter_on_which_nothing_depends_stays() -> None:
    assert least_squares(lambda p: [p[0] - 3.0], [0.0, 7.0], [-np.inf, -np.inf]) == pytest.approx([3.0, 7.0])


@pytest.mark.slow
def test_sonar_equations_fit_no_worse_than_by_scipy(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tables as a bench could give them, with and without a wall that must be heard, many ending at a bound."""
    sums: list[float] = []

    def both(residuals: Callable[[Any], list[float]], start: Sequence[float], lower: Sequence[float]) -> Any:
        ours, theirs = least_squares(residuals, start, lower), scipys(residuals, start, bounds=(lower, np.inf)).x
        assert (np.array(ours) >= lower).all()
        of_ours, of_theirs = (float(np.square(residuals(p)).sum()) for p in (ours, theirs))
        assert of_ours <= of_theirs * (1 + 1e-6) + 1e-9
        sums.append(of_ours)
        return ours

    monkeypatch.setattr(sonar, "least_squares", both)
    draw = np.random.default_rng(3)
    for number in range(40):
        ranges_m = np.sort(draw.choice(np.arange(10, 400, 10), draw.integers(3, 8), replace=False)) / 100
        angles_deg = np.clip(25.0 - 5.0 * ranges_m + draw.normal(size=ranges_m.size), 3.0, 60.0)
        table = BreakawayTable(tuple(ranges_m.tolist()), tuple(np.sort(angles_deg)[::-1].tolist()))
        sonar.fit_sonar(table, 42_000.0, float(draw.uniform(2.0, 8.0)) if number % 2 else None)
    assert np.ptp(sums) > 1.0


def test_parameters_that_do_the_same_share_the_step() -> None:
    found = least_squares(lambda p: [p[0] + p[1] - 3.0, 2.0 * (p[0] + p[1]) - 6.0], [0.0, 1.0], [-np.inf, -np.inf])
    assert found == pytest.approx([1.0, 2.0])
