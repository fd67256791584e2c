"""Rate of the fused stream of four sequential sensors: at the safe spacing, and with faster pings near the ground."""

from evaluation.benchmarks.bench_bridge import AIRFRAME
from evaluation.benchmarks.figure import Figures, at_least, figure
from msp_range.bridge import Bridge
from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.replay import Nowhere
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.mb1242 import EmulatedMB1242

FLOWN_S = 60.0
LOOPBACK = AIRFRAME.with_name("loopback.yaml")


def run() -> Figures:
    """Both rates, on a virtual clock."""
    safe_hz = _rate_hz(str(AIRFRAME), 500)
    near_hz = _rate_hz(str(LOOPBACK), 195)
    return [
        figure("fused_rate_safe", safe_hz, "Hz at 5 m, pings 100 ms apart", at_least(9.9)),
        figure("fused_rate_near", near_hz, "Hz at 1.95 m, near spacing"),
        figure("near_over_safe", near_hz / safe_hz, "times", at_least(1.5)),
    ]


def _rate_hz(airframe: str, reading_cm: int) -> float:
    clock = VirtualClock()
    devices = [EmulatedMB1242(address, clock.now, lambda _: reading_cm) for address in range(0x70, 0x74)]
    bridge = Bridge(load_airframe(airframe), EmulatedBus(devices, clock.now), clock, Nowhere())
    while clock.now() < FLOWN_S:
        bridge.step()
    return bridge.link.sent["DISTANCE_SENSOR"] / FLOWN_S
