"""MaxSonars on a serial port: lines and what is none, through the whole bridge, and on a real pseudoterminal."""

import errno
import os
import random
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range import check
from msp_range.bridge import Bridge, Step
from msp_range.bus import Address, BusError, serial_ports
from msp_range.bus.serial_ports import SerialPorts, open_port
from msp_range.bus.smbus import KernelBus
from msp_range.clock import VirtualClock
from msp_range.config import Airframe
from msp_range.doctor.finding import RIGHT
from msp_range.doctor.sensors import examine_sensors
from msp_range.reading import Status
from msp_range.recording.csv_form import write_csv
from msp_range.recording.export import measured_data
from msp_range.recording.pings import read_recorded
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder
from msp_range.replay import Nowhere, replay
from msp_range.sensors.base import AddressError
from msp_range.sensors.maxsonar import GARBLED, MaxSonar, MaxSonarCm, MaxSonarMm, MaxSonarMm10m
from msp_range.sensors.table import DRIVERS
from msp_range.yaml_file import ConfigError
from msp_sim.device.device import Fault, NotAcknowledged
from msp_sim.device.maxsonar import EmulatedMaxSonarCm, Unplugged
from msp_sim.device.pty_port import PtyPort
from msp_sim.device.table import EMULATED
from tests.support.bench import Bench, Wire, airframe, assert_reported, sensor

PORT = "serial:/dev/ttyUSB0:9600"
FROM_S, TO_S, END_S = 5.0, 8.0, 12.0
CYCLE_S, SENT_S, LINE_S = 0.099, 0.0784, 5 * 10 / 9600
FAMILIES: list[type[MaxSonar]] = [MaxSonarCm, MaxSonarMm, MaxSonarMm10m]


class Arriving:
    """A serial port from which these pieces arrive, one at each read."""

    def __init__(self, *pieces: bytes) -> None:
        self.pieces = list(pieces)

    def write(self, address: Address, data: bytes) -> None: ...
    def read(self, address: Address, count: int) -> bytes:
        if not self.pieces:
            raise BusError(errno.EAGAIN, "read", address)
        return self.pieces.pop(0)

    def busy_s(self, address: Address) -> float:
        return 0.0

    def reopen(self) -> None: ...
    def close(self) -> None: ...


def answers(family: type[MaxSonar], *pieces: bytes) -> list[tuple[Status, float | None]]:
    """What a driver makes of pieces of bytes after a ping."""
    driver = family(Arriving(*pieces), PORT)
    driver.ping()
    found = []
    for _ in pieces:
        with suppress(BusError):
            decoded = driver.answer()
            found.append((decoded.status, decoded.range_m))
    return found


@pytest.mark.parametrize(
    ("family", "line", "expected"),
    [
        (MaxSonarCm, b"R258", (Status.OK, 2.58)),
        (MaxSonarCm, b"R020", (Status.AT_MINIMUM, 0.20)),
        (MaxSonarCm, b"R764", (Status.OK, 7.64)),
        (MaxSonarCm, b"R765", (Status.NO_ECHO, None)),
        (MaxSonarCm, b"R766", (Status.IMPOSSIBLE, None)),
        (MaxSonarCm, b"R2580", (Status.IMPOSSIBLE, None)),
        (MaxSonarCm, b"R 58", (Status.IMPOSSIBLE, None)),
        (MaxSonarCm, b"R25\xb2", (Status.IMPOSSIBLE, None)),
        (MaxSonarMm, b"R2584", (Status.OK, 2.584)),
        (MaxSonarMm, b"R0299", (Status.IMPOSSIBLE, None)),
        (MaxSonarMm, b"R5001", (Status.IMPOSSIBLE, None)),
        (MaxSonarMm, b"R0300", (Status.AT_MINIMUM, 0.30)),
        (MaxSonarMm, b"R5000", (Status.NO_ECHO, None)),
        (MaxSonarMm, b"R258", (Status.IMPOSSIBLE, None)),
        (MaxSonarMm10m, b"R5000", (Status.OK, 5.0)),
        (MaxSonarMm10m, b"R9998", (Status.OK, 9.998)),
        (MaxSonarMm10m, b"R9999", (Status.NO_ECHO, None)),
    ],
)
def test_what_a_line_means(family: type[MaxSonar], line: bytes, expected: tuple[Status, float | None]) -> None:
    ((status, range_m),) = answers(family, line + b"\r")
    assert (status, range_m and round(range_m, 6)) == expected


