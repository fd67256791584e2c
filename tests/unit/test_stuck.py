"""A sensor that keeps its answer: when the vehicle's motion shows that it is stuck, and when it may be even ground."""

from collections.abc import Callable

from msp_range.fusion.stuck import StuckWatch
from msp_range.fusion.vertical import VerticalMotion

SILENT = VerticalMotion()
"""A barometer without a rate."""


def verdicts(raws: list[int], heights_m: list[float | None]) -> list[bool]:
    """One answer each 0.4 s, with the height by all sensors."""
    watch = StuckWatch()
    return [
        watch.update(raw, raw / 100, height_m, SILENT, 0.4 * i)
        for i, (raw, height_m) in enumerate(zip(raws, heights_m, strict=False))
    ]


def test_the_third_answer_alike_is_stuck_where_the_height_changed_by_15_cm() -> None:
    assert verdicts([300] * 4, [3.0, 3.08, 3.16, 3.24]) == [False, False, True, True]
    assert verdicts([300] * 4, [3.0, 2.92, 2.84, 2.76]) == [False, False, True, True]
    assert verdicts([300] * 4, [3.0, 3.3, 3.3, 3.3]) == [False, False, True, True]
    assert verdicts([300] * 6, [3.0, 3.05, 3.10, 3.14, 3.14, 3.14]) == [False] * 6


def test_it_stays_stuck_when_the_vehicle_comes_back_and_until_it_answers_something_else() -> None:
    heights_m: list[float | None] = [3.0, 3.1, 3.2, 3.0, 3.0, 3.0]
    assert verdicts([300] * 6, heights_m) == [False, False, True, True, True, True]
    assert verdicts([300] * 4 + [301, 301], heights_m) == [False, False, True, True, False, False]
    # A new answer is held against the height at which it came first.
    assert verdicts([300] * 4 + [301] * 4, [3.0, 3.1, 3.2, 3.3, 3.3, 3.35, 3.4, 3.5])[4:] == [False, False, False, True]


def test_one_or_two_outliers_release_no_stuck_sensor_and_three_answers_or_its_noise_do() -> None:
    """A missed echo of a sensor that is held at its minimum is no answer that is new."""
    heights_m: list[float | None] = [3.0, 3.1, *[3.2] * 9]
    stuck = [False, False, True]
    assert verdicts([300] * 3 + [765, 300, 765, 150, 300], heights_m) == [*stuck, False, True, False, False, True]
    assert verdicts([300] * 3 + [765, 150, 320, 300, 300], heights_m) == stuck + [False] * 5
    assert verdicts([300] * 3 + [304, 300, 300], heights_m) == stuck + [False] * 3


def test_over_calm_ground_the_same_answer_is_no_fault() -> None:
    assert not any(verdicts([300] * 50, [3.0 + 0.05 * (i % 3) for i in range(50)]))


def test_heights_before_and_after_a_lost_ground_are_not_compared() -> None:
    """A ground that is found anew begins at zero."""
    assert verdicts([300] * 6, [None, None, None, 0.0, 0.1, 0.2]) == [False] * 5 + [True]
    assert not any(verdicts([300] * 6, [3.0, 3.05, None, 0.0, 0.05, 0.1]))
    assert not any(verdicts([300] * 8, [None] * 8))


def test_answers_are_called_repeated_from_the_fifth_alike_on() -> None:
    watch, repeated = StuckWatch(), []
    for raw in [300] * 6 + [301] * 5:
        watch.update(raw, raw / 100, 3.0, SILENT, 0.0)
        repeated.append(watch.repeated)
    assert repeated == [False] * 4 + [True] * 2 + [False] * 4 + [True]


def climbing(climb_m_s: float, answers: int, seconds: float = 0.4) -> list[bool]:
    """Verdicts on an answer that stays while a barometer climbs; no height is known by ranges."""
    motion, watch, time_s, out = VerticalMotion(), StuckWatch(), 0.0, []
    for i in range(answers):
        while time_s <= 20.0 + seconds * i:
            motion.on_acceleration(time_s, 0.0)
            motion.on_pressure_height(time_s, 50.0 + climb_m_s * time_s)
            time_s += 0.05
        out.append(watch.update(300, 3.0, None, motion, 20.0 + seconds * i))
    return out


def test_by_the_barometer_alone_it_takes_five_answers_and_a_climb_that_is_sure() -> None:
    # The fifth answer is 1.6 s after the first one; three standard deviations of a climb are 0.63 m by then.
    assert climbing(0.36, 5) == [False] * 5
    assert climbing(0.44, 5) == [False] * 4 + [True]
    assert climbing(-0.44, 5) == [False] * 4 + [True]
    assert climbing(5.0, 5) == [False] * 4 + [True], "fewer answers alike are random, however fast it climbs"
    assert climbing(0.0, 100) == [False] * 100


def test_by_the_barometer_alone_it_takes_half_a_metre_however_sure_the_climb_is() -> None:
    """0.2 s after the first answer three standard deviations are 0.15 m."""
    assert climbing(2.3, 5, 0.05) == [False] * 5
    assert climbing(2.7, 5, 0.05) == [False] * 4 + [True]


def first_stuck_m(height_m: Callable[[float], float], raw: Callable[[float], int], until_s: float) -> float | None:
    """How high the vehicle is by its barometer when its sensor is first called stuck; None: never."""
    motion, watch, time_s, answer_s = VerticalMotion(), StuckWatch(), -20.0, 0.0
    while answer_s < until_s:
        while time_s <= answer_s:
            motion.on_acceleration(time_s, 0.0)
            motion.on_pressure_height(time_s, height_m(time_s))
            time_s += 0.05
        if watch.update(raw(answer_s), raw(answer_s) / 100, None, motion, answer_s):
            return height_m(answer_s)
        answer_s += 0.4
    return None


def test_a_climb_after_a_long_hover_is_taken_over_the_last_seconds() -> None:
    """Since the first of the answers the barometer may have drifted by 2.4 m in three standard deviations."""
    found_m = first_stuck_m(lambda time_s: 0.5 * max(time_s - 60.0, 0.0), lambda time_s: 300, 70.0)
    assert found_m is not None
    assert found_m < 2.0


def test_a_slow_climb_is_taken_from_the_first_answer_on() -> None:
    """In the last seconds it is less than the barometer's noise."""
    found_m = first_stuck_m(lambda time_s: 0.1 * max(time_s, 0.0), lambda time_s: 300, 30.0)
    assert found_m is not None
    assert 1.2 < found_m < 2.2


def test_what_was_climbed_before_a_new_answer_does_not_count() -> None:
    def raw(time_s: float) -> int:
        return 300 + round(time_s) if time_s < 5.0 else 400

    assert first_stuck_m(lambda time_s: min(max(time_s, 0.0), 5.0), raw, 12.0) is None
