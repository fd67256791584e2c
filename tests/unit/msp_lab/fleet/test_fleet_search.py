"""Which p-values the search goes by."""

from pathlib import Path

import numpy as np
import pytest

from msp_lab.fleet.meta import pooled
from msp_lab.fleet.search import FleetFinding, Search
from msp_lab.fleet.statistics import Number
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import Unit

SCATTER = FleetTerm("scatter", "value")
UNITS = [Unit(Path("readings"), f"V{k}", "down", ("flight1",), 1) for k in range(5)]


def scatter(log_p: list[float]) -> Number:
    value, error = np.zeros(5), np.ones(5)
    return Number(SCATTER, np.arange(5), value, error, 0.0, pooled(value, error), np.array(log_p))


def search() -> Search:
    made = Search(UNITS, [], 0.05, lambda *_: ())
    made.plain_tests, made.other_tests = 5, 1000
    made._plain_first = {(SCATTER, k): -6.0 if k == 3 else -1.0 for k in range(5)}
    return made


def test_a_plain_number_keeps_the_answer_of_the_first_fit() -> None:
    """What the whole fleet has is fitted in each unit, and leaves less to see."""
    made = search()
    assert made._of_base([scatter([-1.0] * 5)])
    assert [(each.kind, each.term, each.units) for each in made.found] == [("odd", SCATTER, (3,))]
    assert not made._of_base([scatter([-1.0] * 5)])


def test_of_a_unit_in_which_something_was_found_it_is_what_is_left() -> None:
    made = search()
    made.found.append(FleetFinding("odd", FleetTerm("vibration", "growth"), (3,), (-20.0,)))
    assert not made._of_base([scatter([-1.0] * 5)])


def test_plain_numbers_share_half_of_the_rate_among_themselves() -> None:
    made = search()
    assert made._plain_log_level == pytest.approx(np.log(0.05 / 2.0 / 5.0))
    assert made._log_level == pytest.approx(np.log(0.05 / 2.0 / 1000.0))
    assert made.tests == 1005