@pytest.mark.parametrize(
    ("pieces", "expected"),
    [
        ([b"R2", b"58", b"\r"], [(Status.OK, 2.58)]),
        # The end of a line that was on its way at the ping is none.
        ([b"58\r", b"R300\r"], [(Status.OK, 3.0)]),
        ([b"5", b"8\rR3", b"00\r"], [(Status.OK, 3.0)]),
        # The newest counts.
        ([b"R258\rR300\r"], [(Status.OK, 3.0)]),
        # Half a line and a whole one are no line, and neither is one without its end.
        ([b"R2R300\r"], [(Status.IMPOSSIBLE, None)]),
        ([b"R25\r"], [(Status.IMPOSSIBLE, None)]),
        ([b"R2\xf8\xf9", b"\xfa\xfb\xfc"], [(Status.IMPOSSIBLE, None)]),
        ([b"R258"], []),
    ],
)
def test_what_of_the_bytes_is_a_line(pieces: list[bytes], expected: list[tuple[Status, float | None]]) -> None:
    assert answers(MaxSonarCm, *pieces) == expected


def test_the_beginning_of_a_line_from_before_a_ping_is_dropped() -> None:
    driver = MaxSonarCm(Arriving(b"R2", b"58\r"), PORT)
    for _ in range(2):
        driver.ping()
        with pytest.raises(BusError):
            driver.answer()


@pytest.mark.parametrize("family", FAMILIES)
def test_every_recorded_word_is_played_as_the_line_that_gives_it_again(family: type[MaxSonar]) -> None:
    steps = range(family.minimum_cm * family.per_cm, family.no_echo_cm * family.per_cm - 1)
    for word in [*(step / family.per_cm for step in steps), family.no_echo_cm, GARBLED]:
        line = family.playback().answer(64, word, ranging=False)
        assert line is not None
        assert line.endswith(b"\r")
        assert family.word(line[:-1]) == word


def test_it_has_no_address_on_the_bus() -> None:
    bus = Arriving()
    assert not MaxSonarCm.identify(bus, VirtualClock(), 0x70).ranged
    with pytest.raises(AddressError, match="an XL-MaxSonar is on a serial port"):
        MaxSonarCm.move(bus, VirtualClock(), 0x70, 0x71)


@pytest.mark.parametrize("family", FAMILIES)
def test_no_echo_and_the_minimum_are_one_number_each(family: type[MaxSonar]) -> None:
    """Not those that round to it: the next millimetre, or centimetre, is a range."""
    least, most = family.minimum_cm * family.per_cm, min(family.no_echo_cm * family.per_cm, 10**family.digits - 1)

    def status(number: int) -> Status:
        return family.decode(family.word(f"R{number:0{family.digits}d}".encode())).status

    found = [status(number) for number in (least - 1, least, least + 1, most - 1, most)]
    assert found == [Status.IMPOSSIBLE, Status.AT_MINIMUM, Status.OK, Status.OK, Status.NO_ECHO]


# --- in an airframe file ---


def one_down(**changed: object) -> dict[str, object]:
    return sensor("a", 1) | {"address": PORT, "model": "sensors/mb1240.yaml"} | changed


