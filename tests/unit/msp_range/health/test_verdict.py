"""The one verdict on a running bridge, and that all who show its state show this one."""

import errno
from importlib.resources import files
from typing import Any

import orjson
import pytest
from prometheus_client import CollectorRegistry, generate_latest
from prometheus_client.parser import text_string_to_metric_families
from pymavlink.dialects.v20 import common

from msp_range.bus import BusError
from msp_range.config import Airframe
from msp_range.doctor.examination import findings
from msp_range.health import BridgeState, BridgeVerdict
from msp_range.recording.topics import Message
from msp_range.terminal import PlainConsole
from msp_range.watch import view
from msp_range.watch.facts import Fact
from msp_range.watch.newest import GONE, Newest
from msp_range.watch.terminal import shown
from msp_range.watch.view import airframe_message, status_message
from msp_range.web.metrics import BridgeMetrics
from msp_sim.device.device import Fault
from tests.support.bench import Bench, airframe
from tests.support.known import known

NOBODY = "Range: no autopilot, nobody gets the distances"
NAMES = "abcd"
SHOWN = ("name", "text", "in_list")
"""What the page shows of a field."""
NUMBERS_JS = (files("msp_range.web") / "static" / "numbers.js").read_text()


def causes(bench: Bench) -> list[tuple[str, str | None]]:
    return [(each.what, each.cause) for each in bench.bridge.verdict.findings]


def heartbeat_state(bench: Bench) -> int:
    state: int = bench.sent("HEARTBEAT")[-1].message.system_status
    return state


def watched(bench: Bench, vehicle: Airframe | None = None) -> Newest:
    """What a watcher has of the bench's bridge now."""
    newest = Newest()
    status = status_message(bench.bridge, bench.wire, None, bench.clock.now())
    for topic, message in (("/airframe", airframe_message(vehicle or airframe())), ("/status", status)):
        newest.update(Message(topic, bench.clock.now(), message))
    return newest


def terminal(newest: Newest) -> list[str]:
    console = PlainConsole(width=80)
    with console.capture() as out:
        console.print(shown(newest))
    return out.get().splitlines()


def metrics(newest: Newest) -> dict[str, list[Any]]:
    registry = CollectorRegistry()
    registry.register(BridgeMetrics(newest))
    families = text_string_to_metric_families(generate_latest(registry).decode())
    return {each.name: each.samples for each in families}


def without_a_bus(monkeypatch: pytest.MonkeyPatch) -> Bench:
    """A bus that breaks while an autopilot listens."""
    bench = Bench(airframe(), 300).fly(5.0, with_autopilot=True)

    def gone(address: int, data: object) -> None:
        raise BusError(errno.ETIMEDOUT, "write", address)

    monkeypatch.setattr(bench.bus, "write", gone)
    monkeypatch.setattr(bench.bus, "read", gone)
    return bench.fly(9.0, with_autopilot=True)


def test_distances_that_nobody_gets_are_not_all_well() -> None:
    bench = Bench(airframe(), 300).fly(4.0)
    assert (bench.bridge.verdict.state, heartbeat_state(bench)) == (BridgeState.STARTING, common.MAV_STATE_BOOT)
    bench.fly(7.0)
    assert bench.distances_cm(from_s=6.0)
    assert bench.bridge.verdict.state is BridgeState.CRITICAL
    assert [each.text for each in bench.bridge.verdict.findings] == [NOBODY]
    assert heartbeat_state(bench) == common.MAV_STATE_CRITICAL
    assert NOBODY not in bench.texts(), "nobody would read it"
    bench.fly(9.0, with_autopilot=True)
    assert bench.bridge.verdict == BridgeVerdict(BridgeState.ACTIVE)
    assert heartbeat_state(bench) == common.MAV_STATE_ACTIVE
    # It is lost again in flight.
    bench.fly(15.0)
    assert bench.bridge.verdict.state is BridgeState.CRITICAL


def test_a_link_that_is_down_says_why() -> None:
    bench = Bench(airframe(), 300)
    bench.wire.connected, bench.wire.last_error = False, "wire: No such file or directory"
    (finding,) = bench.fly(7.0).bridge.verdict.findings
    assert finding.remedy.startswith("wire: No such file or directory; check ")


def test_who_is_there_in_place_of_the_autopilot_is_the_cause_that_it_is_not() -> None:
    bench = Bench(airframe(link={"url": "udpout:127.0.0.1:14550", "system_id": 7}), 300)
    bench.receive(system=9)
    bench.fly(7.0, with_autopilot=True)
    assert causes(bench) == [("other autopilot", None), ("autopilot", "other autopilot")]
    assert bench.bridge.verdict.state is BridgeState.CRITICAL


def test_a_dead_bus_comes_first_and_what_follows_from_it_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = without_a_bus(monkeypatch)
    follows = [*(f"sensor {name}" for name in NAMES), "silence the fused stream"]
    assert causes(bench) == [("bus", None), *((each, "bus") for each in follows)]
    # An autopilot that comes reads them in this order.
    bench.fly(16.0)
    before = len(bench.texts())
    bench.fly(18.0, with_autopilot=True)
    assert bench.texts()[before:] == [each.text for each in bench.bridge.verdict.findings]


