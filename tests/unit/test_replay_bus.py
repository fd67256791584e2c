"""Recorded readings on the replay bus: the driver gets them back, with their own times."""

import errno
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from msp_range.acoustics.air import Air
from msp_range.bus.base import Address, Bus, BusError
from msp_range.clock import VirtualClock
from msp_range.reading import Reading, Status
from msp_range.recording.error import RecordingError
from msp_range.recording.export import export
from msp_range.recording.pings import MEASURED_STD_C, Pings, read_recorded
from msp_range.recording.replay_bus import ReplayBus
from msp_range.recording.writer import Recorder
from msp_range.sensors.base import RecordedPing
from msp_range.sensors.mb1242 import COMMAND_RANGE, MB1242
from msp_range.sensors.polling import Poller, Ranging
from msp_range.sensors.schedule import AnswerTiming, PolledSensor

LEFT, RIGHT = 0x70, 0x71
near: Any = pytest.approx
"""A number that one of another type is compared with."""
# Times of no answer are sums of binary fractions, which are exact.
TIMING = AnswerTiming(first_answer_s=0.0212, deadline_s=80 / 1024)


def next_ping_s(bus: ReplayBus, address: int) -> float:
    ping = bus.next_ping(address)
    assert ping is not None
    return ping.ping_s


def played(pings: dict[Address, list[RecordedPing]], clock: VirtualClock) -> ReplayBus:
    return ReplayBus(pings, clock, dict.fromkeys(pings, MB1242.playback))


def refused(bus: Bus, verb: str, address: int) -> bool:
    """Check that the sensor does not acknowledge."""
    with pytest.raises(BusError) as refusal:
        bus.write(address, COMMAND_RANGE) if verb == "write" else bus.read(address, 2)
    error = refusal.value
    return (error.errno, error.address, error.verb) == (errno.EREMOTEIO, address, verb)


def test_a_sensor_answers_when_it_is_ready_and_again(tmp_path: Path) -> None:
    clock = VirtualClock()
    bus = played({LEFT: [RecordedPing(1.0, 258, 0.035), RecordedPing(2.0, 300, 0.037)]}, clock)
    assert next_ping_s(bus, LEFT) == 1.0
    assert MB1242(bus, LEFT).answer().status is Status.PART_INFO
    clock.sleep_until(1.0)
    bus.write(LEFT, COMMAND_RANGE)
    assert next_ping_s(bus, LEFT) == 2.0
    assert refused(bus, "read", LEFT)
    assert refused(bus, "write", LEFT)
    clock.sleep_until(1.0349)
    assert refused(bus, "read", LEFT)
    clock.sleep_until(1.0351)
    assert bus.read(LEFT, 2) == bytes([1, 2])
    assert bus.read(LEFT, 2) == bytes([1, 2])
    bus.write(LEFT, b"\xaa\xa5\xe2")
    assert next_ping_s(bus, LEFT) == 2.0
    bus.reopen()
    bus.close()


def test_a_ping_that_was_not_acknowledged_is_not_acknowledged_again() -> None:
    """A schedule that gave its time to the next sensor did so because there was no sound."""
    clock = VirtualClock()
    bus = played({LEFT: [RecordedPing(1.0, None, 0.0), RecordedPing(2.0, 300, 0.037)]}, clock)
    clock.sleep_until(1.0)
    assert refused(bus, "write", LEFT)
    assert next_ping_s(bus, LEFT) == 2.0
    bus.write(LEFT, COMMAND_RANGE)
    clock.sleep_until(1.1)
    assert bus.read(LEFT, 2) == (300).to_bytes(2, "big")


def test_no_answer_is_none_until_the_next_ping() -> None:
    clock = VirtualClock()
    bus = played({LEFT: [RecordedPing(1.0, None, 0.05), RecordedPing(2.0, 300, 0.037)]}, clock)
    clock.sleep_until(1.0)
    bus.write(LEFT, COMMAND_RANGE)
    clock.sleep_until(2.0)
    assert refused(bus, "read", LEFT)
    bus.write(LEFT, COMMAND_RANGE)
    clock.sleep_until(2.1)
    assert bus.read(LEFT, 2) == (300).to_bytes(2, "big")


