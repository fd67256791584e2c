"""Send a reading's messages: on the sensor's single stream, on the fused stream, or none.

A distance is sent if filter or fusion gave one, 'no echo' if a single sensor received no echo or the vehicle is above
the range of its downward sensors; a fault is silence.

Fused messages are sent at once, those of single streams spaced out after them: PX4 keeps one unread message per link,
so of several in one burst only the last is seen.
"""

from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from msp_range.acoustics.air import Air, air_variance_m2
from msp_range.acoustics.beam import BreakawayTable
from msp_range.filters.base import Estimate
from msp_range.filters.chain import UNEXPECTED, Filtered
from msp_range.fusion import Fused, Outcome
from msp_range.fusion.fusion import CONFIDENCE_READINGS
from msp_range.mavlink.distance_sensor import QUALITY_BEST, Stream, distance_sensor, no_echo
from msp_range.reading import Reading, Status

SPACING_S = 0.020
"""Time from a message to the next one of a single stream [s]: more delays the last of several streams."""


class Outbox:
    """Messages of the single streams that wait for their turn.

    Parameters
    ----------
    send
        Sends a message now.

    Attributes
    ----------
    next_event_s
        When `send_due` has something to do [s]; infinite if nothing waits.
    """

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._waiting: dict[int, Any] = {}
        self._free_s = float("-inf")
        self.next_event_s = float("inf")

    def send_now(self, now_s: float, message: Any) -> None:
        """Send a message before all waiting ones."""
        self._send(message)
        self._free_s = now_s + SPACING_S
        self._plan()

    def put(self, stream_id: int, message: Any) -> None:
        """Queue a message; it replaces a waiting one of the same stream."""
        self._waiting[stream_id] = message
        self._plan()

    def send_due(self, now_s: float) -> None:
        """Send the next waiting message if it is due."""
        if now_s >= self.next_event_s:
            self.send_now(now_s, self._waiting.pop(next(iter(self._waiting))))

    def _plan(self) -> None:
        self.next_event_s = self._free_s if self._waiting else float("inf")


class Streams:
    """The DISTANCE_SENSOR streams of a vehicle.

    Parameters
    ----------
    beams
        Every sensor's beam, by name.
    singles
        Streams of single sensors, by name.
    fused
        The fused stream, or None.
    objects
        Streams that send only while an object is below a sensor, by name.
    send
        Sends a message now.

    Attributes
    ----------
    outbox
        Messages of the single streams that wait for their turn.
    """

    def __init__(
        self,
        beams: Mapping[str, BreakawayTable],
        singles: Mapping[str, Stream],
        fused: Stream | None,
        objects: Mapping[str, Stream],
        send: Callable[[Any], object],
    ) -> None:
        self._beams = beams
        self._singles = singles
        self._fused = fused
        self._objects = objects
        self._agree = {name: deque([True] * CONFIDENCE_READINGS, CONFIDENCE_READINGS) for name in singles}
        self.outbox = Outbox(send)

    def set_streams(self, singles: Mapping[str, Stream], fused: Stream | None, objects: Mapping[str, Stream]) -> None:
        """The same streams with other limits, because the air has another temperature."""
        self._singles, self._fused, self._objects = singles, fused, objects

    def send_fused(
        self, now_s: float, boot_ms: int, sensor: str, outcome: Outcome, air: Air, confidence: float
    ) -> bool:
        """Send the fused stream's message for a downward sensor's reading; False if there is nothing usable.

        Parameters
        ----------
        now_s
            Time on the bridge's clock [s].
        boot_ms
            Time of the echo on the autopilot's clock [ms].
        sensor, outcome
            The sensor, and the fusion's result.
        air
            The air temperature used for compensation; its uncertainty is added to the variance.
        confidence
            In a distance (`Fusion.confidence`).
        """
        if self._fused is None:
            return False
        beam = self._beams[sensor]
        if outcome.fused is not None:
            self.outbox.send_now(now_s, _distance(self._fused, boot_ms, outcome.fused, air, beam, confidence))
        elif outcome.above_maximum:
            self.outbox.send_now(now_s, _no_echo(self._fused, boot_ms, beam))
        else:
            return False
        return True

    def send_single(
        self, now_s: float, boot_ms: int, sensor: str, status: Status, filtered: Filtered, air: Air
    ) -> bool:
        """Send the message of the sensor's own stream for a reading; False if there is nothing usable.

        Parameters
        ----------
        now_s, boot_ms, sensor, air
            As for `send_fused`.
        status, filtered
            Status of the sensor's answer, and its filters' result.
        """
        stream, beam, estimate = self._singles[sensor], self._beams[sensor], filtered.estimate
        if filtered.rejected in (None, UNEXPECTED):
            self._agree[sensor].append(filtered.rejected is None)
        if estimate is not None:
            confidence = sum(self._agree[sensor]) / CONFIDENCE_READINGS
            self.outbox.put(stream.id, _distance(stream, boot_ms, estimate, air, beam, confidence))
        elif status is Status.NO_ECHO:
            self.outbox.put(stream.id, _no_echo(stream, boot_ms, beam))
        else:
            return False
        self.outbox.send_due(now_s)
        return True

    def send_object(self, now_s: float, boot_ms: int, reading: Reading, air: Air) -> None:
        """Send the distance of an object below a downward sensor, unless the sensor has its own stream."""
        stream = self._objects.get(reading.sensor)
        if stream is None or reading.range_m is None:
            return
        variance_m2 = float("inf") if reading.std_m is None else reading.std_m**2
        estimate, beam = Estimate(reading.range_m, variance_m2), self._beams[reading.sensor]
        self.outbox.put(stream.id, _distance(stream, boot_ms, estimate, air, beam, 1.0))
        self.outbox.send_due(now_s)


def _distance(
    stream: Stream, boot_ms: int, estimate: Estimate | Fused, air: Air, beam: BreakawayTable, confidence: float
) -> Any:
    view_rad = beam.field_of_view_rad(estimate.range_m)
    variance_m2 = estimate.variance_m2 + air_variance_m2(estimate.range_m, air)
    return distance_sensor(stream, boot_ms, estimate.range_m, variance_m2, view_rad, round(QUALITY_BEST * confidence))


def _no_echo(stream: Stream, boot_ms: int, beam: BreakawayTable) -> Any:
    return no_echo(stream, boot_ms, beam.field_of_view_rad(stream.max_distance_cm / 100))
