"""The bridge as a service: signals, watchdog, logs, exit codes.

SIGTERM and SIGINT end it, SIGHUP reads the airframe file again. Exit codes: 0 ended by a signal or the end of its
input; 1 an error in the program; 2 invalid command line; 3 an unusable airframe, sensor model or data file, or a bus
that another process uses. Broken equipment never ends the service.
"""

import faulthandler
import gc
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from msp_range.bridge import Bridge
from msp_range.bus.smbus import KernelBus
from msp_range.clock import Clock, SystemClock
from msp_range.config import Airframe
from msp_range.correction.thermometer import ThreadReader
from msp_range.health.verdict import BridgeState
from msp_range.log import Log
from msp_range.mavlink.signing import signing_of
from msp_range.mavlink.transport import Transport, open_transport
from msp_range.plausible import doubts
from msp_range.recording.error import RecordingError
from msp_range.reload import FlownAirframe
from msp_range.systemd import notify_systemd
from msp_range.watch.feed import FeedError
from msp_range.watch.place import Outputs
from msp_range.watch.watch import Watch

if TYPE_CHECKING:
    from msp_range.recording.flight_recorder import FlightRecorder

SUMMARY_INTERVAL_S = 60.0
CHECK_INTERVAL_S = 0.05
"""Time between two checks of all that is not the bridge's own: a reload, systemd's watchdog, watchers and the link's
state [s]. A mark in the recording is at most this late, and an eighth of the processor time was spent on checks after
every step of the bridge."""
LINK_CHECK_INTERVAL_S = 1.0
"""Time between two checks of what the log says about the link [s]; a shorter one logs each change of a loose plug."""
FEED_INTERVAL_S = 0.2
"""Shortest time between two messages to systemd's watchdog [s]. WatchdogSec in systemd/msp-range.service is 1.5 s; less
only keeps systemd busy, with more a slow computer restarts the bridge."""
TRANSFER_CHECK_S = 0.25
"""Time between two checks whether a transfer keeps the loop [s]. The watchdog is fed at most three of these and
`FEED_INTERVAL_S` late; less wakes the computer more often."""
STUCK_S = 1.25
"""A transfer of this length is reported to the pilot before it ends [s]: kernel drivers give up after 1 s unless they
say otherwise, and the report after that has the error. Longer leaves the pilot longer without a reason."""
LONGEST_TRANSFER_S = 10.0
"""A transfer keeps the watchdog fed for this long [s]: adapters on USB give up after 2 to 4 s for each of its parts,
and a restart helps none of them. Less restarts the bridge for ever with a slower one; more leaves a driver that hangs
alone for longer."""