def vehicle(**changed: object) -> Airframe:
    return airframe([one_down()], **({"send": {"sensors": ["a"]}, "filters": []} | changed))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"address": 0x70}, "an XL-MaxSonar is on a serial port, as address: serial:PATH:BAUD .*; found 0x70"),
        ({"model": "sensors/mb1242.yaml"}, f"an MB1242 is on the I2C bus.*; found {PORT}"),
        ({"address": "serial:/dev/ttyUSB0"}, "expected a 7-bit I2C address such as 0x70, or serial:PATH:BAUD"),
        ({"address": "/dev/ttyUSB0"}, "or serial:PATH:BAUD"),
        ({"address": "udpin:0.0.0.0:14550"}, "or serial:PATH:BAUD"),
        ({"address": "serial:/dev/ttyUSB0:9601"}, "or serial:PATH:BAUD"),
    ],
)
def test_an_address_that_is_refused(changed: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        airframe([one_down(**changed)])


def test_two_on_one_port_or_on_that_of_the_link_are_refused() -> None:
    with pytest.raises(ValueError, match=f"address {PORT} is given more than once"):
        airframe([one_down(), one_down(name="b", id=2)])
    with pytest.raises(ValueError, match=f"{PORT} is the link to the autopilot"):
        vehicle(link={"url": PORT})


def test_scan_and_address_are_for_the_bus() -> None:
    from msp_range.cli import driver_of

    with pytest.raises(ConfigError, match=r"an XL-MaxSonar is on a serial port.*msp-range doctor"):
        driver_of("maxsonar_cm")


# --- through the whole bridge, in virtual time ---


def bench(*faults: Fault, reading_cm: Callable[[str, float], int] | int = 300, **changed: Any) -> Bench:
    return Bench(vehicle(**changed), reading_cm, faults={"a": faults})


def test_every_line_is_a_message_and_its_time_is_that_of_its_echo() -> None:
    flown = bench().fly(10.0)
    readings = [step.ranging.reading for step in flown.steps]
    assert len(readings) == pytest.approx(10.0 / CYCLE_S, abs=2)
    assert {(reading.status, reading.raw) for reading in readings} == {(Status.OK, 300)}
    # A line is read within 3 ms of its end; the sound met the ground half a time of flight after the ping.
    for reading, (ping_s, _, _) in zip(readings, flown.pings, strict=False):
        assert reading.time_s - 50.0 - ping_s == pytest.approx(0.5 * 300 * 58e-6, abs=0.0032)
    assert flown.sent()[-1].message.type == common.MAV_DISTANCE_SENSOR_ULTRASOUND
    assert flown.reported() == ["Range: all 1 sensors good"]


def test_a_climb_is_not_late() -> None:
    def climb(name: str, time_s: float) -> int:
        return 100 + round(100 * time_s)

    flown = bench(reading_cm=climb).fly(5.0)
    last = flown.steps[-1].ranging.reading
    assert last.range_m is not None
    assert last.range_m == pytest.approx(climb("", last.time_s - 50.0) / 100, abs=0.02)


def test_a_program_that_stood_still_reads_nothing_old() -> None:
    flown = bench(reading_cm=lambda name, time_s: 300 if time_s < 1.0 else 400).fly(1.0)
    before = len(flown.steps)
    # Lines of four cycles arrive meanwhile, the last of them 50 ms ago.
    flown.clock.sleep_until(flown.clock.now() + 0.45)
    flown.fly(2.5)
    later = [step.ranging for step in flown.steps[before:]]
    assert later
    for ranging in later:
        if ranging.reading.range_m is not None:
            pinged_s = [ping_s for ping_s, _, _ in flown.pings]
            echo_s = ranging.reading.time_s - 50.0 - 0.5 * ranging.reading.range_m * 5.8e-3
            assert min(abs(echo_s - ping_s) for ping_s in pinged_s) < 0.004


def test_a_line_that_waited_while_the_program_stood_still_is_dropped() -> None:
    """Each pause ends within the time that an answer may take, so that this alone is late."""
    flown = bench().fly(1.0)
    for _ in range(20):
        before = len(flown.steps)
        flown.clock.sleep_until(flown.clock.now() + 0.06)
        flown.fly(flown.now() + 0.13)
        for step in flown.steps[before:]:
            echo_s = step.ranging.reading.time_s - 50.0 - 0.5 * 3.0 * 5.8e-3
            assert min(abs(echo_s - ping_s) for ping_s, _, _ in flown.pings) < 0.03


SILENT = [
    ("half_line", "no_answer", "no answer (errno 11)"),
    ("noise", "impossible", "impossible answers"),
    ("wrong_baud", "no_answer", "no answer (errno 11)"),
    ("silent", "no_answer", "no answer (errno 11)"),
    ("unplugged", "no_answer", "no answer (errno 2)"),
]


@pytest.mark.parametrize(("kind", "reason", "text"), SILENT)
def test_a_fault_is_silence_and_is_reported(kind: str, reason: str, text: str) -> None:
    flown = bench(Fault(kind, FROM_S, TO_S)).fly(END_S)
    assert set(flown.distances_cm(1)) == {300}
    assert flown.distances_cm(1, FROM_S + 0.2, TO_S) == []
    assert_reported(flown, FROM_S, TO_S, text, reason)


def test_power_that_comes_back_gives_distances_again() -> None:
    flown = bench(Fault("power_cycle", FROM_S, TO_S)).fly(END_S)
    assert set(flown.distances_cm(1)) == {300}
    assert flown.distances_cm(1, FROM_S + 0.2, TO_S) == []
    assert flown.distances_cm(1, TO_S + 0.5)


PORTS = [f"serial:/dev/ttyUSB{number}:9600" for number in range(4)]
FOUR = [one_down(name=name, id=1 + i, address=PORTS[i]) for i, name in enumerate("abcd")]


@pytest.mark.parametrize("kind", ["garbled_digit", "offset", "noisy"])
def test_one_of_four_with_wrong_digits_does_not_move_the_height(kind: str) -> None:
    groups = {"groups": [["a", "b", "c", "d"]]}
    flown = Bench(airframe(FOUR, polling=groups), 350, faults={"c": [Fault(kind, FROM_S, TO_S)]}).fly(END_S)
    assert all(abs(distance_cm - 350) <= 10 for distance_cm in flown.distances_cm())
    # All four are read in each cycle.
    assert len(flown.distances_cm(from_s=FROM_S, to_s=TO_S)) > 2 * 3.0 / CYCLE_S


def test_a_frozen_value_is_found_in_a_climb() -> None:
    def climb(name: str, time_s: float) -> int:
        return 150 + round(50 * min(max(time_s - FROM_S, 0.0), 8.0))

    groups = {"groups": [["a", "b", "c", "d"]]}
    flown = Bench(airframe(FOUR, polling=groups), climb, faults={"d": [Fault("stuck", FROM_S, 20.0)]}).fly(14.0)
    assert "Range d: stuck" in " ".join(flown.reported())


def test_ports_and_the_bus_fly_together() -> None:
    sonars = [sensor("b", 2), sensor("c", 3)]
    flown = Bench(airframe([one_down(), *sonars]), 300).fly(5.0)
    assert {name: count.readings for name, count in flown.bridge.counts().items()}.keys() == {"a", "b", "c"}
    assert min(count.readings for count in flown.bridge.counts().values()) > 10
    assert set(flown.distances_cm()) == {300}


@pytest.mark.parametrize("name", [name for name, driver in DRIVERS.items() if driver.is_serial])
def test_driver_and_emulated_device_agree(name: str) -> None:
    driver, device = DRIVERS[name], EMULATED[name]
    assert issubclass(driver, MaxSonar)
    assert (driver.minimum_cm, driver.no_echo_cm) == (device.minimum_cm, device.no_echo_cm)
    time_s = 0.0
    sent = device(PORT, lambda: time_s, lambda ping_s: driver.no_echo_cm - 1)
    time_s = device.default_timing.no_echo_s
    assert driver.word(sent.read(64).rstrip(b"\r")) == driver.no_echo_cm - 1


def test_an_emulated_sensor_gives_what_is_asked_for_and_forgets_what_was_on_its_wire() -> None:
    time_s = 0.0
    sonar = EmulatedMaxSonarCm(PORT, lambda: time_s, lambda ping_s: 258, faults=[Fault("unplugged", 0.1, 0.11)])
    time_s = 0.099
    assert sonar.read(2) == b"R2"
    time_s = 0.1
    with pytest.raises(Unplugged):
        sonar.read(64)
    time_s = 0.12
    with pytest.raises(NotAcknowledged):
        sonar.read(64)


# --- on a real pseudoterminal ---


class PumpedClock(VirtualClock):
    """Virtual time in which the port gets what its sensor sends."""

    port: PtyPort | None = None

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        super().sleep_until(time_s)
        if self.port is not None:
            self.port.pump()
        return False


class Flight:
    """The bridge on the kernel's terminal driver, with an emulated sensor behind it."""

    def __init__(self, folder: Path, *faults: Fault) -> None:
        self.clock = PumpedClock(50.0)
        path = folder / "ttyUSB0"
        self.sonar = EmulatedMaxSonarCm(
            PORT, lambda: self.clock.now() - 50.0, lambda ping_s: 258, faults=faults, chance=random.Random(1)
        )
        self.clock.port = self.port = PtyPort(path, self.sonar)
        self.port.pump()
        self.bus = KernelBus("/dev/i2c-that-is-not-there")
        self.reports: list[str] = []
        self.bridge = Bridge(
            airframe([one_down(address=f"serial:{path}:9600")], send={"sensors": ["a"]}, filters=[]),
            self.bus,
            self.clock,
            Wire(self.clock),
            report=lambda severity, text: self.reports.append(text),
        )
        self.steps: list[Step] = []

    def fly(self, until_s: float) -> list[Step]:
        """The steps up to this time since the start [s]."""
        before = len(self.steps)
        while self.clock.now() < 50.0 + until_s:
            self.steps += self.bridge.step()
        return self.steps[before:]


@contextmanager
def flight(folder: Path, *faults: Fault) -> Iterator[Flight]:
    flown = Flight(folder, *faults)
    yield flown
    flown.bus.close()
    flown.port.unplug()


def test_the_bridge_reads_a_port_and_needs_no_i2c_bus(tmp_path: Path) -> None:
    with flight(tmp_path) as flown:
        readings = [step.ranging.reading for step in flown.fly(3.0)]
    assert {(reading.status, reading.raw) for reading in readings} == {(Status.OK, 258)}
    assert len(readings) == pytest.approx(3.0 / CYCLE_S, abs=2)
    assert flown.reports == ["Range: all 1 sensors good"]


def test_an_adapter_that_is_unplugged_comes_back(tmp_path: Path) -> None:
    with flight(tmp_path, Fault("unplugged", 1.0, 3.0)) as flown:
        assert flown.fly(1.0)
        gone = [step.ranging for step in flown.fly(3.0)]
        back = [step.ranging.reading.status for step in flown.fly(8.0)]
    assert {ranging.reading.status for ranging in gone} == {Status.NO_ANSWER}
    # It was open, and then there is no such file.
    assert next(ranging.error.errno for ranging in gone if ranging.error) == errno.ENODEV
    assert [ranging.error.errno for ranging in gone if ranging.error][-1] == errno.ENOENT
    assert back.count(Status.OK) > 40
    assert "Range a: good again" in flown.reports


def test_noise_and_half_lines_on_a_port_are_no_distance(tmp_path: Path) -> None:
    faults = Fault("half_line", 0.0, 9.0, 0.3), Fault("noise", 0.0, 9.0, 0.3)
    with flight(tmp_path, *faults) as flown:
        readings = [step.ranging.reading for step in flown.fly(8.0)]
    assert {reading.range_m for reading in readings} == {2.58, None}
    assert {reading.status for reading in readings} >= {Status.OK, Status.IMPOSSIBLE}


def open_files() -> int:
    return len(os.listdir("/proc/self/fd"))


def test_a_rate_that_no_port_has_is_an_error_and_leaves_nothing_open(tmp_path: Path) -> None:
    with flight(tmp_path):
        before = open_files()
        with pytest.raises(OSError, match="no rate of 9601 baud"):
            open_port(str(tmp_path / "ttyUSB0"), 9601)
        assert open_files() == before


def test_a_port_that_takes_a_part_only_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with flight(tmp_path):
        ports, address, before = SerialPorts(), f"serial:{tmp_path / 'ttyUSB0'}:9600", open_files()
        monkeypatch.setattr(os, "write", lambda _, data: len(data) - 1)
        with pytest.raises(BusError) as caught:
            ports.write(address, b"ab")
        assert caught.value.errno == errno.EIO
        assert open_files() == before


def test_a_port_serves_one_program(tmp_path: Path) -> None:
    with flight(tmp_path) as flown:
        flown.fly(0.5)
        address = f"serial:{tmp_path / 'ttyUSB0'}:9600"
        second = SerialPorts()
        with pytest.raises(BusError) as caught:
            second.write(address, b"")
        # TIOCEXCL refuses all but root, and flock refuses root.
        assert caught.value.errno == errno.EBUSY
        assert not caught.value.bus_at_fault
        assert str(caught.value).startswith(f"serial write at address {address} failed")
        flown.bus.close()
        second.write(address, b"")
        second.close()


def test_a_ping_drops_what_has_arrived(tmp_path: Path) -> None:
    with flight(tmp_path) as flown:
        flown.fly(0.5)
        address = f"serial:{tmp_path / 'ttyUSB0'}:9600"
        for _ in range(60):
            flown.clock.sleep_until(flown.clock.now() + 0.003)
        assert flown.bus.busy_s(address) == 0.0
        flown.bus.write(address, b"")
        with pytest.raises(BusError) as caught:
            flown.bus.read(address, 64)
    assert caught.value.errno == errno.EAGAIN


def test_a_port_whose_read_fails_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(file: int, count: int) -> bytes:
        raise OSError(errno.EIO, "unplugged")

    with flight(tmp_path) as flown:
        flown.fly(0.5)
        address = f"serial:{tmp_path / 'ttyUSB0'}:9600"
        with monkeypatch.context() as patched:
            patched.setattr(serial_ports.os, "read", fail)
            with pytest.raises(BusError) as caught:
                flown.bus.read(address, 64)
        assert caught.value.errno == errno.EIO
        with pytest.raises(BusError) as caught:
            flown.bus.read(address, 64)
        assert caught.value.errno == errno.ENODEV
        flown.bus.write(address, b"")


def test_a_missing_port_and_one_that_was_not_opened() -> None:
    ports = SerialPorts()
    with pytest.raises(BusError) as caught:
        ports.write("serial:/dev/no-such-port:9600", b"")
    assert (caught.value.errno, caught.value.calls_for_reopening) == (errno.ENOENT, False)
    with pytest.raises(BusError) as caught:
        ports.read("serial:/dev/no-such-port:9600", 64)
    assert (caught.value.errno, caught.value.calls_for_reopening) == (errno.ENODEV, False)
    with pytest.raises(OSError, match="Inappropriate ioctl"):
        open_port(os.devnull, 9600)


def test_a_doctor_reads_it_and_asks_nothing_of_the_bus(tmp_path: Path) -> None:
    with flight(tmp_path) as flown:
        examined = examine_sensors(flown.bridge.airframe, flown.bus, flown.clock)
    assert [(each.step, each.verdict) for each in examined.findings] == [("readings of a", RIGHT)]
    assert examined.ranges_m == {"a": 2.58}
    assert examined.latency_s == pytest.approx(SENT_S - 0.5 * 258 * 58e-6, abs=0.004)


def test_a_check_says_who_pings_itself() -> None:
    assert "a: not pinged; each range is read when the sensor has sent it" in [*check.lines(vehicle())]


def millimetres(**changed: Any) -> Airframe:
    return airframe([one_down(model="sensors/mb7360.yaml")], **({"send": {"sensors": ["a"]}} | changed))


def test_millimetres_are_recorded_filtered_and_played_again(tmp_path: Path) -> None:
    """What is sent has whole centimetres, by the protocol."""
    path, again, table = tmp_path / "flight.mcap", tmp_path / "again.mcap", tmp_path / "table.csv"
    recorder = Recorder(path, VirtualClock(50.0))
    flown = Bench(millimetres(), lambda name, time_s: 258.18 + 0.1 * (time_s > 5.0), recorder=recorder).fly(9.0)
    recorder.close()
    readings = [step.ranging.reading for step in flown.steps]
    assert {each.raw for each in readings} == {258.2, 258.3}
    assert set(flown.distances_cm(1)) == {258}
    data = measured_data(Recording(path))
    assert set(data["reading_cm"]) == {258.2, 258.3}
    write_csv(table, data)
    models = {"a": millimetres().sensors[0].sensor_model}
    assert {ping.word for ping in read_recorded(table, models=models).pings["a"]} == {258.2, 258.3}
    recorded = read_recorded(path)
    clock = VirtualClock(recorded.first_ping_s)
    recorder = Recorder(again, clock)
    replay(millimetres(), recorded, path, clock, Nowhere(), recorder)
    recorder.close()
    kept, played = (
        [(each["raw"], each.get("filtered_m")) for topic, _, each in Recording(file) if topic == "/range/a"]
        for file in (path, again)
    )
    assert kept[-1][1] == pytest.approx(2.583, abs=1e-3)
    assert played == kept[: len(played)]
    assert len(played) == pytest.approx(len(kept), abs=1)


def test_what_a_finer_model_has_of_a_sensor_is_not_what_its_driver_answers() -> None:
    """Its noise includes the rounding to the driver's steps."""
    assert millimetres().sensors[0].sensor_model.answered_cm == 0.1
    assert vehicle().sensors[0].sensor_model.model_copy(update={"resolution_cm": 0.1}).answered_cm == 1.0


def test_one_that_compensates_is_not_corrected_for_the_air() -> None:
    cold = {"fixed_c": -10.0, "fixed_std_c": 1.0}
    compensated = millimetres(temperature=cold, filters=[])
    plain = vehicle(temperature=cold)
    assert set(Bench(compensated, 300).fly(3.0).distances_cm(1)) == {300}
    assert set(Bench(plain, 300).fly(3.0).distances_cm(1)) == {283}