def test_a_warning_comes_behind_what_stops_distances() -> None:
    vehicle = airframe(temperature={"fixed_c": 20.0})
    bench = Bench(vehicle, 300, absent="c").fly(5.0, with_autopilot=True)
    assert causes(bench) == [("sensor c", None), ("no thermometer", None)]
    without = Bench(vehicle, 300).fly(5.0, with_autopilot=True)
    assert (without.bridge.verdict.state, causes(without)) == (BridgeState.ACTIVE, [("no thermometer", None)])


def test_a_distance_is_not_back_because_its_sensor_fails_altogether() -> None:
    """First it has no usable distance, then no answer, and then both again."""
    faults = {"a": [Fault("saturated", 5.0, 10.0), Fault("silent", 10.0, 15.0)]}
    vehicle = airframe(send={"sensors": ["a"]}, filters=[], sensor_watch=False)
    bench = Bench(vehicle, 500, faults=faults).fly(14.0, with_autopilot=True)
    of_a = [text for text in bench.reported(4.0) if text.startswith("Range a:")]
    assert of_a == ["Range a: no distance", "Range a: no answer (errno 121)"]
    assert causes(bench)[:2] == [("sensor a", None), ("silence a", "sensor a")]
    bench.fly(20.0, with_autopilot=True)
    assert {"Range a: distance is back", "Range a: good again"} <= set(bench.reported(14.0))
    assert bench.bridge.verdict == BridgeVerdict(BridgeState.ACTIVE)


@pytest.mark.parametrize("dead_bus", [False, True])
def test_all_who_show_the_state_show_this_one(dead_bus: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = without_a_bus(monkeypatch) if dead_bus else Bench(airframe(), 300).fly(7.0)
    newest, first = watched(bench), bench.bridge.verdict.findings[0]
    assert newest.state == bench.bridge.verdict.state == "critical"
    lines = terminal(newest)
    assert lines[0].rstrip() == "bench: critical"
    assert lines[1].rstrip() == f"error: {first.text}"
    assert any(", nobody gets them, 0 frames dropped" in line for line in lines) != dead_bus
    found = metrics(newest)
    assert found["msp_range_critical"][0].value == 1.0
    assert [each.labels["what"] for each in found["msp_range_fault"] if not each.labels["cause"]] == [first.what]
    assert found["msp_range_faults"][0].value == len(bench.bridge.verdict.findings)
    wrong = [each for each in findings(newest) if each.verdict == "wrong"]
    assert (wrong[0].step, wrong[0].text, wrong[0].remedy) == (first.what, first.text, first.remedy)
    assert len(wrong) == len(bench.bridge.verdict.findings)


def test_a_field_that_is_named_once_is_shown_by_terminal_page_and_metrics(monkeypatch: pytest.MonkeyPatch) -> None:
    added = Fact("processor", " 51.0 C", {"msp_range_processor_c": ("Temperature of the processor.", 51.0)})
    before = view.status_facts
    monkeypatch.setattr(view, "status_facts", lambda *state: [*before(*state), added])
    newest = watched(Bench(airframe(), 300).fly(5.0, with_autopilot=True))
    newest.status = orjson.loads(orjson.dumps(newest.status))  # as it goes through the socket
    assert "processor 51.0 C" in [line.rstrip() for line in terminal(newest)]
    assert metrics(newest)["msp_range_processor_c"][0].value == 51.0
    assert ("processor", " 51.0 C", True) in [tuple(each[key] for key in SHOWN) for each in newest.status["facts"]]
    assert all(key in NUMBERS_JS for key in SHOWN)


@pytest.mark.parametrize("absent", ["", "c"])
def test_a_bridge_that_sends_nothing_says_so_and_is_neither_active_nor_critical_for_it(absent: str) -> None:
    vehicle = airframe(send="nothing")
    bench = Bench(vehicle, 300, absent=absent).fly(0.3, with_autopilot=True)
    assert bench.bridge.verdict.state is BridgeState.STARTING
    bench.fly(7.0, with_autopilot=True)
    text = "Range: no distances are sent (send: nothing)"
    assert (bench.texts()[0], len(text)) == (text, 44)
    state = BridgeState.CRITICAL if absent else BridgeState.SENDS_NOTHING
    assert bench.bridge.verdict.state is state
    assert causes(bench) == [*(("sensor c", None) for _ in absent), ("not sent", None)]
    assert heartbeat_state(bench) == (common.MAV_STATE_CRITICAL if absent else common.MAV_STATE_STANDBY)
    newest = watched(bench, vehicle)
    lines = [line.rstrip() for line in terminal(newest)]
    assert lines[0] == f"bench: {state.value}"
    assert f"info: {text}" in lines
    assert "sent no distances, 0 frames dropped" in lines
    assert metrics(newest)["msp_range_critical"][0].value == float(bool(absent))
    assert [each.verdict for each in findings(newest) if each.step == "not sent"] == ["unknown"]
    newest.update(Message("/fused", bench.clock.now(), known(bench.steps[-1].fused).record(0.0)))
    assert any(line.startswith("distance down 3.00 m (not sent), deviation") for line in terminal(newest))


def test_a_bridge_that_has_ended_is_no_good_one_in_the_metrics() -> None:
    newest = watched(Bench(airframe(), 300).fly(5.0, with_autopilot=True))
    assert metrics(newest)["msp_range_critical"][0].value == 0.0
    newest.update(Message(GONE, 0.0, {}))
    assert {name: each[0].value for name, each in metrics(newest).items()} == {"msp_range_critical": 1.0}
