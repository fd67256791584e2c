"""Thermometers that jump: who decides whether the air did, and what is used until then."""

import math
import random
from collections.abc import Callable, Mapping
from functools import partial

import pytest

from msp_range.acoustics.air import Air
from msp_range.correction.air_temperature import AirTemperature
from msp_range.correction.range_comparison import RangeComparison, RangeHistory
from msp_range.correction.temperature import FileSource, TemperatureParameters
from msp_range.correction.temperature_track import BELIEVED_AFTER_S
from msp_range.correction.thermometer import LoopReader
from msp_range.pilot_texts import LONGEST_TEXT
from msp_range.reading import Reading, Status

OfTime = Callable[[float], float]
JUMP_S = 30.0
FALSE_60 = "Range: air temp jumps to 60 C, using 20 C"
LAGS, SETTLED = "Range: air temp lags", "Range: thermometer has settled"
GOOD_STD_C, GOOD_STD_HOT_C = 2.0, 2.8
"""A thermometer in air of unknown humidity at 21 C at most, and at any temperature [deg C]: 1.4 of its own."""


def raw_factor(air_c: float) -> float:
    """What an MB1242 reads in this air of a metre, c(22.5 C) / c."""
    return math.sqrt((22.5 + 273.15) / (air_c + 273.15))


def steps_to(to_c: float, from_c: float = 20.0, time_constant_s: float = 0.0, jump_s: float = JUMP_S) -> OfTime:
    """A thermometer that goes from one temperature to another."""

    def at(time_s: float) -> float:
        if time_s < jump_s:
            return from_c
        left = math.exp(-(time_s - jump_s) / time_constant_s) if time_constant_s else 0.0
        return to_c + (from_c - to_c) * left

    return at


class Flight:
    """Thermometers over time, and four downward sensors that ping in turn.

    Parameters
    ----------
    thermometers
        What each file shows [deg C].
    air_c
        What the air is; None: nothing is read by the sensors.
    height_m
        Of the sensors.
    limits
        Of all sources.
    """

    def __init__(
        self,
        thermometers: Mapping[str, OfTime],
        air_c: OfTime | None = None,
        height_m: OfTime = lambda time_s: 5.0,
        **limits: float,
    ) -> None:
        self.time_s = 0.0
        self.texts: list[tuple[float, str]] = []
        self.airs: list[tuple[float, Air]] = []
        self._air_c, self._height_m = air_c, height_m
        self._draw = random.Random(1)
        sources = [{"source": "file", "path": name, "scale": 1.0, **limits} for name in thermometers]

        def read(source: FileSource) -> float:
            shown_c = thermometers[source.path](self.time_s)
            if math.isnan(shown_c):
                raise OSError
            return shown_c

        self.temperature = AirTemperature(
            TemperatureParameters.model_validate({"sources": sources}), 0.0, LoopReader(read), 7.65
        )
        self._shown: dict[str, str] = {}

    def until(self, end_s: float) -> "Flight":
        """Fly on to this time [s]."""
        while self.time_s < end_s - 1e-9:
            self.time_s = round(self.time_s + 0.1, 6)
            if self._air_c is not None:
                raw_m = self._height_m(self.time_s) * raw_factor(self._air_c(self.time_s))
                raw_m = round(raw_m + self._draw.gauss(0, 0.02), 2)
                sensor = "abcd"[round(10 * self.time_s) % 4]
                self.temperature.record_range(Reading(self.time_s, sensor, Status.OK, raw_m))
            if round(10 * self.time_s) % 2:
                continue
            self.airs.append((self.time_s, self.temperature.now(self.time_s)))
            for key, text, over, *_ in self.temperature.conditions(self.time_s):
                # As `msp_range.health.Health.set` does it.
                if text is not None and key not in self._shown:
                    self.texts.append((self.time_s, text))
                    self._shown[key] = text
                elif text is None and self._shown.pop(key, None) is not None:
                    self.texts.append((self.time_s, over))
        return self

    @property
    def reports(self) -> list[str]:
        return [text for _, text in self.texts]

    @property
    def air(self) -> Air:
        return self.airs[-1][1]


