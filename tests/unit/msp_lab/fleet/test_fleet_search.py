"""Which numbers the search goes by, on a fleet whose sensors have given numbers."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from msp_lab.fleet.search import FleetFinding, FleetSearch, named_by, near
from msp_lab.fleet.terms import FleetTerm
from msp_lab.fleet.unit import Names, OwnEffects, Sessions, Unit, UnitNumbers, examine, search
from msp_sim.workers import ItemOutcome

SCATTER = FleetTerm("scatter", "value")
TAILS = FleetTerm("heavy_tails", "share", shape=(("wider", 2.0),))
VIBRATION = FleetTerm("vibration", "growth")
LATE = FleetTerm("latency", "delay_ms")
BEND = FleetTerm("bend", "slope_pct", shape=(("place_cm", 300.0),))
NAMES = ("flight1", "flight2", "flight3", "flight4")
VEHICLES = 20
UNITS = [Unit(Path("readings"), f"V{k}", "down", NAMES, 1) for k in range(VEHICLES)]


def numbers(values: Sequence[tuple[FleetTerm, float]], gain_nats: float = 0.0) -> UnitNumbers:
    """Each number the same in all four sessions, with an error of 1 in all of them together."""
    sessions = [(term, Sessions(np.full(4, value), np.full(4, 4.0), np.full(4, 0.25))) for term, value in values]
    return UnitNumbers(tuple(sessions), NAMES, 400, gain_nats, 40, ())


class Fleet:
    """Twenty sensors: what each one's own search names, and its numbers and gains by term."""

    def __init__(
        self,
        own: Callable[[int, frozenset[str]], Sequence[FleetTerm]] = lambda k, known: (),
        value: Callable[[int, FleetTerm], float] = lambda k, term: 0.0,
        gain_nats: Callable[[int, FleetTerm], float] = lambda k, term: 0.0,
    ) -> None:
        self.own, self.value, self.gain_nats = own, value, gain_nats
        self.asked: list[tuple[str, str]] = []

    def of(self, k: int, terms: Sequence[FleetTerm]) -> UnitNumbers:
        scatter = float(np.random.default_rng([k, 1]).standard_normal())
        values = [(SCATTER, scatter + self.value(k, SCATTER)), *((term, self.value(k, term)) for term in terms)]
        return numbers(values, self.gain_nats(k, terms[-1]) if terms else 0.0)

    def run(self, function: Any, tasks: Sequence[Any]) -> list[ItemOutcome[Any]]:
        return [ItemOutcome(i, self._answer(function, *task), None) for i, task in enumerate(tasks)]

    def _answer(self, function: Any, unit: Unit, terms: Sequence[FleetTerm], *rest: float) -> Any:
        k = UNITS.index(unit)
        self.asked.append((function.__name__, unit.vehicle))
        if function is examine:
            return self.of(k, terms)
        assert function is search
        named = self.own(k, frozenset(term.effect for term in terms))
        return OwnEffects(tuple(((term, 0.0),) for term in named), 50.0 * len(named))

    def found(self) -> list[FleetFinding]:
        return FleetSearch(UNITS, [self.of(k, ()) for k in range(VEHICLES)], 0.05, self.run).all()


def test_a_fleet_in_which_nothing_is_odd_has_no_finding() -> None:
    assert Fleet().found() == []


def test_what_one_sensor_names_and_its_number_confirms_is_odd() -> None:
    fleet = Fleet(
        lambda k, known: [LATE] * (k == 3 and "latency" not in known), lambda k, term: 30.0 * (term == LATE and k == 3)
    )
    (finding,) = fleet.found()
    assert (finding.kind, finding.number.term, finding.units) == ("odd", LATE, frozenset({3}))
    assert finding.number.value[3] == pytest.approx(30.0)


def test_what_vehicles_differ_by_anyway_is_not_odd_though_it_is_certain_in_one() -> None:
    fleet = Fleet(lambda k, known: [LATE] * (k == 3), lambda k, term: (12.0 * (k - 9.5)) * (term == LATE))
    assert fleet.found() == []


