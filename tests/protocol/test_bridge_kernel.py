"""The bridge and its commands on the kernel's I2C interface, through the real smbus2, in a program of their own."""

import sys
import textwrap
from itertools import pairwise
from pathlib import Path

from msp_sim.device.device import DeviceTiming
from tests.support.kernel_bus import KernelTestbed, Sonar, kernel_bus
from tests.support.shipped import CONFIGS

BRIDGE = """
from msp_range.bridge import Bridge
from msp_range.bus.smbus import KernelBus
from msp_range.clock import SystemClock
from msp_range.config import load_airframe
from tests.support.bench import Wire

clock = SystemClock()
bridge = Bridge(load_airframe({airframe!r}), KernelBus(1), clock, Wire(clock))
end_s = clock.now() + 1.3
while clock.now() < end_s:
    for step in bridge.step():
        print(step.ranging.reading.status.value, step.ranging.reading.raw)
"""
LIDAR = 0x62
LIDAR_TIMING = DeviceTiming(ready_s=0.02, s_per_cm=0.0, no_echo_s=0.02)


def polled(testbed: KernelTestbed, airframe: str) -> list[str]:
    """Status and answer of every ranging of the bridge in 1.3 s."""
    done = testbed.run([sys.executable, "-c", textwrap.dedent(BRIDGE).format(airframe=str(CONFIGS / airframe))])
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def test_no_register_is_read_and_every_answer_is_new() -> None:
    """One range command a ranging, and reads of two bytes that write nothing before."""
    readings = [[210, 220, 230, 240], [310, 320, 330], [410, 420, 430], [510, 520, 530]]
    with kernel_bus([Sonar(0x70 + i, readings_cm) for i, readings_cm in enumerate(readings)]) as testbed:
        seen = polled(testbed, "loopback.yaml")
        journal = testbed.journal()
    assert len(seen) >= 8
    assert seen == [f"ok {readings[i % 4][i // 4]}" for i in range(len(seen))]
    assert {(each.verb, each.data) for each in journal if each.verb == "write"} == {("write", b"\x51")}
    assert {len(each.data) for each in journal if each.verb == "read" and each.errno == 0} == {2}
    assert len(seen) <= sum(each.verb == "write" for each in journal) <= len(seen) + 1


def test_the_bridge_polls_a_lidar() -> None:
    with kernel_bus([Sonar(LIDAR, [258, 4000, 3999], timing=LIDAR_TIMING, kind="lidar_lite_v3")]) as testbed:
        seen = polled(testbed, "lidar_down.yaml")
        journal = testbed.journal()
    assert len(seen) >= 6
    assert seen[:6] == ["ok 258", "no_echo 4000", "ok 3999"] * 2
    # Two plain transfers for a register: its number, a stop, and then the read.
    verbs = [(each.verb, each.data) for each in journal if each.errno == 0]
    assert {data for verb, data in verbs if verb == "write"} == {b"\x00\x04", b"\x01", b"\x8f"}
    assert all(before[0] == "write" for before, after in pairwise(verbs) if after[0] == "read")


def test_the_command_moves_a_lidar() -> None:
    with kernel_bus([Sonar(LIDAR, [258], timing=LIDAR_TIMING, kind="lidar_lite_v3")]) as testbed:
        command: list[str | Path] = [Path(sys.executable).with_name("msp-range"), "address", "0x62", "0x64", "--yes"]
        done = testbed.run(command)
        assert done.returncode == 0, done.stderr
        assert "0x64: LIDAR-Lite v3: 258 cm" in done.stdout
        assert "until its power is switched off" in done.stdout
        writes = [each.data.hex() for each in testbed.journal() if each.verb == "write" and len(each.data) == 2]
    assert writes[1:-1] == ["1830", "1980", "1a64", "1e08"]