@pytest.mark.parametrize("to_c", [60.0, -20.0, -39.0])
def test_a_thermometer_that_jumps_while_the_ranges_stay_is_not_believed(to_c: float) -> None:
    flight = Flight({"one": steps_to(to_c)}, air_c=lambda time_s: 20.0).until(640.0)
    assert {air.temperature_c for _, air in flight.airs} == {20.0}
    jump = f"Range: air temp jumps to {to_c:.0f} C, using 20 C"
    disagrees = f"Range: air temp {to_c:.0f} C: the ranges disagree"
    wrong = f"Range: thermometer wrong at {to_c:.0f} C, using 20 C"
    assert flight.reports == [jump, disagrees, wrong]
    assert [time_s for time_s, _ in flight.texts] == pytest.approx([32.2, 37.5, 37.5], abs=1.0)
    # Half a minute after its start the thermometer may as well have been wrong before: the deviation covers both.
    stds_c = {round(time_s, 1): air.std_c for time_s, air in flight.airs}
    assert stds_c[29.0] < GOOD_STD_C
    assert 1.96 * stds_c[34.0] > abs(to_c - 20.0) < 1.96 * stds_c[400.0]
    assert flight.air == Air(20.0, 12.0, "fixed")


def test_a_thermometer_that_was_good_for_five_minutes_is_wrong_when_it_jumps_alone() -> None:
    jump_s = BELIEVED_AFTER_S + 10.0
    flight = Flight({"one": steps_to(60.0, jump_s=jump_s)}, air_c=lambda time_s: 20.0).until(jump_s + 200.0)
    assert {air.temperature_c for _, air in flight.airs} == {20.0}
    assert flight.reports[-1] == "Range: thermometer wrong at 60 C, using 20 C"
    stds_c = {round(time_s - jump_s, 1): air.std_c for time_s, air in flight.airs}
    assert 1.96 * stds_c[4.0] > 40.0
    assert stds_c[-1.0] < GOOD_STD_C > stds_c[10.0]
    assert stds_c[180.0] == pytest.approx(math.hypot(0.02 * 180, stds_c[-1.0]), rel=0.05)


def test_a_thermometer_that_was_wrong_before_it_jumped_is_covered() -> None:
    """It began at -20 C in air of 20 C: the ranges show that it is wrong at one of the two, and not at which."""
    flight = Flight({"one": steps_to(20.0, from_c=-20.0)}, air_c=lambda time_s: 20.0).until(200.0)
    assert flight.reports[-1] == "Range: thermometer wrong at 20 C, using -20 C"
    assert all(abs(20.0 - air.temperature_c) <= 1.96 * air.std_c for time_s, air in flight.airs if time_s > JUMP_S + 1)


def test_a_true_jump_is_believed_when_all_raw_ranges_have_changed_with_it() -> None:
    """From 20 to 60 C they are 6.5 % shorter; the air changes a little before the thermometer shows it."""
    flight = Flight({"one": steps_to(60.0)}, air_c=lambda time_s: 60.0 if time_s > JUMP_S - 0.5 else 20.0)
    flight.until(60.0)
    assert flight.reports == [FALSE_60, "Range: air temp 60 C: the ranges agree"]
    times_s = [time_s for time_s, air in flight.airs if air.temperature_c == 60.0]
    assert JUMP_S + 5.0 < times_s[0] < JUMP_S + 9.0
    assert flight.air.std_c < GOOD_STD_HOT_C


def test_a_thermometer_that_follows_the_air_slowly_is_believed_too() -> None:
    shown = steps_to(60.0, time_constant_s=3.0)
    flight = Flight({"one": shown}, air_c=lambda time_s: 60.0 if time_s > JUMP_S else 20.0).until(60.0)
    assert flight.reports[-1].endswith(": the ranges agree")
    assert flight.air.temperature_c == pytest.approx(60.0, abs=0.1)


def climbing(speed_m_s: float) -> OfTime:
    return lambda time_s: 2.0 + speed_m_s * min(max(time_s - 22.0, 0.0), 20.0)


@pytest.mark.parametrize(
    "height_m",
    [
        climbing(0.2),
        climbing(-0.05),
        # It holds the sent distance, and is back where it was in the eyes of a sensor that nobody corrects.
        lambda time_s: 5.0 * (1 + 0.068 * (1 - math.exp(-max(time_s - JUMP_S, 0.0) / 0.7))),
        # At 0.6 m the noise is larger than the change.
        lambda time_s: 0.6,
    ],
    ids=["climbs", "sinks", "holds its distance", "low"],
)
@pytest.mark.parametrize("air_to_c", [20.0, 60.0])
def test_what_the_ranges_cannot_decide_stays_open_and_is_covered(height_m: OfTime, air_to_c: float) -> None:
    flight = Flight({"one": steps_to(60.0)}, steps_to(air_to_c), height_m).until(200.0)
    assert flight.reports == [FALSE_60]
    held = [air for time_s, air in flight.airs if time_s > JUMP_S + 2]
    assert all(abs(air_to_c - air.temperature_c) < 1.96 * air.std_c for air in held)


