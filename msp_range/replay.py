"""A recording, or a table of measured readings, through the same bridge again.

The readings are played through a bus whose sensors answer with them, at their own times on a virtual clock; so a
change to a filter or a gate is tried on what really happened.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

from rich.progress import BarColumn, TimeRemainingColumn

from msp_range.assembly import polled_sensors
from msp_range.bridge import Bridge, Counts, Records
from msp_range.bus import Address
from msp_range.clock import Clock, SystemClock
from msp_range.config import Airframe
from msp_range.fusion import Received
from msp_range.mavlink.transport import Transport, TransportStats
from msp_range.reading import Reading
from msp_range.recording.error import RecordingError
from msp_range.recording.mcap_records import Losses
from msp_range.recording.pings import Pings, Recorded
from msp_range.recording.replay_bus import ReplayBus
from msp_range.sensors.base import RecordedPing
from msp_range.sensors.schedule import PolledSensor
from msp_range.terminal import Bar, PlainConsole, console, plain_table

TOGETHER_S = 0.005
"""Pings of several sensors that are no farther apart than this were one group's [s]."""
LONGEST_GAP_S = 3600.0
"""A record with a longer gap is two records, or has a wrong time [s]."""
LATE_S = 0.5
"""A replay that falls behind its record by more than this says so [s]."""


class Nowhere:
    """A transport that accepts every frame and never receives: for a bridge without a link."""

    description = "nowhere"
    last_error = None
    connected = True
    quiet_until_s = float("inf")
    files = ()

    def __init__(self) -> None:
        self.stats = TransportStats()

    def send(self, frame: bytes) -> bool:
        """Count the frame."""
        self.stats.sent_frames += 1
        return True

    def receive(self) -> bytes:
        """Nothing."""
        return b""

    def close(self) -> None:
        """Nothing to release."""


class RecordedFlight:
    """A record, played again (`msp_range.bridge.Replayed`): sensors ping when they did, and are asked when they
    answered; air and motion were known when they were."""

    def __init__(self, airframe: Airframe, bus: ReplayBus, recorded: Recorded) -> None:
        self._bus = bus
        self.air_at = recorded.air_at
        self._coming = deque(recorded.received)
        self._sensors = {sensor.device.address: sensor for sensor in polled_sensors(airframe, bus).values()}

    def turn(self, last_ping_s: float, acknowledged: bool) -> tuple[float, Sequence[PolledSensor]]:
        """The sensors that come next in the record; at infinity where it has ended."""
        pings = [(ping, each) for address, each in self._sensors.items() if (ping := self._bus.next_ping(address))]
        if not pings:
            return float("inf"), ()
        first_s = min(ping.ping_s for ping, _ in pings)
        # Both times count from the ping. The first try to read is the one that succeeded, whatever the interval was.
        return first_s, [
            sensor._replace(timing=sensor.timing._replace(first_answer_s=ping.ready_s))
            for ping, sensor in pings
            if ping.ping_s - first_s <= TOGETHER_S
        ]

    def on_reading(self, reading: Reading) -> None:
        """Nothing: the order is the recorded one, whatever is read."""

    def again(self, sensor: str) -> None:
        """Nothing: the record has no other ping of a sensor whose reading does not fit."""

    def received(self, now_s: float) -> Iterator[tuple[float, Received]]:
        """What of the vehicle's motion was received since the last call, by the time that it is now."""
        while self._coming and self._coming[0][0] <= now_s:
            yield self._coming.popleft()


class PacedClock(SystemClock):
    """The record's time at the pace of the system's clock."""

    def __init__(self, start_s: float) -> None:
        self._ahead_s = start_s - SystemClock.now()

    def now(self) -> float:
        """Seconds on the record's clock."""
        return SystemClock.now() + self._ahead_s

    def sleep_until(self, time_s: float, files: Sequence[int] = ()) -> bool:
        """Sleep until ``time_s`` of the record, or until one of the files can be read: then True."""
        return super().sleep_until(time_s - self._ahead_s, files)


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """What the bridge made of a record: readings and rejections by sensor, fused distances, and messages by type."""

    counts: Mapping[str, Counts]
    fused: int
    sent: Mapping[str, int]
    duration_s: float
    behind_s: float


