"""Every fault seen in the field, through the whole bridge: what the autopilot receives, and that it comes back.

The rows are those of the MB1242's known faults. In each the vehicle is somewhere known, so that a distance that is not
the truth can be sent; a fault begins at `FROM_S` and ends at `TO_S`.
"""

import random
from collections import Counter
from collections.abc import Callable
from itertools import pairwise

import pytest

from msp_range.reading import Status
from msp_sim.device.device import Fault
from tests.support.bench import FUSED_ID, Bench, airframe, one_down, sensor
from tests.support.plain_device import PlainDevice

FROM_S, TO_S, END_S = 5.0, 8.0, 12.0
NAMES = "abcd"
ROUND_S = 0.4
FUSED_MEMORY_S = 0.65 + 0.1
"""How long the fused stream may live on what it has: its window, and the slot of the sensor that is asked then."""
SILENT, SPEAKS = "Range: no distance to the ground", "Range: distance is back"
KALMAN = [{"filter": "kalman"}]


def all_have(kind: str, from_s: float = FROM_S, to_s: float = TO_S, **more: float) -> dict[str, list[Fault]]:
    return {name: [Fault(kind, from_s, to_s, **more)] for name in NAMES}  # type: ignore[arg-type]


def meanwhile(reading_cm: int, usual_cm: int, to_s: float = TO_S) -> Callable[[str, float], int]:
    """What the world gives all sensors: another range from `FROM_S` on."""
    return lambda name, time_s: reading_cm if FROM_S <= time_s < to_s else usual_cm


def recovers(bench: Bench, truth_cm: int, stream: int = FUSED_ID) -> None:
    """The truth is sent again two rounds after the end, ten times a second, and all sensors are reported good."""
    after = bench.distances_cm(stream, TO_S + 2 * ROUND_S, END_S)
    assert len(after) >= (END_S - TO_S - 2 * ROUND_S) * 10 - 1
    assert set(after) == {truth_cm}
    assert list(bench.bridge.health.sensor_faults) == []


FAULTS_OF_AN_ANSWER = [
    # 0x8000 + 20..765: the master samples while the sensor stretches the clock.
    ("clock_fault", 500, "clock_fault", "I2C clock fault, use 50 kHz"),
    ("clock_fault", 765, "clock_fault", "I2C clock fault, use 50 kHz"),
    # The bytes of 1000 cm and others that no MB1242 sends.
    ("impossible", 500, "impossible", "impossible answers"),
    ("silent", 500, "no_answer", "no answer (errno 121)"),
]


@pytest.mark.parametrize(("kind", "reading_cm", "reason", "text"), FAULTS_OF_AN_ANSWER)
def test_a_fault_of_all_sensors_is_silence_and_is_reported(kind: str, reading_cm: int, reason: str, text: str) -> None:
    bench = Bench(airframe(), meanwhile(reading_cm, 500), faults=all_have(kind)).fly(END_S)
    assert set(bench.distances_cm()) == {500}
    assert bench.distances_cm(from_s=FROM_S + FUSED_MEMORY_S, to_s=TO_S) == []
    assert sorted(bench.reported(FROM_S, TO_S)) == [*(f"Range {name}: {text}" for name in NAMES), SILENT]
    assert sorted(bench.reported(TO_S)) == [*(f"Range {name}: good again" for name in NAMES), SPEAKS]
    assert all(set(bench.rejected(name)) <= {reason, "unconfirmed"} for name in NAMES)
    assert bench.texts() == bench.reported()
    recovers(bench, 500)


@pytest.mark.parametrize(("kind", "reading_cm", "reason", "text"), FAULTS_OF_AN_ANSWER)
def test_a_fault_of_one_sensor_leaves_ten_fused_messages_a_second(
    kind: str, reading_cm: int, reason: str, text: str
) -> None:
    bench = Bench(airframe(), 500, faults={"b": [Fault(kind, FROM_S, TO_S)]}).fly(END_S)
    assert len(bench.distances_cm(from_s=FROM_S, to_s=TO_S)) == 30
    assert set(bench.distances_cm()) == {500}
    assert bench.reported(FROM_S, TO_S) == [f"Range b: {text}"]
    assert set(bench.rejected("b")) == {reason}
    recovers(bench, 500)