def test_a_refused_level_stays_so_when_the_ranges_no_longer_show_it() -> None:
    flight = Flight({"one": steps_to(60.0)}, lambda time_s: 20.0, lambda time_s: 3.0 if time_s < 60.0 else 6.0)
    flight.until(400.0)
    assert flight.air.temperature_c == 20.0
    assert flight.reports[-1] == "Range: thermometer wrong at 60 C, using 20 C"


@pytest.mark.parametrize(("other_c", "verdict"), [(59.0, "agrees"), (21.0, "disagrees")])
def test_another_source_decides_at_once(other_c: float, verdict: str) -> None:
    """The second in the order of trust; where both are open, together they are believed."""
    flight = Flight({"one": steps_to(60.0), "two": steps_to(other_c)}).until(60.0)
    assert flight.air.temperature_c == (60.0 if verdict == "agrees" else 21.0)
    assert flight.air.std_c < (GOOD_STD_HOT_C if verdict == "agrees" else GOOD_STD_C)
    wrong = [] if verdict == "agrees" else ["Range: thermometer wrong at 60 C, using 21 C"]
    assert flight.reports == wrong


def test_a_source_that_would_agree_with_both_decides_nothing() -> None:
    """A barometer of unknown bias: 45 C of it can be the air's 20 or its 60."""
    flight = Flight({"one": steps_to(60.0), "two": lambda time_s: 45.0}, std_c=15.0).until(60.0)
    assert [text for text in flight.reports if "wrong" in text or "agree" in text] == []


def test_after_five_steady_minutes_a_level_that_nothing_contradicts_is_used_and_reported() -> None:
    flight = Flight({"one": steps_to(-5.0)}).until(400.0)
    assert flight.reports == [
        "Range: air temp jumps to -5 C, using 20 C",
        "Range: air temp -5 C used after 5 min, +-14",
    ]
    assert flight.texts[1][0] == pytest.approx(JUMP_S + BELIEVED_AFTER_S, abs=1.5)
    # The old temperature is still covered.
    assert flight.air.temperature_c == -5.0
    assert 25.0 < 1.96 * flight.air.std_c < 30.0


@pytest.mark.parametrize("time_constant_s", [3.0, 6.0, 12.0, 20.0, 30.0])
def test_carried_from_a_warm_hall_into_the_cold(time_constant_s: float) -> None:
    """From 20 to -5 C as thermometers of all kinds show it: none is locked out, and the deviation covers the air."""
    flight = Flight({"one": steps_to(-5.0, time_constant_s=time_constant_s)}).until(JUMP_S + 400.0)
    assert flight.air.temperature_c == pytest.approx(-5.0, abs=0.1)
    if time_constant_s >= 12.0:
        assert [text.split(",")[0] for text in flight.reports] == [LAGS, SETTLED]
    assert all(abs(-5.0 - air.temperature_c) <= 1.96 * air.std_c for time_s, air in flight.airs if time_s > JUMP_S + 8)


def test_a_single_damaged_value_is_not_reported() -> None:
    flight = Flight({"one": lambda time_s: 60.0 if 30.0 <= time_s < 31.0 else 20.0}).until(60.0)
    assert flight.reports == []
    assert {air.temperature_c for _, air in flight.airs} == {20.0}


def test_a_thermometer_that_comes_back_is_used_again() -> None:
    flight = Flight({"one": lambda time_s: 60.0 if 30.0 <= time_s < 200.0 else 20.5}, air_c=lambda time_s: 20.5)
    flight.until(220.0)
    assert flight.reports[-1] == "Range: air temp is back"
    assert flight.air.temperature_c == 20.5
    assert flight.air.source == "one"


@pytest.mark.parametrize("heals_s", [1.0, 60.0])
def test_a_refused_thermometer_that_moves_on_is_not_refused_for_ever(heals_s: float) -> None:
    """It shows 60 C, then heals, and the air has become warmer meanwhile: it is not locked out for ever."""

    def shown(time_s: float) -> float:
        return 20.0 if time_s < 30.0 else max(60.0 - 28.0 * max(time_s - 100.0, 0.0) / heals_s, 32.0)

    flight = Flight({"one": shown}, air_c=lambda time_s: 20.0 if time_s < 60.0 else 32.0).until(520.0)
    assert "Range: thermometer wrong at 60 C, using 20 C" in flight.reports
    assert flight.air.temperature_c == 32.0