def test_a_number_of_the_base_is_odd_where_no_effect_explains_it() -> None:
    def scatter(k: int, term: FleetTerm) -> float:
        return 15.0 * (term == SCATTER and k == 3)

    (finding,) = Fleet(value=scatter).found()
    assert (finding.kind, finding.number.term, finding.units) == ("odd", SCATTER, frozenset({3}))

    class Vibrates(Fleet):
        """Next to the effect, its scatter is as the others'."""

        def of(self, k: int, terms: Sequence[FleetTerm]) -> UnitNumbers:
            if not terms or k != 3:
                return super().of(k, terms)
            return numbers([(SCATTER, 0.0), (VIBRATION, 30.0)])

    (finding,) = Vibrates(lambda k, known: [VIBRATION] * (k == 3 and not known), scatter).found()
    assert (finding.number.term, finding.units) == (VIBRATION, frozenset({3}))


def test_the_odd_ones_of_one_number_are_one_finding() -> None:
    (finding,) = Fleet(value=lambda k, term: (15.0 + k) * (term == SCATTER and k in (1, 3))).found()
    assert finding.units == {1, 3}


def test_what_three_odd_vehicles_gain_is_not_given_to_the_fleet() -> None:
    """Each of them gains 100 nats by a bend, the 17 others next to nothing, and the fleet's mean is not quite 0."""
    fleet = Fleet(
        lambda k, known: [BEND] * (k < 3 and "bend" not in known),
        lambda k, term: (40.0 * (k < 3) + 2.0) * (term.effect == "bend"),
        lambda k, term: 100.0 if k < 3 else 0.5,
    )
    (finding,) = fleet.found()
    assert (finding.kind, finding.number.term.effect, finding.units) == ("odd", "bend", frozenset({0, 1, 2}))


@pytest.mark.parametrize(("nats", "kinds"), [(9.0, ["shared"]), (7.0, [])])
def test_what_the_ordinary_ones_gain_is_the_fleets(nats: float, kinds: list[str]) -> None:
    """One sensor names it, and all have it; then each is asked what it has next to it."""
    fleet = Fleet(
        lambda k, known: [LATE] * (k == 3 and "latency" not in known),
        lambda k, term: 4.0 * (term == LATE),
        lambda k, term: nats,
    )
    assert [each.kind for each in fleet.found()] == kinds
    assert fleet.asked.count(("search", "V0")) == 1 + len(kinds)


def test_tails_are_calibrated_before_what_looks_like_them_is_named() -> None:
    """More sensors name the slip; the tails of the noise are tried first, and a little of them is enough."""
    slip = FleetTerm("cycle_slip", "share", shape=(("cycles", 3.0),))
    fleet = Fleet(
        lambda k, known: () if "heavy_tails" in known else [slip] if k else [TAILS],
        lambda k, term: 4.0 * (term.effect in ("heavy_tails", "cycle_slip")),
        lambda k, term: 30.0 if term.effect == "cycle_slip" else 2.0,
    )
    assert [(each.kind, each.number.term.effect) for each in fleet.found()] == [("calibration", "heavy_tails")]


def test_more_of_what_all_have_is_odd() -> None:
    fleet = Fleet(
        lambda k, known: [LATE] * (not known),
        lambda k, term: (14.0 + 40.0 * (k == 2)) * (term == LATE),
        lambda k, term: 20.0,
    )
    assert [(each.kind, each.units) for each in fleet.found()] == [("shared", frozenset()), ("odd", frozenset({2}))]


