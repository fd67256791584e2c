"""`msp-range doctor` on computers that their owners have set up well, or with one error each.

A set-up is what a person did: files of the computer, sensors on umockdev's I2C bus, a serial port or a network address
with an autopilot that pymavlink plays, an airframe file. What doctor looks at was no guide in choosing them. Where a
set-up has a docstring it is from a blind set: written from forums and data sheets, with what must be named.
"""

import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20.common import MAV_STATE_CRITICAL

from msp_range.params.keys import make
from msp_sim.device.device import Fault
from msp_sim.device.lidar_lite_v3 import TIMING as LASER_TIMING
from tests.support.doctor_runs import AT_ONCE, Found, doctor_command, examined, findings_in
from tests.support.fake_computer import FakeComputer
from tests.support.far_ends import (
    DeafAutopilot,
    MakeAutopilot,
    SigningAutopilot,
    StreamingAutopilot,
    by_tcp,
    by_udp,
    by_udp_towards_here,
    cable_at_other_baud,
    on_cable,
    silent_cable,
)
from tests.support.kernel_bus import Other, Sonar, kernel_bus
from tests.support.parameter_autopilot import RANGE_FINDER, ParameterAutopilot
from tests.support.service import LinkEnd, running_service
from tests.support.shipped import write_airframe
from tests.support.slow import slow_but

THERE = 1e9
"""Until the end of a test."""
BAUD = 921_600
"""Of the serial port, as the airframe file has it."""
PX4 = {
    "EKF2_RNG_CTRL": 2.0,
    "EKF2_HGT_REF": 1.0,
    "EKF2_MIN_RNG": 0.2,
    "EKF2_RNG_POS_Z": 0.05,
    "EKF2_RNG_DELAY": 30.0,
}
FOUR = tuple(Sonar(0x70 + number, [300, 301]) for number in range(4))


class Setup:
    """What its owner has: a good quad pallet, until a test changes it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.computer = FakeComputer(folder / "computer")
        self.devices: list[Sonar | Other] = [*FOUR, Other(0x44, "000000")]
        self.timeout_s = 0.0
        self.airframe = "quad_pallet"
        self.edits: list[tuple[str, str]] = []
        self.parameters: dict[str, float] | None = dict(RANGE_FINDER)
        self.autopilot: Callable[..., ParameterAutopilot] = ParameterAutopilot
        self.options: dict[str, Any] = {}
        self.baud = BAUD
        """The rate of the autopilot's serial port."""
        self.far_end: Callable[[MakeAutopilot], AbstractContextManager[str]] = on_cable

    def edit(self, old: str, new: str) -> None:
        """Change the airframe file."""
        self.edits.append((old, new))

    def examine(self) -> list[Found]:
        """What doctor finds."""
        path = write_airframe(self.folder, self.airframe, *self.edits)
        with self._link() as link, kernel_bus(self.devices, timeout_s=self.timeout_s) as testbed:
            return examined(testbed, self.computer, path, link)

    def _link(self) -> AbstractContextManager[str]:
        """What is at the other end of the link; its URL."""
        if self.baud != BAUD:
            return cable_at_other_baud(self.baud, BAUD)
        if self.parameters is None:
            return silent_cable()
        autopilot = partial(self.autopilot, values=self.parameters, **self.options)
        return self.far_end(autopilot)


Change = Callable[[Setup], None]
BROKEN: dict[str, tuple[Change, str, str, str]] = {}
"""Name -> what the owner did, and what must be reported of it: step, words of the text, words of the remedy."""
GOOD: dict[str, Change] = {}


def broken(step: str, text: str, remedy: str) -> Callable[[Change], Change]:
    """A set-up with an error, and what is to be found."""

    def add(change: Change) -> Change:
        BROKEN[change.__name__] = (change, step, text, remedy)
        return change

    return add


def good(change: Change) -> Change:
    """A set-up without an error."""
    GOOD[change.__name__] = change
    return change