def flaps(from_s: float = 0.0, until_s: float = 1e9, period_s: float = 1.0) -> OfTime:
    """A thermometer with a loose contact: 20 and 60 C in turn."""
    return lambda time_s: 60.0 if from_s <= time_s < until_s and int(time_s / period_s) % 2 else 20.0


FLAPS, STEADY = "Range: thermometer flaps 20 to 60 C, using {} C", "Range: thermometer flaps no more"


@pytest.mark.parametrize("from_s", [0.0, 30.0])
@pytest.mark.parametrize("period_s", [1.0, 1.5])
def test_a_thermometer_that_flaps_is_not_followed(from_s: float, period_s: float) -> None:
    """The last good level is held, or the middle where there was none; the deviation contains both."""
    flight = Flight({"one": flaps(from_s, period_s=period_s)}, period_s=0.5).until(from_s + 60.0)
    used_c = 20.0 if from_s + period_s > 1.0 else 40.0
    assert flight.reports == [FLAPS.format(f"{used_c:.0f}")]
    assert flight.texts[0][0] < from_s + 4 * period_s
    held = [air for time_s, air in flight.airs if time_s > from_s + 4 * period_s]
    assert {air.temperature_c for air in held} == {used_c}
    assert all(1.96 * air.std_c > abs(each_c - used_c) for air in held for each_c in (20.0, 60.0))


def test_three_values_in_a_row_of_a_thermometer_that_flaps_are_no_good_level() -> None:
    """It is read two or three times while it shows one of the two; had it been good before, that would be held."""
    flight = Flight({"one": lambda time_s: flaps(period_s=0.87)(time_s + 0.3)}, period_s=0.4).until(60.0)
    assert {air.temperature_c for time_s, air in flight.airs if time_s > 6.0} == {40.0}
    assert flight.reports == [FLAPS.format(40)]


def test_a_thermometer_that_has_flapped_is_used_again_after_a_minute_without() -> None:
    flight = Flight({"one": flaps(30.0, 40.0)}).until(120.0)
    assert flight.reports == [FLAPS.format(20), STEADY]
    assert 95.0 < flight.texts[1][0] < 105.0
    assert flight.air.source == "one"
    assert flight.air.std_c < GOOD_STD_C


def test_a_thermometer_that_has_flapped_and_is_silent_is_reported_as_that() -> None:
    def shown(time_s: float) -> float:
        return flaps(30.0)(time_s) if time_s < 39.0 else float("nan")

    flight = Flight({"one": shown}).until(120.0)
    assert flight.reports[1:] == [STEADY, "Range: no air temperature, using 20 C"]


def test_a_second_source_takes_the_place_of_one_that_flaps_or_settles() -> None:
    for first in (flaps(30.0), steps_to(-15.0, time_constant_s=120.0)):
        flight = Flight({"one": first, "two": lambda time_s: 21.0}).until(80.0)
        assert flight.air.source == "two"
        assert flight.air.std_c < GOOD_STD_C


def test_a_settling_thermometer_is_reported_where_ranges_are_wrong_by_a_decimetre() -> None:
    """10 C at 7.65 m; of 4 C nothing is reported, and the deviation contains it."""
    for to_c, reports in ((10.0, [LAGS, SETTLED]), (16.0, [])):
        flight = Flight({"one": steps_to(to_c, time_constant_s=60.0)}).until(300.0)
        assert [text.split(",")[0] for text in flight.reports] == reports
        late = [air for time_s, air in flight.airs if time_s > JUMP_S + 40.0]
        assert all(abs(to_c - air.temperature_c) <= 1.96 * air.std_c for air in late)


def test_values_before_the_first_measurement_are_given_up() -> None:
    """Some autopilots send a zero before they have measured anything."""
    flight = Flight({"one": lambda time_s: 0.0 if time_s < 2.0 else 25.0}).until(10.0)
    assert flight.air.temperature_c == 25.0
    assert flight.air.std_c < GOOD_STD_HOT_C
    assert flight.reports == []


@pytest.mark.parametrize(("period_s", "c_per_step"), [(0.1, 2.0), (1.0, 4.0)])
def test_a_quick_ramp_of_small_steps_is_a_jump(period_s: float, c_per_step: float) -> None:
    """Each step alone would be let through; together they are faster than the source's 2 C/s."""

    def shown(time_s: float) -> float:
        return min(20.0 + c_per_step * max(math.floor((time_s - JUMP_S) / period_s), 0), 60.0)

    flight = Flight({"one": shown}, period_s=period_s).until(JUMP_S + 60.0)
    assert flight.air.temperature_c < 27.0


