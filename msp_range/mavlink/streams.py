"""What goes out for a reading: the single stream of its sensor, the fused stream, or silence.

A distance goes out where the filters gave one, 'no echo' where the sensor heard nothing, and a fault is silence. The
fused stream says 'no echo' where most of the downward sensors that work heard nothing.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from msp_range.acoustics.beam import BreakawayTable
from msp_range.filters.base import Estimate
from msp_range.fusion import Fused
from msp_range.mavlink.distance_sensor import Stream, distance_sensor, no_echo
from msp_range.mavlink.outbox import Outbox
from msp_range.reading import Status

QUALITY_READINGS = 10
"""A stream's quality is the share of its last this many readings that were used."""
HALF_A_CENTIMETRE = 0.005
HELD_BEAM_QUALITY = 0.5
"""What is left of the quality at a range where nothing speaks for the beam's angle (`BreakawayTable.known_to_m`)."""


class _Source:
    """What is known of a sensor's recent readings."""

    def __init__(self, beam: BreakawayTable, stream: Stream | None, object_stream: Stream | None) -> None:
        self.beam = beam
        self.stream = stream
        self.object_stream = object_stream
        self.status: Status | None = None
        self.quality = 0
        self._used: deque[bool] = deque(maxlen=QUALITY_READINGS)

    def note(self, status: Status, used: bool) -> None:
        self.status = status
        self._used.append(used)
        self.quality = 100 * sum(self._used) // len(self._used)


class Streams:
    """The DISTANCE_SENSOR streams of a vehicle.

    Parameters
    ----------
    beams
        Every sensor's beam, by name.
    singles
        Streams of single sensors, by name.
    fused
        The fused stream; None: there is none.
    downward
        Names of the sensors of the fused stream.
    objects
        Streams that speak only while an object is below a sensor, by name.
    send
        Sends one message now.
    """

    def __init__(
        self,
        beams: Mapping[str, BreakawayTable],
        singles: Mapping[str, Stream],
        fused: Stream | None,
        downward: Sequence[str],
        objects: Mapping[str, Stream],
        send: Callable[[Any], object],
    ) -> None:
        self._sources = {name: _Source(beam, singles.get(name), objects.get(name)) for name, beam in beams.items()}
        self._fused = fused
        self._downward = [self._sources[name] for name in downward]
        self._hears_nothing: set[str] = set()
        self._outbox = Outbox(send)

    @property
    def next_event_s(self) -> float:
        """When `send_due` has something to do [s]."""
        return self._outbox.next_event_s

    def send_due(self, now_s: float) -> None:
        """Send a single stream's message that waited for its turn."""
        self._outbox.send_due(now_s)

    def take(
        self,
        now_s: float,
        boot_ms: int,
        sensor: str,
        status: Status,
        single: Estimate | None,
        fused: Fused | None,
        object_below: bool = False,
    ) -> None:
        """Send what one reading means.

        Parameters
        ----------
        now_s
            Time on the bridge's clock [s].
        boot_ms
            Time of the echo on the autopilot's clock [ms].
        sensor, status
            Whose reading, and what the sensor's answer meant.
        single
            What came out of the sensor's filters; None where the reading was not used.
        fused
            The fused distance at this time; None where there is none, or the sensor is not a downward one.
        object_below
            Whether the sensor sees something nearer than the ground.
        """
        source = self._sources[sensor]
        source.note(status, single is not None)
        if self._fused is not None and source in self._downward:
            if status is Status.NO_ECHO:
                self._hears_nothing.add(sensor)
            else:
                self._hears_nothing.discard(sensor)
            if self._hears_nothing and self._most_hear_nothing():
                self._outbox.send_now(now_s, _no_echo(self._fused, boot_ms, source.beam))
            elif fused is not None:
                quality = sum([each.quality for each in self._downward]) // len(self._downward)
                self._outbox.send_now(now_s, _distance(self._fused, boot_ms, fused, source.beam, quality))
        if source.stream is not None:
            if single is not None:
                message = _distance(source.stream, boot_ms, single, source.beam, source.quality)
                self._outbox.put(source.stream.id, message)
            elif status is Status.NO_ECHO:
                self._outbox.put(source.stream.id, _no_echo(source.stream, boot_ms, source.beam))
            self._outbox.send_due(now_s)
        elif object_below and single is not None and source.object_stream is not None:
            stream = source.object_stream
            self._outbox.put(stream.id, _distance(stream, boot_ms, single, source.beam, source.quality))
            self._outbox.send_due(now_s)

    def _most_hear_nothing(self) -> bool:
        working = [each for each in self._downward if each.status is not None and not each.status.is_fault]
        return 2 * len(self._hears_nothing) > len(working)


def _distance(stream: Stream, boot_ms: int, estimate: Estimate | Fused, beam: BreakawayTable, quality: int) -> Any:
    view_rad = beam.field_of_view_rad(estimate.range_m)
    if estimate.range_m > beam.known_to_m + HALF_A_CENTIMETRE:
        quality = int(quality * HELD_BEAM_QUALITY)
    return distance_sensor(stream, boot_ms, estimate.range_m, estimate.variance_m2, view_rad, quality)


def _no_echo(stream: Stream, boot_ms: int, beam: BreakawayTable) -> Any:
    return no_echo(stream, boot_ms, beam.field_of_view_rad(stream.max_distance_cm / 100))