@pytest.mark.parametrize(("gain_nats", "kind"), [(0.0, "change"), (1000.0, "odd")])
def test_a_change_counts_where_no_effect_explains_more(gain_nats: float, kind: str) -> None:
    class Changes(Fleet):
        def of(self, k: int, terms: Sequence[FleetTerm]) -> UnitNumbers:
            plain = super().of(k, terms)
            if terms or k != 3:
                return plain
            (_, sessions), *others = plain.numbers
            changed = sessions._replace(value=sessions.value + np.array([0.0, 0.0, 40.0, 40.0]))
            return replace(plain, numbers=((SCATTER, changed), *others))

        def _answer(self, function: Any, unit: Unit, terms: Sequence[FleetTerm], *rest: float) -> Any:
            if function is search and unit.vehicle == "V3" and not terms and gain_nats > 0.0:
                return OwnEffects((((LATE, 0.0),),), gain_nats)
            return super()._answer(function, unit, terms, *rest)

    fleet = Changes(value=lambda k, term: 40.0 * (term == LATE and k == 3))
    (finding,) = fleet.found()
    assert (finding.kind, finding.units) == (kind, frozenset({3}))
    assert (finding.number.term == SCATTER) == (kind == "change")
    if finding.change is not None:
        assert finding.change.first == 2
        assert finding.change.size == pytest.approx(40.0)


class OfBatches(Fleet):
    """The first six vehicles are of batch B."""

    def of(self, k: int, terms: Sequence[FleetTerm]) -> UnitNumbers:
        return replace(super().of(k, terms), words=(("batch", "B" if k < 6 else "A"),))


def test_a_number_in_which_a_batch_differs_is_found_once_for_all_of_it() -> None:
    fleet = OfBatches(value=lambda k, term: 8.0 * (k < 6) + 20.0 * (k == 9))
    group, odd = fleet.found()
    assert (group.kind, group.units) == ("group", frozenset(range(6)))
    assert (odd.kind, odd.units) == ("odd", frozenset({9}))
    assert group.number.apart is not None
    assert group.number.apart.group.name == "batch B"


def test_an_effect_that_a_batch_has_is_the_batchs_and_its_number_of_the_base_no_finding_of_its_own() -> None:
    fleet = OfBatches(
        lambda k, known: [LATE] * (k < 4 and "latency" not in known),
        lambda k, term: 14.0 * (k < 6 and term == LATE),
        lambda k, term: 20.0 * (k < 6),
    )
    (finding,) = fleet.found()
    assert (finding.kind, finding.number.term, finding.units) == ("group", LATE, frozenset(range(6)))


def test_groups_share_the_rate_of_the_numbers() -> None:
    batches = OfBatches()
    made = FleetSearch(UNITS, [batches.of(k, ()) for k in range(VEHICLES)], 0.05, batches.run)
    assert made.number_level == pytest.approx(np.log(0.05 / 2.0 / 105.0))


def test_what_is_compared_and_what_is_searched_have_half_of_the_rate_each() -> None:
    made = FleetSearch(UNITS, [numbers([(SCATTER, 0.0)])] * VEHICLES, 0.05, Fleet().run)
    # Five numbers of 20 vehicles; 40 effects, and whether a number changed.
    assert made.number_level == pytest.approx(np.log(0.05 / 2.0 / 100.0))
    assert made.search_level == pytest.approx(np.log(0.05 / 2.0 / (20 * 40 + 100)))
    assert made.tests == 20 * 40 + 200


def test_a_name_is_that_which_most_of_the_odd_ones_may_have_with_the_median_shape() -> None:
    def bend(place_cm: float, start: float) -> FleetTerm:
        return replace(BEND, shape=(("place_cm", place_cm),), start=start)

    scale = FleetTerm("range_scale", "scale_pct", start=1.0)
    effects: list[list[Names]] = [
        [((bend(100.0, 1.0), 0.0), (scale, 1.0))],
        [((scale, 0.0), (bend(300.0, 2.0), 2.5))],
        [((bend(200.0, 6.0), 0.0),)],
    ]
    first, second = named_by(effects)
    assert first.term == replace(BEND, shape=(("place_cm", 200.0),), start=2.0)
    assert (first.units, first.lost_nats) == ((0, 1, 2), 2.5)
    assert (second.term.effect, second.units, second.lost_nats) == ("range_scale", (0, 1), 1.0)
    # The scale explains two of the three; of these alone both are as good.
    assert near(first, [first, second]) == ()
    first, second = named_by(effects[:2])
    assert first.term.effect == "range_scale"
    assert near(first, [first, second]) == ((second.term, 1.5),)