@broken("I2C interface", "I2C is off", "dtparam=i2c_arm=on")
def fresh_raspberry_pi_os(setup: Setup) -> None:
    setup.computer.remove("/dev/i2c-1")
    setup.computer.remove("/sys/bus/i2c/devices/i2c-1")
    setup.computer.write("/boot/firmware/config.txt", "#dtparam=i2c_arm=on\nenable_uart=1\ndtparam=audio=on\n")


@broken("I2C interface", "although /boot/firmware/config.txt enables", "restart the computer")
def enabled_and_not_restarted(setup: Setup) -> None:
    setup.computer.remove("/dev/i2c-1")
    setup.computer.remove("/sys/bus/i2c/devices/i2c-1")


@broken("I2C interface", "i2c-dev is not loaded", "modprobe i2c-dev")
def plain_debian_without_the_module(setup: Setup) -> None:
    setup.computer.remove("/dev/i2c-1")


@broken("I2C permission", "pi may not use /dev/i2c-1", "usermod -aG i2c pi")
def user_not_in_the_group(setup: Setup) -> None:
    setup.computer.user, setup.computer.gids = "pi", [54321]


@broken("I2C permission", "since after this login", "log out and in again")
def added_to_the_group_and_not_logged_in_again(setup: Setup) -> None:
    setup.computer.gids = [54321]


@broken("I2C clock", "100 kHz", "i2c_arm_baudrate=50000")
def bus_at_its_usual_rate(setup: Setup) -> None:
    setup.computer.bus("brcm,bcm2835-i2c\0", None)
    setup.computer.write("/boot/firmware/config.txt", "dtparam=i2c_arm=on\nenable_uart=1\n")


@broken("addresses", "nothing answers on the bus", "SDA and SCL")
def data_and_clock_exchanged(setup: Setup) -> None:
    setup.devices = []


@broken("address of rear_left", "0x70 (0xE0 in the 8-bit form), the address from the factory", "address 0x70 0x73")
def one_sensor_as_it_was_delivered(setup: Setup) -> None:
    for number in reversed(range(4)):
        setup.edit(f"address: 0x{0x70 + number:02x}", f"address: 0x{0x71 + number:02x}")
    setup.devices = [Sonar(0x71), Sonar(0x72), Sonar(0x74), Sonar(0x70)]


@broken("airframe file", "0xE0 is the 8-bit form", "correct it")
def addresses_in_the_form_of_the_data_sheet(setup: Setup) -> None:
    for number in range(4):
        setup.edit(f"address: 0x{0x70 + number:02x}", f"address: 0x{0xE0 + 2 * number:02X}")


@broken("address of rear_left", "nothing answers at 0x72", "power and wires")
def plug_of_one_sensor_is_loose(setup: Setup) -> None:
    setup.devices = [Sonar(0x70), Sonar(0x71), Sonar(0x73)]


@broken("sensor front_left", "not an MB1242", "connect one at a time")
def humidity_sensor_at_a_sonars_address(setup: Setup) -> None:
    setup.devices = [Other(0x70, "beef92"), *FOUR[1:]]


@broken("readings of front_right", "not answered", "supply")
def supply_without_a_capacitor(setup: Setup) -> None:
    weak = Fault("silent", 0.0, THERE, probability=0.6)
    setup.devices = [FOUR[0], Sonar(0x71, [300], [weak]), *FOUR[2:]]


@broken("readings of rear_right", "clock is too fast", "i2c_arm_baudrate=50000")
def clock_stretching_not_waited_for(setup: Setup) -> None:
    setup.computer.write("/proc/device-tree/model", "Some other board")
    setup.computer.bus("vendor,i2c\0", None)
    setup.devices = [*FOUR[:3], Sonar(0x73, [300], [Fault("clock_fault", 0.0, THERE, probability=0.6)])]


@broken("crosstalk", "rear_left reads 3.00 m alone", "ping_interval_s")
def sensors_that_disturb_each_other(setup: Setup) -> None:
    setup.devices = [FOUR[0], FOUR[1], Sonar(0x72, [300], disturbed_cm=120), FOUR[3]]