@pytest.mark.parametrize("kind", ["clock_fault", "impossible", "silent"])
def test_a_single_stream_is_silent_while_its_sensor_is_out_of_order(kind: str) -> None:
    bench = Bench(one_down(), 500, faults={"a": [Fault(kind, FROM_S, TO_S)]}).fly(END_S)
    assert bench.distances_cm(1, FROM_S + 0.1, TO_S) == []
    recovers(bench, 500, stream=1)


def test_now_and_then_a_clock_fault_is_counted_and_never_sent() -> None:
    faults = all_have("clock_fault", 0.0, 60.0, probability=0.2)
    bench = Bench(airframe(), 500, faults=faults).fly(60.0)
    counted = sum(bench.rejected(name)["clock_fault"] for name in NAMES)
    # 600 readings, a fifth of them: 120 +- 10.
    assert 80 < counted < 160
    assert set(bench.distances_cm()) == {500}
    # The first distance waits for two readings that agree; two faults in a row from a round are silence, and three of
    # one sensor cost it its slot for 2 s.
    assert len(bench.distances_cm()) >= 585


@pytest.mark.parametrize("kind", ["or_ed", "saturated"])
@pytest.mark.parametrize("truth_cm", [310, 700])
@pytest.mark.parametrize("filters", [[], KALMAN])
def test_a_missed_echo_that_reads_255_is_not_a_distance(
    kind: str, truth_cm: int, filters: list[dict[str, str]]
) -> None:
    faults = all_have(kind, FROM_S, TO_S)
    bench = Bench(airframe(filters=filters), meanwhile(765, truth_cm), faults=faults).fly(END_S)
    assert set(bench.distances_cm()) == {truth_cm}
    assert bench.distances_cm(from_s=FROM_S + FUSED_MEMORY_S, to_s=TO_S) == []
    assert all(set(bench.rejected(name)) <= {"suspect", "unconfirmed"} for name in NAMES)
    assert SILENT in bench.reported(FROM_S, TO_S)
    recovers(bench, truth_cm)


def test_255_is_a_legal_height() -> None:
    def world(name: str, time_s: float) -> int:
        return max(350 - round(30 * time_s), 255)

    bench = Bench(airframe(), world).fly(END_S)
    assert bench.distances_cm(from_s=FROM_S)[-50:] == [255] * 50
    assert all(bench.rejected(name).keys() <= {"unconfirmed"} for name in NAMES)


def test_range_modulo_256_of_one_sensor_does_not_move_the_fused_stream() -> None:
    """503 cm reads 247, which no check of the value can find; the other sensors do."""
    bench = Bench(airframe(), 503, faults={"c": [Fault("lost_high_byte", FROM_S, TO_S)]}).fly(END_S)
    assert set(bench.distances_cm()) == {503}
    assert len(bench.distances_cm(from_s=FROM_S, to_s=TO_S)) == 30
    recovers(bench, 503)


@pytest.mark.parametrize(("then_cm", "reason"), [(503, "unexpected"), (765, "suspect")])
def test_range_modulo_256_once_is_held_back_in_a_single_stream(then_cm: int, reason: str) -> None:
    """Also that of a missed echo, which is suspect by itself."""

    faults = {"a": [Fault("lost_high_byte", FROM_S, FROM_S + 0.1)]}
    bench = Bench(one_down(filters=KALMAN), meanwhile(then_cm, 503, FROM_S + 0.1), faults=faults).fly(END_S)
    assert set(bench.distances_cm(1)) == {503}
    assert bench.rejected("a") == {"unconfirmed": 1, reason: 1}