@contextmanager
def transfers_watched(bridge: Bridge, bus: KernelBus, clock: Clock) -> Iterator[None]:
    """Context in which a transfer that keeps the loop is reported to the pilot, and no reason for a restart."""
    ended = threading.Event()

    def watch() -> None:
        while not ended.wait(TRANSFER_CHECK_S):
            waits_s = clock.now() - bridge.completed_s
            if waits_s > TRANSFER_CHECK_S and bus.waiting.acquire(blocking=False):
                try:
                    if waits_s < LONGEST_TRANSFER_S:
                        notify_systemd("WATCHDOG=1")
                    if waits_s > STUCK_S:
                        bridge.on_stuck_transfer()
                finally:
                    bus.waiting.release()

    thread = threading.Thread(target=watch, name="transfers", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


@contextmanager
def received_signals(*signals: signal.Signals) -> Iterator[list[int]]:
    """Context in which these signals are added to the list instead of ending the program."""
    received: list[int] = []

    def record(signum: int, frame: FrameType | None) -> None:
        received.append(signum)

    before = {signum: signal.signal(signum, record) for signum in signals}
    try:
        yield received
    finally:
        for signum, handler in before.items():
            signal.signal(signum, handler)


stop_signals = partial(received_signals, signal.SIGTERM, signal.SIGINT)
"""Context in which SIGTERM and SIGINT are added to the list instead of ending the program."""


def flight_recorder(
    airframe: Airframe,
    folder: Path | None,
    clock: Clock,
    on_file: Callable[[Path], None],
    on_failure: Callable[[str], None],
) -> "FlightRecorder | None":
    """A recorder into ``folder`` or the airframe's folder; None if neither is given."""
    if folder is None and airframe.recording is not None:
        folder = Path(airframe.recording.folder)
    if folder is None:
        return None
    # Imports orjson and zstandard, which a flight without a recording does not need.
    from msp_range.recording.flight_recorder import FlightRecorder

    return FlightRecorder(folder, airframe.vehicle, clock, files=airframe.files, on_file=on_file, on_failure=on_failure)


def serve(
    bridge: Bridge,
    clock: Clock,
    log: Log,
    transport: Transport,
    stopped: Sequence[int],
    flown: FlownAirframe | None = None,
    watch: Watch | None = None,
) -> None:
    """Step the bridge until ``stopped`` contains a signal or the airframe has changed."""
    notify_systemd("READY=1")
    next_check_s = next_feed_s = clock.now()
    next_link_check_s = clock.now() + LINK_CHECK_INTERVAL_S
    next_summary_s = clock.now() + SUMMARY_INTERVAL_S
    link_log = _LinkLog(bridge, transport, log)
    while not stopped:
        bridge.step()
        now_s = clock.now()
        if now_s < next_check_s:
            continue
        next_check_s = now_s + CHECK_INTERVAL_S
        if flown is not None and flown.has_changed(bridge):
            return
        if bridge.completed_s >= next_feed_s:
            notify_systemd("WATCHDOG=1")
            next_feed_s = now_s + FEED_INTERVAL_S
        if watch is not None:
            watch.service(now_s)
        if now_s >= next_link_check_s:
            next_link_check_s = now_s + LINK_CHECK_INTERVAL_S
            link_log.update()
        if now_s >= next_summary_s:
            next_summary_s += SUMMARY_INTERVAL_S
            event = "still flying" if bridge.link.autopilot_armed else "still running"
            log.info(event, **_summary(bridge, transport))
    log.info("stopped by signal", signal=signal.Signals(stopped[0]).name, **_summary(bridge, transport))
    notify_systemd("STOPPING=1")


class _LinkLog:
    """Logs the bridge's state when it changes, the autopilot that is received, and whether the link is connected."""

    def __init__(self, bridge: Bridge, transport: Transport, log: Log) -> None:
        self._bridge, self._transport, self._log = bridge, transport, log
        self._autopilot: int | None = None
        self._state: tuple[bool, str | None] = False, None
        self._verdict = bridge.verdict.state

    def update(self) -> None:
        """Log what has changed since the last call."""
        link, transport = self._bridge.link, self._transport
        if link.autopilot_is_present and link.autopilot_system != self._autopilot:
            self._autopilot = link.autopilot_system
            self._log.info("autopilot found", system=self._autopilot)
        verdict = self._bridge.verdict
        if verdict.state != self._verdict:
            self._verdict = verdict.state
            write = self._log.warning if verdict.state is BridgeState.CRITICAL else self._log.info
            write(verdict.state.value, reasons=[finding.text for finding in verdict.findings if finding.cause is None])
        state = transport.connected, transport.last_error
        if state != self._state:
            self._state = state
            connected, error = state
            write = self._log.info if connected else self._log.warning
            write("link", url=transport.description, connected=connected, error=error)


def _summary(bridge: Bridge, transport: Transport) -> dict[str, object]:
    counts = bridge.counts()
    return {
        "readings": {name: count.readings for name, count in counts.items()},
        "rejected": {name: count.rejected for name, count in counts.items() if count.rejected},
        "frames": {
            "sent": transport.stats.sent_frames,
            "dropped": transport.stats.dropped_frames,
            "reconnects": transport.stats.reconnects,
        },
    }


def run(
    airframe: Airframe,
    load: Callable[[], Airframe],
    log: Log,
    outputs: Outputs,
) -> None:
    """Run the service on this computer's bus and link until a signal ends it.

    Parameters
    ----------
    airframe
        The airframe.
    load
        Reads the airframe file again, after SIGHUP.
    log
        Log.
    outputs
        Where everything else goes.

    Raises
    ------
    BusInUse
        Another process uses the bus.
    """
    # Print the line where the loop hung when the watchdog ended it (SIGABRT), for the journal.
    faulthandler.enable()
    clock = SystemClock()
    with stop_signals() as stopped, received_signals(signal.SIGHUP) as requests:
        flown = FlownAirframe(airframe, load, requests, log)
        url = flown.airframe.link.url
        transport = open_transport(url, clock)
        while not stopped:
            if url != flown.airframe.link.url:
                transport.close()
                url = flown.airframe.link.url
                transport = open_transport(url, clock)
            _fly(flown, clock, log, transport, outputs, stopped)
            if not stopped:  # objects of the previous airframe are no longer needed
                gc.unfreeze()
                gc.collect()
        transport.close()
        flown.bus.close()


def _fly(
    flown: FlownAirframe, clock: Clock, log: Log, transport: Transport, outputs: Outputs, stopped: Sequence[int]
) -> None:
    """Fly an airframe until a signal arrives or the airframe changes."""
    airframe = flown.airframe
    log.info("started", vehicle=airframe.vehicle, bus=str(flown.bus.path), link=airframe.link.url, pid=os.getpid())
    for text in doubts(airframe):
        log.warning("airframe file", doubt=text)
    thermometer = ThreadReader(clock, on_error=lambda text: log.warning("thermometer", error=text))
    watch: Watch | None = None

    bridge = Bridge(
        airframe,
        flown.bus,
        clock,
        transport,
        report=lambda severity, text: log.write(severity.name.lower(), text),
        on_message=lambda now_s, message: None if watch is None else watch.on_message(now_s, message),
        thermometer=thermometer,
        signing=signing_of(airframe.link.signing_key, clock),
    )
    recorder = None
    try:
        with transfers_watched(bridge, flown.bus, clock):
            # The first sensor measures while the packages for recording and watching are imported.
            bridge.step()
            recorder = flight_recorder(
                airframe,
                outputs.record,
                clock,
                on_file=lambda path: log.info("recording", file=str(path)),
                on_failure=lambda text: log.warning("recording stopped", error=text),
            )
            if recorder is not None:
                bridge.record_to(recorder)
            try:
                watch = Watch(bridge, transport, outputs, clock.now(), log, recorder)
            except FeedError as error:
                log.warning("not watched", error=str(error))
            # All these objects stay; excluding them from garbage collection avoids pauses of 10 ms.
            gc.freeze()
            serve(bridge, clock, log, transport, stopped, flown, watch)
        if not stopped and recorder is not None:
            recorder.finish()  # the next airframe must not wait for the disk
    finally:
        thermometer.close()
        if watch is not None:
            watch.close()
        if recorder is not None:
            try:
                recorder.close()
            except RecordingError as error:
                log.error("recording not finished", error=str(error))