@broken("addresses", "SDA or SCL is held low", "short")
def a_wire_pinched_to_ground(setup: Setup) -> None:
    setup.devices = [Sonar(0x70, [300], [Fault("locked_up", 0.0, THERE)]), *FOUR[1:]]


@broken("thermometer", "cpu_thermal", "outside air")
def thermometer_of_the_processor(setup: Setup) -> None:
    setup.edit("/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input", "/sys/class/hwmon/hwmon0/temp1_input")


@broken("thermometer", "no file fits", "driver is loaded")
def thermometer_without_its_driver(setup: Setup) -> None:
    setup.computer.remove("/sys/bus/i2c/devices/1-0044")


@broken("thermometer", "21450 C", "scale")
def thermometer_in_the_wrong_unit(setup: Setup) -> None:
    setup.edit("max_age_s: 10", "max_age_s: 10, scale: 1")


@broken("serial port", "the serial port is off", "enable_uart=1")
def serial_port_never_enabled(setup: Setup) -> None:
    setup.computer.write("/boot/firmware/config.txt", "dtparam=i2c_arm=on,i2c_arm_baudrate=50000\n")
    setup.computer.remove("/dev/serial0")
    setup.computer.remove("/dev/ttyAMA0")


@broken("serial port in use", "console is on /dev/serial0", "no login shell")
def login_shell_left_on_the_port(setup: Setup) -> None:
    setup.computer.write("/proc/cmdline", "console=serial0,115200 console=tty1 root=PARTUUID=0a\n")


@broken("serial port in use", "ModemManager", "disable --now ModemManager")
def modem_manager_takes_the_port(setup: Setup) -> None:
    setup.edit("/dev/serial0:921600", "/dev/ttyACM0:115200")
    setup.computer.device("/dev/ttyACM0")
    setup.computer.process(612, "/usr/sbin/ModemManager", "/dev/ttyACM0")


@broken("serial port", "there is /dev/serial/by-id/usb-ArduPilot_CubeOrange-if00", "by-id")
def usb_port_under_another_name(setup: Setup) -> None:
    setup.edit("/dev/serial0:921600", "/dev/ttyACM0:115200")
    setup.computer.device("/dev/ttyACM1")
    setup.computer.link("/dev/serial/by-id/usb-ArduPilot_CubeOrange-if00", "../../ttyACM1")


@broken("heartbeat", "nothing arrives", "exchange TX and RX")
def transmit_and_receive_not_crossed(setup: Setup) -> None:
    setup.parameters = None


@broken("heartbeat", "none are MAVLink", "same baud rate")
def baud_rates_differ(setup: Setup) -> None:
    setup.baud = 115_200


@broken("heartbeat", "is PX4, and link.autopilot is ardupilot", "link.autopilot")
def file_for_another_autopilot(setup: Setup) -> None:
    setup.parameters, setup.options = PX4, {"px4": True}


