"""Cost of a reading in the bridge, and the time from the end of a ranging to its message on the link.

CPU is that of the bridge's own thread, of the steps that end a reading: the last transfer, decoding, correction,
Kalman filter, fusion, packing, the UDP send and the recording. Rounds of it alternate with rounds of the two floors, so
that a machine that changes its speed changes all three; a round's figure is the median of its readings. The floor with
records writes them by the mcap package's own writer, as the bridge did when its goal was set.
"""

import itertools
import socket
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from filterpy.kalman import KalmanFilter
from mcap.writer import Writer

from evaluation import CONFIGS
from evaluation.benchmarks.figure import Figures, at_most, figure
from msp_range.bridge import Bridge
from msp_range.clock import SystemClock, VirtualClock
from msp_range.config import load_airframe
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import Transport, Wrapped, open_transport
from msp_range.recording.writer import Recorder
from msp_sim.device.bus import EmulatedBus
from msp_sim.device.device import DeviceTiming
from msp_sim.device.mb1242 import NO_ECHO_CM, TIMING, EmulatedMB1242

AIRFRAME = CONFIGS / "quad_pallet.yaml"
ROUNDS = 15
READINGS = 400
LATENCY_S = 30.0

Record = tuple[str, dict[str, Any]]


def run() -> Figures:
    """All figures of this file."""
    return cost() + latency()


def cost() -> Figures:
    """CPU a reading, and its ratios to the floors."""
    with _sink() as sink, tempfile.TemporaryDirectory() as folder:
        bridge_round, records = _bridge(sink, Path(folder))
        floor_round = _floor(sink)
        full_floor_round = _full_floor(sink, Path(folder), records)
        rounds = [(bridge_round(), floor_round(), full_floor_round()) for _ in range(ROUNDS + 2)][2:]
    bridge_us, floor_us, full_floor_us = (statistics.median(each) for each in zip(*rounds, strict=True))
    ratio = statistics.median(bridge / floor for bridge, floor, _ in rounds)
    full_ratio = statistics.median(bridge / full for bridge, _, full in rounds)
    return [
        figure("bridge_cpu_per_reading", bridge_us, "us, recording on"),
        figure("floor_pack_and_send", floor_us, "us", at_most(25)),
        figure("floor_with_kalman_and_records", full_floor_us, f"us, {len(records)} records"),
        figure("bridge_over_floor", ratio, "times pack and send", at_most(16)),
        figure("bridge_over_full_floor", full_ratio, "times with Kalman and records", at_most(2.9)),
    ]


def latency() -> Figures:
    """End of a ranging to the fused message handed to the link, in real time."""
    clock = SystemClock()
    ends: dict[int, float] = {}
    delays_ms = []
    with _sink() as sink:
        transport = _Watched(open_transport(_url(sink), clock), lambda: delays_ms.append(1e3 * (clock.now() - ends[0])))

        def echo(ping_s: float) -> int:
            reading_cm = 100 + int(ping_s * 100) % 400
            ends[0] = ping_s + TIMING.ranging_s(reading_cm, NO_ECHO_CM)
            return reading_cm

        bus = EmulatedBus([EmulatedMB1242(address, clock.now, echo) for address in range(0x70, 0x74)], clock.now)
        bridge = Bridge(load_airframe(AIRFRAME), bus, clock, transport)
        stop_s = clock.now() + LATENCY_S
        while clock.now() < stop_s:
            bridge.step()
    p99_ms = float(np.percentile(delays_ms, 99))
    return [
        figure("latency_median", float(np.median(delays_ms)), "ms, end of ranging to message"),
        figure("latency_p99", p99_ms, "ms, end of ranging to message", at_most(5)),
    ]


class _Watched(Wrapped):
    """A transport that calls back at each DISTANCE_SENSOR that has been handed over."""

    def __init__(self, transport: Transport, sent: Callable[[], None]) -> None:
        super().__init__(transport)
        self._sent = sent

    def send(self, frame: bytes) -> bool:
        taken = super().send(frame)
        if int.from_bytes(frame[7:10], "little") == dialect.MAVLINK_MSG_ID_DISTANCE_SENSOR:
            self._sent()
        return taken