def test_a_stuck_sensor_does_not_hold_the_fused_stream_back() -> None:
    """Reads that answer but never change, in a climb at 1 m/s: what is seen where a read pings again."""

    def climb(name: str, time_s: float) -> int:
        return 100 + round(100 * min(max(time_s - FROM_S, 0.0), TO_S - FROM_S))

    bench = Bench(airframe(), climb, faults={"d": [Fault("stuck", FROM_S, TO_S)]}).fly(TO_S)
    for time_s, message in bench.sent()[60:]:
        # Until the stuck one is known to be stuck, the stream may lag: a quarter of a second at most.
        assert message.current_distance == pytest.approx(climb("", time_s), abs=25)


@pytest.mark.parametrize("filters", [[], KALMAN])
def test_a_sensor_that_did_not_answer_once_is_asked_again(filters: list[dict[str, str]]) -> None:
    """Deaf from its ping on, for one ranging: the failed read of which other drivers never recover."""
    ping_s = 4.8
    faults = {"a": [Fault("silent", ping_s + 0.001, ping_s + 0.09)]}
    bench = Bench(airframe(filters=filters), 300, faults=faults).fly(END_S)
    pings_s = [time_s for time_s, name, _ in bench.pings if name == "a"]
    assert all(late - early == pytest.approx(ROUND_S) for early, late in pairwise(pings_s))
    statuses = [step.ranging.reading.status for step in bench.steps if step.ranging.reading.sensor == "a"]
    assert Counter(statuses) == {Status.NO_ANSWER: 1, Status.OK: len(statuses) - 1}
    assert set(bench.distances_cm()) == {300}
    # Once is not yet worth a word.
    assert bench.reported() == ["Range: all 4 sensors good"]


def test_a_missed_read_costs_two_milliseconds() -> None:
    bench = Bench(airframe(), 300, faults=all_have("missed_read", 0.0, END_S)).fly(END_S)
    assert {step.ranging.reading.status for step in bench.steps} == {Status.OK}
    assert len(bench.distances_cm()) == pytest.approx(120, abs=1)


def test_a_message_has_the_distance_and_the_time_of_its_own_echo() -> None:
    """Every ping sees another range, in turn by four sensors: a value that is a round old would be of another ping."""
    draw = random.Random(3)
    directions = [sensor(name, number, 0.0, 90.0 * number) for number, name in enumerate(NAMES, start=1)]
    bench = Bench(
        airframe(directions, filters=[], send={"sensors": "all"}),
        lambda name, time_s: 300 if time_s < 0.75 else draw.randrange(21, 764),
    ).fly(20.0)
    sent = [(message.id, message.current_distance, message.time_boot_ms) for _, message in bench.sent()]
    # The first round waits for the second one, which agrees with it.
    assert len(sent) >= 195
    for (ping_s, name, reading_cm), (stream, distance_cm, boot_ms) in zip(bench.pings[4:], sent, strict=False):
        assert (stream, distance_cm) == (NAMES.index(name) + 1, reading_cm)
        echo_ms = 1000 * (ping_s + reading_cm * 58e-6 / 2)
        assert echo_ms - 1 - 1e-6 <= boot_ms <= echo_ms + 1e-6


@pytest.mark.parametrize(
    ("answer", "reason"),
    [(b"", "clock_fault"), (b"\x51\x51", "impossible"), (b"\x00\x00", "impossible"), (b"\x01\x02", "impossible")],
)
def test_another_device_at_the_address_of_a_sonar_is_no_sonar(answer: bytes, reason: str) -> None:
    """What an SHTC3, a PCA9685 or a TCA9548A at 0x70 may say: a released line, its last byte, zeros, 258 at once."""
    bench = Bench(airframe(), 500, absent="a", others=[PlainDevice(0x70, answer)]).fly(END_S)
    assert set(bench.distances_cm()) == {500}
    assert set(bench.rejected("a")) == {reason}
    assert len(bench.reported()) == 1
    assert list(bench.bridge.health.sensor_faults) == ["a"]