def test_after_the_last_reading_and_where_there_was_no_sensor() -> None:
    clock = VirtualClock()
    bus = played({LEFT: [RecordedPing(0.0, 300, 0.037)]}, clock)
    bus.write(LEFT, COMMAND_RANGE)
    assert bus.next_ping(LEFT) is None
    clock.sleep_until(1.0)
    assert bus.read(LEFT, 2) == (300).to_bytes(2, "big")
    assert refused(bus, "write", LEFT)
    assert bus.next_ping(RIGHT) is None
    assert refused(bus, "write", RIGHT)
    assert refused(bus, "read", RIGHT)


def test_late_pings_lose_nothing_and_are_reported() -> None:
    clock = VirtualClock()
    bus = played({LEFT: [RecordedPing(0.01 * count, 20 + count, 0.02) for count in range(5)]}, clock)
    words = []
    for _ in range(5):
        bus.write(LEFT, COMMAND_RANGE)
        clock.sleep_until(clock.now() + 0.025)
        words.append(int.from_bytes(bus.read(LEFT, 2), "big"))
    assert words == [20, 21, 22, 23, 24]
    assert bus.behind_s == pytest.approx(4 * 0.015, abs=1e-12)


def write_csv_text(path: Path, rows: str, header: str = "time_s,sensor,reading_cm") -> Path:
    path.write_text(f"{header}\n{rows}")
    return path


def test_a_csv_file_gives_pings(tmp_path: Path) -> None:
    path = write_csv_text(
        tmp_path / "a.csv", "1,left,200\n2,left,765\n3,left,\n4,left,33168\n4.5,right,81.6\n5,left,0.4"
    )
    pings = read_recorded(path).pings
    # The ping is half a time of flight of 58 us/cm before the echo, where there was one.
    assert pings == {
        "left": [
            RecordedPing(near(1 - 0.0058, abs=1e-12), 200, near(0.020 + 0.0116, abs=1e-12)),
            RecordedPing(2.0, 765, 0.067),
            RecordedPing(3.0, None, near(0.020)),
            RecordedPing(4.0, 0x8000 + 400, near(0.020 + 0.0232, abs=1e-12)),
            RecordedPing(5.0, 0, 0.020),
        ],
        "right": [RecordedPing(near(4.5 - 29e-6 * 82, abs=1e-12), 82, near(0.020 + 58e-6 * 82))],
    }


def test_a_recorded_answer_is_there_from_the_time_at_which_it_was_read(tmp_path: Path) -> None:
    """However far apart the tries were when it was recorded."""
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    message = {"time_s": 1.0087, "ping_s": 1.0, "read_s": 1.0372 + 0.0005, "status": "ok", "raw": 300, "range_m": 3.0}
    recorder.write("/range/left", 1.04, message)
    recorder.close()
    ((ping_s, word, ready_s),) = read_recorded(tmp_path / "flight.mcap").pings["left"]
    assert (ping_s, word) == (1.0, 300)
    assert ready_s == pytest.approx(0.0377)


