"""Which p-values the search goes by."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.fleet.meta import pooled
from msp_lab.fleet.search import FleetFinding, Search, _Suspect, _tried, mean_nats
from msp_lab.fleet.statistics import Deviation, Number
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import RefittedTerm, Unit
from msp_sim.workers import ItemOutcome

SCATTER = FleetTerm("scatter", "value")
UNITS = [Unit(Path("readings"), f"V{k}", "down", ("flight1",), 1) for k in range(5)]


def scatter(log_p: list[float]) -> Number:
    value, error = np.zeros(5), np.ones(5)
    fleet = replace(pooled(value, error), deviation_log_p=np.array(log_p))
    return Number(SCATTER, np.arange(5), value, error, 0.0, fleet)


def search() -> Search:
    made = Search(UNITS, [], 0.05, lambda *_: ())
    made.plain_tests, made.other_tests = 5, 1000
    made.first = [scatter([-6.0 if k == 3 else -1.0 for k in range(5)])]
    return made


def test_a_plain_number_keeps_the_answer_of_the_first_fit() -> None:
    """What the whole fleet has is fitted in each unit, and leaves less to see."""
    made = search()
    assert made._of_base([scatter([-1.0] * 5)])
    assert [(each.kind, each.term, each.units) for each in made.found] == [("odd", SCATTER, (3,))]
    assert not made._of_base([scatter([-1.0] * 5)])


def test_of_a_unit_in_which_something_was_found_it_is_what_is_left() -> None:
    made = search()
    made.found.append(FleetFinding("odd", FleetTerm("vibration", "growth"), (3,)))
    assert not made._of_base([scatter([-1.0] * 5)])


def test_plain_numbers_have_a_share_of_the_rate_of_their_own() -> None:
    made = search()
    assert made.plain_level == pytest.approx(np.log(0.05 / 2.0 / 5.0))
    assert made.level == pytest.approx(np.log(0.05 / 2.0 / 1000.0))
    assert made.tests == 1005
    # Nothing is wrong with what is calibrated, so that no more may be false.
    made.found.append(FleetFinding("calibration", FleetTerm("heavy_tails", "share"), ()))
    assert made.plain_level == pytest.approx(np.log(0.05 / 2.0 / 5.0))
    made.found.append(FleetFinding("odd", SCATTER, (3, 1)))
    assert made.plain_level == pytest.approx(np.log(3.0 * 0.05 / 2.0 / 5.0))


def test_what_three_odd_vehicles_gain_is_not_given_to_the_fleet() -> None:
    """Each of them gains 100 nats by a bend, the 17 others next to nothing, and the fleet's mean is not quite 0."""
    value = np.array([-0.2] * 3 + [-0.02] * 17)
    error = np.full(20, 0.01)
    fleet = pooled(value, error)
    bend = Number(FleetTerm("bend", "slope_pct"), np.arange(20), value, error, 0.0, fleet)
    nats = np.array([[100.0]] * 3 + [[0.5]] * 17)
    assert mean_nats(nats, [bend]) == pytest.approx([0.5])


def test_the_odd_ones_of_one_effect_are_one_finding_whenever_they_were_found() -> None:
    made = search()
    for unit in (3, 1):
        made._take_odd(SCATTER, (unit,))
    assert [each.units for each in made.found] == [(3, 1)]
    made._replace(made.found[0], (1,))
    assert [each.units for each in made.found] == [(1,)]
    made._replace(made.found[0], ())
    assert made.found == []


def test_what_a_vehicle_was_odd_by_is_not_fitted_twice_where_the_fleet_shares_it() -> None:
    term = FleetTerm("vibration", "growth")
    fitted: list[str] = []

    def run(function: Any, tasks: Sequence[Any]) -> list[ItemOutcome[Any]]:
        fitted.extend(unit.vehicle for unit, _, _ in tasks)
        return [ItemOutcome(k, "its scores", None) for k in range(len(tasks))]

    first: list[Any] = ["scores"] * 5
    made = Search(UNITS, first, 0.05, run)
    made._fit([2], term)
    made._fit(range(5), term)
    assert made.terms == [(term,)] * 5
    assert fitted == ["V2", "V0", "V1", "V3", "V4"]
    # A change of it is a term of its own.
    since = replace(term, sessions=("flight2",))
    made._fit([2], since)
    assert made.terms[2] == (term, since)


@pytest.mark.parametrize(("lost", "is_odd"), [(30.0, True), (3.0, False)])
def test_more_of_what_all_have_counts_where_the_fleets_number_is_unlikely(lost: float, is_odd: bool) -> None:
    tails = FleetTerm("heavy_tails", "share")
    asked: list[Any] = []

    def run(function: Any, tasks: Sequence[Any]) -> list[ItemOutcome[Any]]:
        asked.extend(tasks)
        return [ItemOutcome(k, lost, None) for k in range(len(tasks))]

    made = Search(UNITS, [], 0.05, run)
    made.other_tests = 1000
    made.found.append(FleetFinding("calibration", tails, ()))
    made.terms = [(tails,)] * 5
    made._odd({2: _Suspect(-40.0, [Deviation(-40.0, tails, 2, 0.6, 0.1)])}, made.level)
    assert asked == [(UNITS[2], (tails,), 0, 0.1)]
    assert [each.units for each in made.found if each.kind == "odd"] == [(2,)] * is_odd
    assert made._has(2, tails.key)


def test_a_refit_starts_where_the_score_says_unless_it_rests_on_few_readings() -> None:
    for name, number, start in (("latency", "delay_ms", 20.0), ("multipath", "share", 0.0)):
        term = FleetTerm(name, number)
        assert _tried(Deviation(-20.0, term, 1, 20.0, 0.0)).start == start


def test_tails_are_calibrated_before_what_looks_like_them_is_named() -> None:
    """The slip is more certain by its score; the tails of the noise are tried first, and alone."""
    tried: list[str] = []

    def run(function: Any, tasks: Sequence[Any]) -> list[ItemOutcome[Any]]:
        tried.extend(term.effect for term in tasks[0][2])
        return [ItemOutcome(k, [RefittedTerm(0.0, (("share", 0.1),))], None) for k in range(len(tasks))]

    made = Search(UNITS, [], 0.05, run)
    made.other_tests = 1000
    numbers = []
    for name, log_p in (("cycle_slip", -30.0), ("heavy_tails", -7.0)):
        fleet = replace(pooled(np.ones(5), np.ones(5)), log_p=log_p)
        numbers.append(Number(FleetTerm(name, "share"), np.arange(5), np.ones(5), np.ones(5), 0.0, fleet))
    assert made._shared(numbers)
    assert tried == ["heavy_tails"]
