"""MAVSDK receives what the bridge sends, every field of it, and asks the bridge who it is."""

import json
import socket
import subprocess
import sys
from pathlib import Path
from typing import Any

from msp_range import __version__
from tests.support.kernel_bus import kernel_bus
from tests.support.service import PEERS, VARIED, Autopilot, LinkEnd, running_service
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S


def test_mavsdk_shows_every_field(tmp_path: Path) -> None:
    shown_file = tmp_path / "mavsdk.jsonl"

    def shown() -> list[dict[str, Any]]:
        # The last line may be half written.
        return [json.loads(line) for line in shown_file.read_text().splitlines(True) if line.endswith("\n")]

    def of(name: str) -> list[dict[str, Any]]:
        return [each for each in shown() if each.get("name") == name and each["source"] == [1, 191]]

    port = free_port(socket.SOCK_DGRAM)
    with (
        kernel_bus(VARIED) as testbed,
        LinkEnd(autopilot=Autopilot(), passes_on_to=port) as end,
        shown_file.open("w") as output,
        subprocess.Popen(
            [sys.executable, PEERS / "mavsdk_receiver.py", str(port)], stdin=subprocess.PIPE, stdout=output, text=True
        ) as mavsdk,
    ):
        assert mavsdk.stdin is not None
        try:
            end.run_until(lambda: {"autopilot": 1} in shown())
            with running_service(testbed, end.url, tmp_path) as service:
                end.run_until(lambda: len(end.distances) >= 16)
                mavsdk.stdin.write("191 396\n191 30\n")
                mavsdk.stdin.flush()
                end.run_until(lambda: len([each for each in shown() if "acknowledgement" in each]) == 2)
                assert service.stop() == 0
            end.run_until(lambda: len(end.arrived) >= service.log()[-1]["frames"]["sent"])
            end.run_until(lambda: len(of("DISTANCE_SENSOR")) >= len(end.distances))
            mavsdk.stdin.close()
            assert mavsdk.wait(LIMIT_S) == 0
        finally:
            mavsdk.kill()

    distances = [without_name(each["fields"]) for each in of("DISTANCE_SENSOR")]
    assert distances == end.distances
    assert {each["orientation"] for each in distances} == {0, 25, 100}
    assert len({json.dumps(each) for each in distances}) == len(distances)

    assert {each["fields"]["type"] for each in of("HEARTBEAT")} == {18}
    # The first at the start, and again when the autopilot has come.
    texts = ["Range: no thermometer, 33 cm off at -4 C, 7.65 m", "Range: all 4 sensors good"]
    shown_texts = {each["fields"]["text"] for each in of("STATUSTEXT")}
    assert shown_texts == {each.text for each in end.of("STATUSTEXT")} >= set(texts)

    who, denied = (each["acknowledgement"]["fields"] for each in shown() if "acknowledgement" in each)
    assert (who["command"], who["result"]) == (512, 0)
    assert (denied["command"], denied["result"]) == (512, 2)
    (basic,) = of("COMPONENT_INFORMATION_BASIC")
    assert basic["fields"]["vendor_name"] == "msp-range"
    assert basic["fields"]["model_name"] == "range finder bridge"
    assert basic["fields"]["software_version"] == __version__
    assert basic["fields"]["serial_number"] == basic["fields"]["hardware_version"] == ""


def without_name(fields: dict[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in fields.items() if not name.startswith("message_")}