def test_after_a_silence_the_air_may_have_gone_far() -> None:
    """An autopilot that was off for a quarter of an hour, and the vehicle was carried out of the hall."""
    flight = Flight({"one": lambda time_s: 20.0 if time_s < 30 else float("nan") if time_s < 930 else -10.0})
    flight.until(940.0)
    assert flight.air.temperature_c == -10.0
    assert flight.reports == ["Range: no air temperature, using 20 C", "Range: air temp is back"]


def test_every_text_fits_a_statustext() -> None:
    for cold, warm in ((-39.9, -20.4), (-20.4, -39.9), (-20.4, 59.9)):
        shown = steps_to(warm, from_c=cold)
        reports = Flight({"one": shown}).until(400.0).reports
        for air_c in (steps_to(cold, from_c=cold), shown):
            reports += Flight({"one": shown}, air_c).until(60.0).reports
        reports += Flight({"one": shown, "two": steps_to(cold, from_c=cold)}).until(60.0).reports
        reports += Flight({"one": steps_to(warm, from_c=cold, time_constant_s=60.0)}).until(60.0).reports
        flapping = partial(lambda cold, warm, time_s: warm if int(time_s) % 2 else cold, cold, warm)
        reports += Flight({"one": flapping}).until(20.0).reports
        assert len(reports) >= 9
        assert all(len(text) <= LONGEST_TEXT for text in reports), reports


def test_outliers_and_the_shortest_report_are_not_compared() -> None:
    temperature = Flight({"one": lambda time_s: 20.0}).temperature
    for reading in (
        Reading(0.0, "a", Status.AT_MINIMUM, 0.2),
        Reading(0.0, "a", Status.OK, 2.55, suspect=True),
        Reading(0.0, "a", Status.NO_ECHO),
    ):
        temperature.record_range(reading)
    assert temperature._history.between(-1.0, 1.0, 10) == []


def random_hover(seed: int) -> tuple[bool, bool | None]:
    """Whether the air really jumped, and what the ranges show, in one of many kinds of flight."""
    draw = random.Random(seed)
    height_m, wander_m = draw.uniform(0.5, 7.0), draw.choice([0.0, 0.02, 0.05, 0.1, 0.2])
    period_s, phase = draw.uniform(3.0, 12.0), draw.uniform(0.0, 6.28)
    climb_m_s, climbs_s = draw.choice([0.0, 0.0, 0.0, 0.05, -0.05, 0.3, -0.5]), draw.uniform(0.0, 50.0)
    is_true, sensors = draw.random() < 0.5, draw.choice([1, 2, 4])
    from_c = draw.uniform(-10.0, 40.0)
    to_c = min(max(from_c + draw.choice([-1, 1]) * draw.uniform(8.0, 45.0), -40.0), 60.0)
    history, comparison = RangeHistory(), None
    for i in range(600):
        time_s = 0.1 * i
        air_c = to_c if is_true and time_s >= 24.5 else from_c
        now_m = height_m + wander_m * math.sin(2 * math.pi * time_s / period_s + phase)
        now_m += climb_m_s * min(max(time_s - climbs_s, 0.0), 3.0)
        raw_m = round(max(now_m, 0.2) * raw_factor(air_c) + draw.gauss(0.0, 0.02), 2)
        if draw.random() < 0.03:
            raw_m = draw.uniform(0.2, 7.6)
        if raw_m > 0.2:
            history.record(time_s, "abcd"[i % sensors], raw_m)
        if i == 250:
            comparison = RangeComparison(history, time_s - 1.0, time_s)
        if comparison is not None and i % 3 == 0:
            comparison.update(time_s)
            verdict = comparison.changed(time_s, from_c, to_c)
            if verdict is not None:
                return is_true, verdict
    return is_true, None


@pytest.mark.slow
def test_in_flights_of_all_kinds_the_ranges_decide_often_and_hardly_ever_wrongly() -> None:
    """Heights of 0.5 to 7 m, wandering by up to 20 cm, climbing around the jump, 3 % outliers; jumps of 8 to 45 C."""
    outcomes = [random_hover(seed) for seed in range(400)]
    decided = [(is_true, verdict) for is_true, verdict in outcomes if verdict is not None]
    assert len(decided) > 0.25 * len(outcomes)
    assert sum(is_true is not verdict for is_true, verdict in decided) <= 1
