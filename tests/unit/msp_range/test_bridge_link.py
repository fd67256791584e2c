"""What the bridge makes of an autopilot: whose time, which one, and what the pilot reads of it."""

from pathlib import Path
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from msp_range.config import load_airframe
from msp_range.health.reminder import AGAIN_S
from msp_range.yaml_file import ConfigError
from tests.support.bench import Bench, airframe
from tests.support.shipped import CONFIGS

HEARTBEAT = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_ARDUPILOTMEGA, 0, 0, 4, 3)
PX4_HEARTBEAT = common.MAVLink_heartbeat_message(2, common.MAV_AUTOPILOT_PX4, 0, 0, 4, 3)
URL = "udpout:127.0.0.1:14550"


class Keeper:
    """A recorder that keeps one topic."""

    fault = None

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.kept: list[tuple[float, dict[str, Any]]] = []

    def write(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        if topic == self.topic:
            self.kept.append((time_s, message))

    def flush_if_due(self, now_s: float) -> None:
        """Nothing to do."""


def attitude(boot_s: float) -> Any:
    return common.MAVLink_attitude_message(round(boot_s * 1e3), 0.1, 0.0, 0.0, 0, 0, 0)


BOOTED_S = 1000.0
"""What the autopilot's clock shows at the bench's start."""


@pytest.mark.parametrize(("synchronised", "of_what_s"), [(True, 0.060), (False, 0.0)])
def test_an_attitude_is_of_the_time_that_the_autopilot_states_and_is_kept_at_its_arrival(
    synchronised: bool, of_what_s: float
) -> None:
    """A radio link delivers it 60 ms late; at 90 deg/s that is five degrees."""
    keeper = Keeper("/attitude")
    bench = Bench(airframe(), 300, recorder=keeper)
    for i in range(1, 101):
        bench.receive(HEARTBEAT)
        if synchronised:
            bench.receive(common.MAVLink_system_time_message(0, round((BOOTED_S + bench.now()) * 1e3)))
        bench.receive(attitude(BOOTED_S + bench.now() - 0.060))
        bench.fly(0.1 * i)
    errors_s = [arrived_s - of_what_s - message["time_s"] for arrived_s, message in keeper.kept[20:]]
    # SYSTEM_TIME waits for the next look at the link, every 5 ms; both times have whole milliseconds.
    assert errors_s == pytest.approx([0.0] * len(errors_s), abs=0.007)
    assert len(errors_s) > 70


def test_an_attitude_with_a_time_that_cannot_be_is_of_its_arrival() -> None:
    keeper = Keeper("/attitude")
    bench = Bench(airframe(), 300, recorder=keeper)
    for i in range(1, 51):
        bench.receive(HEARTBEAT, common.MAVLink_system_time_message(0, round((BOOTED_S + bench.now()) * 1e3)))
        bench.receive(attitude(7.0))
        bench.fly(0.1 * i)
    assert len(keeper.kept) > 40
    assert all(message["time_s"] == arrived_s for arrived_s, message in keeper.kept)


def test_an_attitude_that_streams_too_slowly_is_asked_for() -> None:
    bench = Bench(airframe(), 300)
    for i in range(1, 41):
        bench.receive(HEARTBEAT, attitude(0.25 * i))
        bench.fly(0.25 * i)
    asked = [each.param1 for _, each in bench.sent("COMMAND_LONG")]
    assert common.MAVLINK_MSG_ID_ATTITUDE in asked


def test_a_clock_that_jumps_does_not_flood_the_pilot() -> None:
    """Each jump back looks like an autopilot that has started again and has to be sent all that is wrong."""
    bench = Bench(airframe(), 300, absent="c")
    for i in range(1, 301):
        bench.receive(HEARTBEAT, common.MAVLink_system_time_message(0, 1_000_000 if i % 2 else 2_000_000))
        bench.fly(0.2 * i)
    assert bench.bridge.link.autopilot_clock.reboots > 100
    texts = bench.texts().count("Range c: no answer (errno 121)")
    assert 2 <= texts <= 2 + 60 / AGAIN_S


def test_a_text_for_an_autopilot_that_started_again_is_late_but_not_lost() -> None:
    bench = Bench(airframe(), 300, absent="c")
    for i in range(1, 31):
        # It starts again two seconds after it was first received.
        boot_ms = 60_000 + 1000 * i if i < 3 else 1000 * i
        bench.receive(HEARTBEAT, common.MAVLink_system_time_message(0, boot_ms))
        bench.fly(1.0 * i)
    times_s = [time_s for time_s, each in bench.sent("STATUSTEXT") if each.text == "Range c: no answer (errno 121)"]
    assert len(times_s) == 2
    assert times_s[1] <= 3.0 + AGAIN_S + 0.5


class Autopilots:
    """Heartbeats of several autopilots at once, each second."""

    def __init__(self, bench: Bench, *senders: tuple[int, int, Any]) -> None:
        self.bench = bench
        self._senders = [
            (common.MAVLink(None, srcSystem=system, srcComponent=component), message)
            for system, component, message in senders
        ]

    def fly(self, duration_s: float) -> None:
        for _ in range(round(duration_s)):
            for mav, message in self._senders:
                self.bench.wire.arriving += message.pack(mav)
                mav.seq = (mav.seq + 1) % 256
            self.bench.fly(round(self.bench.now()) + 1.0)


def about_others(bench: Bench) -> list[str]:
    """Reports, but for the one that all sensors are good."""
    return [text for text in bench.reported() if "good" not in text]


OWN_HEARTBEAT = common.MAVLink_heartbeat_message(18, common.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)


@pytest.mark.parametrize(
    ("link", "other", "text", "over"),
    [
        (
            {},
            (9, 1, HEARTBEAT),
            "Range: second autopilot, system 9 (using 7)",
            "Range: the other autopilot is gone",
        ),
        (
            {"system_id": 7},
            (9, 1, HEARTBEAT),
            "Range: second autopilot, system 9 (using 7)",
            "Range: the other autopilot is gone",
        ),
        (
            {},
            (7, 1, PX4_HEARTBEAT),
            "Range: autopilot is px4, file says ardupilot",
            "Range: the autopilot is ardupilot now",
        ),
        (
            {},
            (7, 191, OWN_HEARTBEAT),
            "Range: another program sends as 7/191",
            "Range: no other program uses this bridge's id now",
        ),
    ],
)
def test_who_should_not_be_on_the_link_is_reported_once_and_when_it_is_over(
    link: dict[str, Any], other: tuple[int, int, Any], text: str, over: str
) -> None:
    bench = Bench(airframe(link={"url": URL, **link}), 300)
    Autopilots(bench, (7, 1, HEARTBEAT)).fly(5)
    assert about_others(bench) == []
    Autopilots(bench, (7, 1, HEARTBEAT), other).fly(20)
    assert about_others(bench) == [text]
    Autopilots(bench, (7, 1, HEARTBEAT)).fly(15)
    assert about_others(bench) == [text, over]
    assert bench.texts()[-2:] == [text, over]
    assert len(text) <= 50
    assert len(over) <= 50


def test_another_autopilot_than_the_files_is_reported_and_not_used() -> None:
    bench = Bench(airframe(link={"url": URL, "system_id": 7}), 300)
    Autopilots(bench, (9, 1, HEARTBEAT)).fly(10)
    assert about_others(bench) == ["Range: autopilot is system 9, file says 7"]
    assert {message.get_srcSystem() for _, message in bench.sent()} == {7}
    assert bench.sent("COMMAND_LONG") == []


@pytest.mark.parametrize("system_id", [0, 256, -1])
def test_a_system_id_is_one_of_mavlinks(system_id: int, tmp_path: Path) -> None:
    text = (CONFIGS / "loopback.yaml").read_text(encoding="utf-8")
    text = text.replace("sensors/mb1242.yaml", str(CONFIGS / "sensors" / "mb1242.yaml"))
    path = tmp_path / "airframe.yaml"
    path.write_text(text.replace("\nlink:\n", f"\nlink:\n  system_id: {system_id}\n"), encoding="utf-8")
    with pytest.raises(ConfigError, match=r"link\.system_id"):
        load_airframe(path)


@pytest.mark.parametrize(
    ("connected", "error", "why"),
    [
        (True, None, "wire: no heartbeat comes in;"),
        (False, None, "wire: nobody has connected;"),
        (False, "wire: there is no such port", "wire: there is no such port;"),
    ],
)
def test_the_link_is_named_once_where_no_autopilot_is_received(connected: bool, error: str | None, why: str) -> None:
    bench = Bench(airframe(), 300)
    bench.wire.connected, bench.wire.last_error = connected, error
    bench.fly(7.0)
    (finding,) = (each for each in bench.bridge.verdict.findings if each.what == "autopilot")
    assert finding.remedy == f"{why} check wires, port, baud rate and the autopilot's settings of it"