def replay(
    airframe: Airframe,
    recorded: Recorded,
    source: Path,
    clock: Clock,
    transport: Transport,
    recorder: Records | None = None,
) -> ReplayOutcome:
    """Play the pings of a record through a bridge of their own, to the last one.

    Parameters
    ----------
    airframe
        Its sensors have the names of the record's.
    recorded
        The record. Its air takes the place of the airframe's sources, which are not those of this computer now; without
        any it is the airframe's fixed temperature.
    source
        The file, for messages.
    clock
        Starts at the record's beginning.
    transport, recorder
        As of a bridge.

    Raises
    ------
    RecordingError
        The record has a sensor that the airframe has not.
    """
    pings = recorded.pings
    _refuse_gaps(pings, source)
    playbacks = {sensor.address: sensor.driver.playback for sensor in airframe.sensors}
    bus = ReplayBus(_by_address(airframe, pings, source), clock, playbacks)
    if not recorded.air:
        recorded = recorded._replace(air=[(0.0, airframe.temperature.fixed_air)])
    bridge = Bridge(
        airframe.without_thermometers,
        bus,
        clock,
        transport,
        recorder=recorder,
        replayed=RecordedFlight(airframe, bus, recorded),
    )
    expected = sum(len(of_sensor) for of_sensor in pings.values())
    start_s = clock.now()
    taken = fused = 0
    with Bar(BarColumn(), TimeRemainingColumn(), total=expected, on=PlainConsole(stderr=True)) as bar:
        while taken < expected:
            steps = bridge.step()
            taken += len(steps)
            fused += sum(step.fused is not None for step in steps)
            if steps:
                bar.show(f"replaying {source.name}", taken)
    # Messages that wait for their turn still go out.
    end_s = clock.now() + 0.1
    while clock.now() < end_s:
        bridge.step()
    return ReplayOutcome(bridge.counts(), fused, bridge.link.sent, end_s - start_s, bus.behind_s)


def show(outcome: ReplayOutcome, source: Path, losses: Losses | None = None) -> None:
    """Print the outcome as a table, and what of a damaged recording was left out."""
    title = f"{source}: {outcome.duration_s:.1f} s"
    rows = []
    for name, counts in outcome.counts.items():
        why = ", ".join(f"{reason} {count}" for reason, count in sorted(counts.rejected.items())) or "none"
        rows.append((name, str(counts.readings), str(counts.readings - counts.rejected.total()), why))
    out = console()
    out.print(plain_table(("sensor", "readings", "used", "rejected, why"), rows, "lrrl", title))
    sent = ", ".join(f"{name} {count}" for name, count in sorted(outcome.sent.items()))
    out.print(f"fused: {outcome.fused} distances; sent: {sent}")
    if losses is not None and losses:
        out.print(f"lost: {losses}")
    if outcome.behind_s > LATE_S:
        out.print(
            f"the record has more readings a second than the bridge polls: it was up to {outcome.behind_s:.1f} s late"
        )


def _refuse_gaps(pings: Pings, source: Path) -> None:
    times_s = sorted(ping.ping_s for each in pings.values() for ping in each)
    for before_s, after_s in pairwise(times_s):
        if after_s - before_s > LONGEST_GAP_S:
            raise RecordingError(
                f"{source}: nothing between {before_s:.3f} s and {after_s:.3f} s; "
                f"expected gaps of at most {LONGEST_GAP_S:.0f} s: is a time wrong, or are these two runs?"
            )


def _by_address(airframe: Airframe, pings: Pings, source: Path) -> dict[Address, Sequence[RecordedPing]]:
    """Recorded pings by sensor name -> by the addresses of the airframe's sensors.

    Raises
    ------
    RecordingError
        The record has a sensor that the airframe has not.
    """
    addresses = {sensor.name: sensor.address for sensor in airframe.sensors}
    strangers = [name for name in pings if name not in addresses]
    if strangers:
        raise RecordingError(
            f"{source}: has readings of {', '.join(strangers)}, but the airframe's sensors are "
            f"{', '.join(addresses)}; name an airframe whose sensors have these names with --airframe"
        )
    return {addresses[name]: each for name, each in pings.items()}