def test_air_that_was_recorded_without_its_deviation_has_that_of_its_source(tmp_path: Path) -> None:
    path = write_csv_text(
        tmp_path / "a.csv", "1,left,200,4.5\n2,left,200,\n", "time_s,sensor,reading_cm,air_temperature_c"
    )
    assert read_recorded(path).air == [(1.0, Air(4.5, MEASURED_STD_C, "recorded"))]
    header = "time_s,sensor,reading_cm,air_temperature_c,humidity_pct"
    path = write_csv_text(tmp_path / "humid.csv", "1,left,200,4.5,80\n2,left,200,5,\n", header)
    assert [each for _, each in read_recorded(path).air] == [
        Air(4.5, MEASURED_STD_C, "recorded", 80.0),
        Air(5.0, MEASURED_STD_C, "recorded"),
    ]
    recorder = Recorder(tmp_path / "flight.mcap", VirtualClock())
    reading = {"ping_s": 1.0, "read_s": 1.0, "status": "no_echo"}
    air = reading | {"temperature_c": 20.0, "temperature_source": "fixed"}
    recorder.write("/range/left", 1.0, {"time_s": 1.0} | air)
    recorder.write("/range/left", 2.0, {"time_s": 2.0} | air | {"temperature_source": "SCALED_PRESSURE.temperature"})
    recorder.write("/range/left", 3.0, {"time_s": 3.0} | air | {"temperature_std_c": 3.5, "temperature_source": "held"})
    recorder.write("/range/left", 4.0, {"time_s": 4.0} | air | {"humidity_pct": -1e9})
    recorder.write("/range/left", 5.0, {"time_s": 5.0} | air | {"humidity_pct": 70.0})
    recorder.close()
    # What is no humidity comes from a damaged file.
    assert [each for _, each in read_recorded(tmp_path / "flight.mcap").air] == [
        Air(20.0, 12.0, "fixed"),
        Air(20.0, MEASURED_STD_C, "SCALED_PRESSURE.temperature"),
        Air(20.0, 3.5, "held"),
        Air(20.0, 12.0, "fixed", 70.0),
    ]


def test_one_run_at_a_time(tmp_path: Path) -> None:
    header = "time_s,sensor,reading_cm,run"
    path = write_csv_text(tmp_path / "a.csv", "1,left,200,one\n2,left,201,one\n1,left,300,two\n", header)
    assert [each.word for each in read_recorded(path, run="one").pings["left"]] == [200, 201]
    assert [each.word for each in read_recorded(path, run="two").pings["left"]] == [300]
    with pytest.raises(RecordingError, match=r"a\.csv: choose one run; found: one, two"):
        read_recorded(path)
    with pytest.raises(RecordingError, match="no run 'three'; found: one, two"):
        read_recorded(path, run="three")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("", "no readings to replay"),
        ("1,left,20\n0.5,left,30", "sensor 'left': time_s goes back from 1.0 to 0.5"),
        (
            "1,left,-1",
            "sensor 'left' at 1.0 s: reading_cm -1 is not a number that the sensor's two bytes can hold",
        ),
        ("1,left,70000", "reading_cm 70000 is not"),
        ("1e15,left,20", r"found time_s 1e\+15, expected seconds, at most 1e\+10"),
        ("nan,left,20\n1,left,30", "column 'time_s': found 'nan', expected a number"),
    ],
)
def test_csv_that_cannot_be_replayed(tmp_path: Path, rows: str, message: str) -> None:
    path = write_csv_text(tmp_path / "a.csv", rows)
    with pytest.raises(RecordingError, match=message):
        read_recorded(path)


class RecordedOrder:
    """A poller's schedule: each sensor at its next recorded ping."""

    def __init__(self, bus: ReplayBus, sensors: dict[int, PolledSensor]) -> None:
        self._bus = bus
        self._sensors = sensors

    def turn(self, last_ping_s: float, acknowledged: bool) -> tuple[float, Sequence[PolledSensor]]:
        due = {
            ping.ping_s: sensor
            for address, sensor in self._sensors.items()
            if (ping := self._bus.next_ping(address)) is not None
        }
        return (min(due), [due[min(due)]]) if due else (math.inf, [])

    def on_reading(self, reading: Reading) -> None:
        """Nothing to learn."""

    def again(self, sensor: str) -> None:
        """Nothing to repeat."""


def replay(pings: Pings) -> list[Ranging]:
    """Play everything through the driver and the poller, each sensor pinged at its recorded times."""
    clock = VirtualClock(start_s=min(each[0].ping_s for each in pings.values()))
    addresses = {name: LEFT + count for count, name in enumerate(pings)}
    bus = played({addresses[name]: list(each) for name, each in pings.items()}, clock)
    sensors = {address: PolledSensor(name, MB1242(bus, address), TIMING) for name, address in addresses.items()}
    poller = Poller(bus, clock, RecordedOrder(bus, sensors))
    rangings = []
    while poller.next_event_s < math.inf:
        clock.sleep_until(poller.next_event_s)
        rangings += poller.step()
    return rangings