def test_part_information_after_a_power_cycle_is_not_a_distance() -> None:
    """300 cm in the part information's bytes, read in a ranging in the middle of which the power was gone."""
    ping_s = 5.3
    faults = {"b": [Fault("power_cycle", ping_s + 0.005, ping_s + 0.005), Fault("power_cycle", 6.0, TO_S)]}
    bench = Bench(airframe(filters=[]), 500, faults=faults).fly(END_S)
    assert set(bench.distances_cm()) == {500}
    statuses = Counter(step.ranging.reading.status for step in bench.steps if step.ranging.reading.sensor == "b")
    assert statuses[Status.IMPOSSIBLE] == 1
    assert {step.corrected.range_m for step in bench.steps} <= {5.0, None}
    assert bench.reported(6.0) == ["Range b: no answer (errno 121)", "Range b: good again"]
    recovers(bench, 500)


@pytest.mark.parametrize("duration_s", [0.0, 3.0])
def test_a_bus_that_locks_up_is_reopened_and_reported(duration_s: float) -> None:
    faults = {"a": [Fault("locked_up", FROM_S, FROM_S + duration_s)]}
    bench = Bench(airframe(), 500, faults=faults).fly(END_S)
    assert set(bench.distances_cm()) == {500}
    reported = bench.reported(FROM_S)
    assert reported[0] == "Range: I2C bus locked up, reopening (errno 110)"
    assert reported.count("Range: I2C bus works again") == 1
    assert bench.texts() == bench.reported()
    if duration_s:
        assert bench.distances_cm(from_s=FROM_S + FUSED_MEMORY_S, to_s=TO_S) == []
        assert {f"Range {name}: good again" for name in NAMES} <= set(reported)
    else:
        # Opening it again heals it, so one reading is lost.
        assert sum(bench.rejected(name).get("no_answer", 0) for name in NAMES) == 1
        assert len(reported) == 2
    recovers(bench, 500)


@pytest.mark.parametrize(("share", "allowed"), [(0.05, 0.0), (0.10, 0.005)])
def test_short_readings_of_rotor_noise_do_not_move_the_fused_stream(share: float, allowed: float) -> None:
    """The line follows three outliers of five: one in a hundred of unfiltered readings, far fewer of filtered."""
    draw = random.Random(11)

    def noisy(name: str, time_s: float) -> int:
        return draw.randrange(20, 300) if draw.random() < share else 500 + round(draw.gauss(0.0, 1.5))

    bench = Bench(airframe(filters=KALMAN), noisy).fly(200.0)
    off_cm = [abs(distance_cm - 500) for distance_cm in bench.distances_cm()]
    assert len(off_cm) >= 1970
    assert sum(off > 20 for off in off_cm) <= allowed * len(off_cm)
    assert sorted(off_cm)[len(off_cm) // 2] <= 2


def test_no_echo_is_above_the_maximum_and_no_fault() -> None:
    bench = Bench(airframe(), meanwhile(765, 750)).fly(END_S)
    assert set(bench.distances_cm(from_s=FROM_S + ROUND_S, to_s=TO_S)) == {766}
    assert set(bench.distances_cm()) == {750, 766}
    assert bench.reported(FROM_S) == []
    assert len(bench.distances_cm(from_s=FROM_S + ROUND_S, to_s=TO_S)) == 26
    recovers(bench, 750)


def test_no_echo_of_a_ground_that_was_near_is_silence_that_is_reported() -> None:
    """Nobody can be 6 m higher within a second, and nobody knows how much higher the vehicle is later."""

    bench = Bench(airframe(), meanwhile(765, 130)).fly(END_S)
    assert set(bench.distances_cm(from_s=FROM_S + 0.3, to_s=FROM_S + 1.5)) == set()
    assert bench.reported(FROM_S, FROM_S + 2.0) == [SILENT]
    recovers(bench, 130)