@broken("parameters", "RNGFND1_TYPE: 0 -> 10", "airframe.yaml --write")
def range_finder_not_set_up(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.parameters = RANGE_FINDER | {"RNGFND1_TYPE": 0.0}
    setup.options = {"uses_range_finder": False}


@broken(
    "parameters", "RNGFND1_ADDR: 112 -> 0: every id is taken; from 4.8 on another value takes only that id", "params"
)
def address_of_the_sensor_that_was_on_the_autopilot(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.parameters = RANGE_FINDER | {"RNGFND1_ADDR": 112.0}
    setup.options = {"version": (4, 8)}


@broken("parameters", "RNGFND1_ADDR: 112 -> 0", "params")
def the_same_with_an_autopilot_that_does_not_state_its_version(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.parameters = RANGE_FINDER | {"RNGFND1_ADDR": 112.0}
    setup.options = {"version": None}


@broken("distances", "reports no distance of its own", "restart the autopilot")
def autopilot_not_restarted(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.options = {"uses_range_finder": False}


@broken("distances", "the airframe file sends nothing. While RNGFND1_TYPE is 10", "set it to 0")
def autopilot_that_waits_for_distances_that_are_not_sent(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.edit("send:\n", "send:\n  nothing: true\n")


@broken("latency", "EKF2_RNG_DELAY is 200", "set it to")
def delay_in_the_wrong_unit(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.airframe = "loopback"
    setup.edit("autopilot: ardupilot", "autopilot: px4")
    setup.parameters, setup.options = PX4 | {"EKF2_RNG_DELAY": 200.0}, {"px4": True}


@broken("heartbeat", "not signed with the key", "PX4 1.17 has no MAVLink signing: take link.signing_key out")
def key_for_an_autopilot_that_cannot_sign(setup: Setup) -> None:
    make(setup.folder / "signing.key", None)
    setup.edit("autopilot: ardupilot", f"autopilot: px4\n  signing_key: {setup.folder / 'signing.key'}")
    setup.parameters, setup.options = PX4, {"px4": True}


@broken("disk", "0 MB left", "delete old recordings")
def card_full_of_recordings(setup: Setup) -> None:
    setup.computer.free_bytes = 300_000


@broken("disk", "read-only", "mount it for writing")
def disk_that_is_mounted_for_reading(setup: Setup) -> None:
    setup.computer.disk_is_read_only = True


@broken("disk", "may not write into", "chown")
def folder_of_another_user(setup: Setup) -> None:
    setup.computer.folder("/var/lib/msp-range", 0o755)


@broken("date", "before that of the airframe file", "clock module")
def no_clock_and_no_network(setup: Setup) -> None:
    setup.computer.utc_s = 1000.0
    setup.computer.remove("/run/systemd/timesync/synchronized")


@broken(
    "address of rear_left", "nothing answers at 0x72", "as it was delivered it is at 0x70, together with front_left"
)
def none_given_an_address_yet(setup: Setup) -> None:
    """https://discuss.px4.io/t/how-to-connect-multiple-maxbotix-sensors-on-px4/21913"""
    setup.devices = [FOUR[0]]


@broken("addresses", "data line SDA is held low", "short to ground")
def data_line_at_ground(setup: Setup) -> None:
    """Every address seems to answer, with zeros: https://raspberrypi.stackexchange.com/questions/113402"""
    setup.devices = [Other(address, "0000") for address in range(0x03, 0x78)]


@broken("address of rear_left", "the file does not name 0x39", "scan --ping")
def address_halved_by_a_sketch(setup: Setup) -> None:
    """An Arduino sketch wants the 8-bit form, and 0x72 was typed."""
    setup.devices = [FOUR[0], FOUR[1], Sonar(0x39), FOUR[3]]


@broken("sensor front_left", "PCA9685 (all call)", "connect one at a time")
def servo_driver_at_a_sonars_address(setup: Setup) -> None:
    """At 0x40, and with its all-call address at 0x70, where the sensor's plug is out."""
    setup.devices = [*FOUR[1:], Other(0x40, "1111"), Other(0x70, "1111")]


@broken("agreement", "front_right reads 0.24 m, and the other downward sensors 3.0", "in its beam")
def leg_in_the_beam(setup: Setup) -> None:
    """The front right sensor looks at a landing leg, whatever the others read."""
    setup.devices = [FOUR[0], Sonar(0x71, [24]), *FOUR[2:]]


@broken("I2C clock", "100 kHz", "restart the computer")
def slow_clock_and_not_restarted(setup: Setup) -> None:
    """It is in config.txt, and the kernel was started before."""
    setup.computer.bus("brcm,bcm2711-i2c\0brcm,bcm2835-i2c\0", 100_000)


@broken("serial port", "the port of Bluetooth; the pins have /dev/serial0, which is /dev/ttyS0", "disable-bt")
def the_good_port_is_bluetooths(setup: Setup) -> None:
    """A Pi 3: https://discuss.ardupilot.org/t/rpi3-to-pixhawk-baudrate-issue/25422"""
    setup.parameters = None
    setup.edit("/dev/serial0:921600", "/dev/ttyAMA0:921600")
    setup.computer.device("/dev/ttyS0")
    setup.computer.remove("/dev/serial0")
    setup.computer.link("/dev/serial0", "ttyS0")
    setup.computer.link("/dev/serial1", "ttyAMA0")
    # It runs as root: others do not see what it has open.
    setup.computer.write("/proc/612/cmdline", "/usr/bin/hciattach\0/dev/serial1\0bcm43xx\0003000000\0flow\0-\0")


@broken("replies", "answers nothing that is sent to it", "this computer's TX")
def wire_of_the_transmit_pin_is_loose(setup: Setup) -> None:
    """PX4 is received, and receives nothing."""
    setup.airframe = "canted_pallet"
    setup.computer.device("/dev/ttyUSB0")
    setup.computer.link("/dev/serial/by-id/usb-FTDI_FT232R_USB_UART_A50285BI-if00-port0", "../../ttyUSB0")
    setup.parameters, setup.autopilot, setup.options = PX4, DeafAutopilot, {"px4": True}


@broken("signing", "drops those of the bridge, which has no key", "msp-range sign")
def key_from_a_ground_station(setup: Setup) -> None:
    """The autopilot has it, and the airframe file names none."""
    setup.autopilot = SigningAutopilot


@broken("parameters", "RNGFND1_TYPE: 2 -> 10", "params")
def type_of_the_sensors_maker(setup: Setup) -> None:
    """https://discuss.ardupilot.org/t/maxbotix-i2c-range-sensor-parameters/12732"""
    setup.parameters, setup.options = RANGE_FINDER | {"RNGFND1_TYPE": 2.0}, {"uses_range_finder": False}


@broken("heartbeat", "of this computer, where nobody listens", "udpin:0.0.0.0:")
def both_send(setup: Setup) -> None:
    """mavlink-router sends to this computer's UDP port (Mode = Normal), and the file has udpout to the same port."""
    setup.airframe, setup.far_end = "loopback", by_udp_towards_here


@broken("thermometer", "says 85 C", "the sensor")
def thermometer_without_its_supply_wire(setup: Setup) -> None:
    """A DS18B20 reports what it has after power-on: https://raspberrypi.stackexchange.com/questions/65828"""
    setup.edit("/sys/bus/i2c/devices/1-0044/hwmon/hwmon*/temp1_input", "/sys/bus/w1/devices/28-*/temperature")
    setup.computer.write("/sys/bus/w1/devices/28-0316a2795af1/temperature", "85000\n")


@good
def one_forward_and_three_down(setup: Setup) -> None:
    """Through a router; temperature from the barometer."""
    setup.airframe, setup.far_end, setup.autopilot = "forward_and_down", by_udp, StreamingAutopilot
    setup.parameters = RANGE_FINDER | {"PRX1_TYPE": 2.0}


@good
def laser_on_a_jetson_behind_a_serial_server(setup: Setup) -> None:
    """At 400 kHz, without config.txt or serial0."""
    setup.computer.write("/proc/device-tree/model", "NVIDIA Jetson Nano Developer Kit\0")
    setup.computer.bus("nvidia,tegra210-i2c\0", 400_000)
    for name in ("/boot/firmware/config.txt", "/dev/serial0", "/dev/ttyAMA0"):
        setup.computer.remove(name)
    setup.computer.device("/dev/ttyTHS1")
    setup.airframe, setup.far_end = "lidar_down", by_tcp
    setup.edit("serial:/dev/serial0:921600", "tcp:127.0.0.1:5760")
    setup.devices = [Sonar(0x62, [118, 119, 120], kind="lidar_lite_v3", timing=LASER_TIMING)]
    setup.parameters = RANGE_FINDER | {"RNGFND1_MIN": 0.04, "RNGFND1_MAX": 39.9, "RNGFND1_GNDCLR": 0.05}


@good
def temperature_of_an_airspeed_sensor(setup: Setup) -> None:
    """PX4 by a USB adapter."""
    wire_of_the_transmit_pin_is_loose(setup)
    setup.autopilot = StreamingAutopilot


@good
def quad_pallet_on_a_raspberry_pi_4(setup: Setup) -> None:
    pass


@good
def quad_pallet_standing_on_the_ground(setup: Setup) -> None:
    setup.devices = [Sonar(0x70 + number, [20]) for number in range(4)]
    setup.far_end = by_udp


@good
def px4_by_network_on_a_raspberry_pi_5(setup: Setup) -> None:
    setup.computer.write("/proc/device-tree/model", "Raspberry Pi 5 Model B Rev 1.0\0")
    setup.computer.bus("snps,designware-i2c\0", 400_000)
    setup.airframe, setup.far_end = "loopback", by_udp
    setup.edit("autopilot: ardupilot", "autopilot: px4")
    setup.parameters, setup.options = PX4, {"px4": True}


@good
def laser_on_a_computer_that_reports_little(setup: Setup) -> None:
    setup.computer.write("/proc/device-tree/model", "")
    setup.computer.remove("/sys/bus/i2c/devices/i2c-1/of_node")
    setup.computer.remove("/run/systemd/timesync/synchronized")
    setup.airframe = "lidar_down"
    setup.edit("{filter: kalman, model: constant_velocity, acceleration_std_m_s2: 1.0}", "{filter: changepoint}")
    setup.devices = [Sonar(0x62, [1234], kind="lidar_lite_v3", timing=LASER_TIMING)]
    setup.parameters = RANGE_FINDER | {"RNGFND1_MIN": 0.04, "RNGFND1_MAX": 39.9, "RNGFND1_GNDCLR": 0.05}


@good
def address_of_the_sensor_that_was_on_an_autopilot_before_4_8(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.parameters = RANGE_FINDER | {"RNGFND1_ADDR": 112.0}


@good
def only_the_id_of_the_fused_stream_is_taken(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.parameters = RANGE_FINDER | {"RNGFND1_ADDR": 10.0}
    setup.options = {"version": (4, 8)}


@good
def armed_vehicle_on_a_bit_banged_bus(setup: Setup) -> None:
    setup.computer.bus("i2c-gpio\0", None)
    setup.computer.write("/boot/firmware/config.txt", "dtoverlay=i2c-gpio,bus=1\nenable_uart=1\n")
    setup.options = {"armed": True}


class SigningByUsb(ParameterAutopilot):
    """ArduPilot with a key, on USB: it signs, and takes what is not signed."""

    def __init__(self, url: str, values: dict[str, float]) -> None:
        super().__init__(url, values)
        self._connection.setup_signing(bytes(32), allow_unsigned_callback=lambda *_: True)


@good
def autopilot_that_signs_by_usb(setup: Setup) -> None:
    setup.autopilot = SigningByUsb


@good
def first_flights_without_relying_on_it(setup: Setup) -> None:
    setup.far_end = by_udp
    setup.edit("send:\n", "send:\n  nothing: true\n")
    setup.parameters = {"RNGFND1_TYPE": 0.0}


@good
def hall_without_an_echo(setup: Setup) -> None:
    setup.devices = [Sonar(0x70 + number, [765]) for number in range(4)]


def first_of_each_part() -> set[str]:
    """Names of errors, one for each part of the set-up: the first word of a step."""
    return {*{step.split()[0]: name for name, (_, step, _, _) in reversed(BROKEN.items())}.values()}


@pytest.fixture(scope="module")
def results(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> Iterator[dict[str, "Future[list[Found]]"]]:
    """All set-ups of the tests that run, several at a time."""

    def examine(change: Change, folder: Path) -> list[Found]:
        setup = Setup(folder)
        change(setup)
        return setup.examine()

    wanted = {item.callspec.params.get("name") for item in request.session.items if hasattr(item, "callspec")}
    changes = {name: each[0] for name, each in BROKEN.items()} | GOOD
    changes = {name: change for name, change in changes.items() if name in wanted}
    with ThreadPoolExecutor(AT_ONCE) as pool:
        yield {name: pool.submit(examine, change, tmp_path_factory.mktemp(name)) for name, change in changes.items()}


def wrong(findings: Sequence[Found]) -> list[Found]:
    """Those that are wrong."""
    return [each for each in findings if each.verdict == "wrong"]


@pytest.mark.parametrize("name", slow_but(sorted(first_of_each_part())[::3], BROKEN))
def test_a_set_up_error_is_named_and_nothing_else(name: str, results: dict[str, "Future[list[Found]]"]) -> None:
    _, step, text, remedy = BROKEN[name]
    findings = results[name].result()
    verdict = "unknown" if step == "agreement" else "wrong"
    found = [each for each in findings if (each.step, each.verdict) == (step, verdict)]
    named = [each for each in found if text in each.text and remedy in each.remedy]
    assert len(named) == 1, findings
    # A parameter that is not set keeps distances from coming back, too; and who may not use one device may use none.
    allowed = {"range_finder_not_set_up": {"distances"}, "user_not_in_the_group": {"serial permission", "disk"}}
    allowed["added_to_the_group_and_not_logged_in_again"] = {"serial permission", "disk"}
    allowed["address_of_the_sensor_that_was_on_the_autopilot"] = allowed["type_of_the_sensors_maker"] = {"distances"}
    allowed["none_given_an_address_yet"] = {"address of front_right", "address of rear_right"}
    others = {each.step for each in wrong(findings)} - {step}
    assert others <= allowed.get(name, set()), findings


@pytest.mark.parametrize(
    "name", slow_but({"quad_pallet_on_a_raspberry_pi_4", "px4_by_network_on_a_raspberry_pi_5"}, GOOD)
)
def test_no_false_alarm(name: str, results: dict[str, "Future[list[Found]]"]) -> None:
    findings = results[name].result()
    assert wrong(findings) == []
    assert len(findings) >= 10


def test_a_running_bridge_is_left_alone(tmp_path: Path) -> None:
    setup = Setup(tmp_path)
    path = write_airframe(tmp_path, "quad_pallet")
    computer = setup.computer
    with kernel_bus(FOUR) as testbed, LinkEnd() as end, running_service(testbed, end.url, tmp_path) as service:
        end.run_until(lambda: any(each.system_status == MAV_STATE_CRITICAL for each in end.of("HEARTBEAT")))
        end.run_until(lambda: any("all 4 sensors good" in each.text for each in end.of("STATUSTEXT")))
        program = testbed.popen(doctor_command(computer, path, ""), stdout=-1, text=True)
        output: list[str] = []
        reader = threading.Thread(target=lambda: output.append(program.communicate()[0]))
        reader.start()
        end.run_until(lambda: not reader.is_alive())
        findings = {each.step: each for each in findings_in(output[0])}
        assert service.stop() == 0
        polled = [each for each in testbed.journal() if each.verb == "read" and len(each.data) == 1]
    in_use = findings["I2C bus in use"]
    assert in_use.verdict == "unknown"
    assert f"in use by process {service.process.pid} (" in in_use.text
    assert "systemctl stop msp-range" in in_use.remedy
    assert {"addresses", "crosstalk", "serial port", "heartbeat"} & findings.keys() == set()
    assert {"thermometer", "disk", "date"} <= findings.keys()
    # The rest comes from the bridge itself: all sensors read, and nobody is at the other end of the link.
    assert findings["running bridge"].verdict == "right"
    assert {name: findings[f"sensor {name}"].verdict for name in ("forward", "down_left")} == {
        "forward": "right",
        "down_left": "right",
    }
    # 300 and 301 cm, corrected for 20 C.
    assert findings["sensor down_left"].text.startswith(("2.99 m now", "3.00 m now"))
    assert findings["autopilot"].verdict == "wrong"
    assert "nobody gets the distances" in findings["autopilot"].text
    assert polled == []  # a scan reads one byte of each address