_WORDS = st.none() | st.integers(0, 0xFFFF) | st.integers(20, 765)


@settings(max_examples=50)
@given(st.lists(st.tuples(_WORDS, st.integers(90, 2000)), min_size=1, max_size=20))
def test_the_driver_gets_every_word_at_its_own_time(readings: list[tuple[int | None, int]]) -> None:
    pings, ping_s = [], 10.0
    for word, gap in readings:
        pings.append(RecordedPing(ping_s, word, 0.067))
        ping_s += gap / 1024
    rangings = replay({"left": pings})
    assert [each.reading.raw for each in rangings] == [word for word, _ in readings]
    assert [each.ping_s for each in rangings] == [each.ping_s for each in pings]


def test_csv_times_come_back_from_the_driver(tmp_path: Path) -> None:
    rows = [(1.0, "left", 200), (1.1, "right", 764), (1.2, "left", 765), (1.3, "right", 20), (1.45, "left", 699)]
    path = write_csv_text(tmp_path / "a.csv", "\n".join(f"{time_s},{name},{cm}" for time_s, name, cm in rows))
    readings = [each.reading for each in replay(read_recorded(path).pings)]
    assert [(each.sensor, each.raw) for each in readings] == [(name, cm) for _, name, cm in rows]
    # The driver adds what was taken off: equal but for the rounding of doubles.
    assert [each.time_s for each in readings] == pytest.approx([time_s for time_s, _, _ in rows], abs=1e-12)


def record(path: Path, rangings: list[Ranging]) -> None:
    recorder = Recorder(path, VirtualClock())
    for each in rangings:
        reading = each.reading
        message = {
            "time_s": reading.time_s,
            "ping_s": each.ping_s,
            "read_s": each.answered_s,
            "status": reading.status.value,
            "raw": reading.raw,
            "range_m": reading.range_m,
            "std_m": reading.std_m,
            "suspect": reading.suspect,
        }
        recorder.write(f"/range/{reading.sensor}", each.answered_s, message)
    recorder.close()


def test_a_replayed_recording_is_the_recording(tmp_path: Path) -> None:
    """Status, word and times, also of an answer that came too early to be one and of one that took its time."""
    odd = [
        RecordedPing(5.0, 300, 0.0374),
        RecordedPing(5.125, 300, 0.002),
        RecordedPing(5.25, None, 0.0),
        RecordedPing(5.375, 300, 0.0741),
        RecordedPing(5.5, 0x8000 + 21, 0.0213),
        RecordedPing(5.625, 765, 0.067),
        RecordedPing(5.75, 255, 0.035),
    ]
    first = replay({"left": odd, "right": [RecordedPing(6.0, 20, 0.022)]})
    assert [each.reading.status for each in first] == [
        Status.OK,
        Status.IMPOSSIBLE,
        Status.NO_ANSWER,
        Status.OK,
        Status.CLOCK_FAULT,
        Status.NO_ECHO,
        Status.OK,
        Status.AT_MINIMUM,
    ]
    record(tmp_path / "flight.mcap", first)
    second = replay(read_recorded(tmp_path / "flight.mcap").pings)
    assert [each.reading for each in second] == [each.reading for each in first]
    assert [(each.ping_s, each.answered_s) for each in second] == [(each.ping_s, each.answered_s) for each in first]
    # Exported, it has the same words. A CSV file does not say when an answer came, so not that it came too early.
    export(tmp_path / "flight.mcap", tmp_path / "flight.csv")
    third = replay(read_recorded(tmp_path / "flight.csv").pings)
    assert [each.reading.raw for each in third] == [each.reading.raw for each in first]
    pings = [(again.ping_s, each.ping_s) for again, each in zip(third, first, strict=True)]
    assert all(again_s == pytest.approx(ping_s, abs=1e-12) for again_s, ping_s in pings[:1] + pings[2:])