def _bridge(sink: socket.socket, folder: Path) -> tuple[Callable[[], float], list[Record]]:
    """A function that flies a round and returns microseconds a reading; and the records that one reading makes."""
    clock = VirtualClock()
    ranges = itertools.cycle(range(140, 161))
    # They are done when they are first asked: thirty tries in between would cool the caches, and the floors have none.
    at_once = DeviceTiming(ready_s=0.0, s_per_cm=1e-6, no_echo_s=TIMING.no_echo_s)
    devices = [EmulatedMB1242(address, clock.now, lambda _: next(ranges), at_once) for address in range(0x70, 0x74)]
    recorder = _Keeping(Recorder(folder / "bridge.mcap", clock))
    transport = open_transport(_url(sink), SystemClock())
    bridge = Bridge(load_airframe(AIRFRAME), EmulatedBus(devices, clock.now), clock, transport, recorder=recorder)

    def fly() -> float:
        spent_ns: list[int] = []
        while len(spent_ns) < READINGS:
            start_ns = time.thread_time_ns()
            steps = bridge.step()
            if steps:
                spent_ns.append(time.thread_time_ns() - start_ns)
        _drain(sink)
        return statistics.median(spent_ns) / 1e3

    fly()
    newest = [each for each in recorder.kept if each[0] != "/health"]
    of_one_reading = newest[len(newest) - round(len(newest) / READINGS) :]
    recorder.only_write()
    return fly, of_one_reading


def _floor(sink: socket.socket, also: Callable[[], None] = lambda: None) -> Callable[[], float]:
    """pymavlink packs one DISTANCE_SENSOR, a connected UDP socket sends it; and what is also done for a reading."""
    mav = dialect.MAVLink(None, srcSystem=1, srcComponent=191)
    out = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    out.connect(sink.getsockname())

    def send() -> None:
        message = dialect.MAVLink_distance_sensor_message(
            1000, 19, 765, 300, 1, 10, 25, 4, 0.44, 0.44, (0.0, 0.0, 0.0, 0.0), 100
        )
        out.send(message.pack(mav))
        also()

    def round_() -> float:
        microseconds = _time(send)
        _drain(sink)
        return microseconds

    return round_


def _full_floor(sink: socket.socket, folder: Path, records: list[Record]) -> Callable[[], float]:
    """The floor, one filterpy predict and update, and the records of one reading by the mcap package's own writer."""
    recording = Writer((folder / "floor.mcap").open("wb"))
    recording.start()
    schema = recording.register_schema("floor", "jsonschema", b"{}")
    channels = {topic: recording.register_channel(topic, "json", schema) for topic, _ in records}
    kalman = KalmanFilter(dim_x=2, dim_z=1)
    kalman.H = np.array([[1.0, 0.0]])
    transition, noise = np.array([[1.0, 0.1], [0.0, 1.0]]), np.eye(2) * 1e-3
    measured, variance = np.array([[3.0]]), np.array([[4e-4]])

    def filter_and_record() -> None:
        kalman.predict(F=transition, Q=noise)
        kalman.update(measured, R=variance)
        for topic, message in records:
            time_ns = time.time_ns()
            recording.add_message(channels[topic], time_ns, orjson.dumps(message), time_ns)

    floor = _floor(sink, filter_and_record)

    def round_() -> float:
        microseconds = floor()
        recording.flush()
        return microseconds

    return round_


class _Keeping:
    """A recorder that keeps the first round's messages."""

    def __init__(self, recorder: Recorder) -> None:
        self._recorder = recorder
        self.flush_if_due = recorder.flush_if_due
        self.fault: str | None = None
        self.kept: list[Record] = []
        self.write = self._keep

    def _keep(self, topic: str, time_s: float, message: dict[str, Any]) -> None:
        self.kept.append((topic, message))
        self._recorder.write(topic, time_s, message)

    def only_write(self) -> None:
        """Keep nothing from now on."""
        self.write = self._recorder.write


def _time(work: Callable[[], None]) -> float:
    spent_ns: list[int] = []
    for _ in range(READINGS):
        start_ns = time.thread_time_ns()
        work()
        spent_ns.append(time.thread_time_ns() - start_ns)
    return statistics.median(spent_ns) / 1e3


def _sink() -> socket.socket:
    sink = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sink.bind(("127.0.0.1", 0))
    sink.setblocking(False)
    return sink


def _url(sink: socket.socket) -> str:
    host, port = sink.getsockname()
    return f"udpout:{host}:{port}"


def _drain(sink: socket.socket) -> None:
    try:
        while True:
            sink.recv(4096)
    except BlockingIOError:
        return
