"""Send a reading's messages: on the sensor's single stream, on the fused stream, or none.

A distance is sent if filter or fusion gave one, else 'no echo' if that is known (`msp_range.mavlink.no_echo`); a fault
is silence.

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
from msp_range.mavlink.distance_sensor import QUALITY_BEST, Stream, distance_sensor
from msp_range.mavlink.no_echo import is_no_echo
from msp_range.reading import Reading

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

    next_event_s = float("inf")
    _free_s = float("-inf")

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._waiting: dict[int, Any] = {}

    def send_now(self, now_s: float, message: Any) -> None:
        """Send a message before all waiting ones."""
        self._send(message)
        self._free_s = now_s + SPACING_S
        self.next_event_s = self._free_s if self._waiting else float("inf")

    def put(self, now_s: float, stream_id: int, message: Any) -> None:
        """Queue a message, in place of a waiting one of the same stream, and send the next one if it is due."""
        self._waiting[stream_id] = message
        self.next_event_s = self._free_s
        self.send_due(now_s)

    def send_due(self, now_s: float) -> None:
        """Send the next waiting message if it is due."""
        if now_s >= self.next_event_s:
            self.send_now(now_s, self._waiting.pop(next(iter(self._waiting))))


class Streams:
    """The DISTANCE_SENSOR streams of a vehicle.

    Parameters
    ----------
    beams
        Every sensor's beam, by name.
    send
        Sends a message now.

    Attributes
    ----------
    outbox
        Messages of the single streams that wait for their turn.
    singles, objects
        Streams of single sensors, and streams that send only while an object is below a sensor, by its name.
    fused
        The fused stream, or None.

    The streams have the limits that they have in air of the present temperature: set them before the first message, and
    where it changes.
    """

    singles: Mapping[str, Stream]
    fused: Stream | None
    objects: Mapping[str, Stream]

    def __init__(self, beams: Mapping[str, BreakawayTable], send: Callable[[Any], object]) -> None:
        self._beams = beams
        self._agree = {name: deque([True] * CONFIDENCE_READINGS, CONFIDENCE_READINGS) for name in beams}
        self.outbox = Outbox(send)

    def send_fused(self, now_s: float, boot_ms: int, outcome: Outcome, air: Air, confidence: float) -> bool:
        """Send the fused stream's message for a downward sensor's reading; False if there is nothing usable.

        Parameters
        ----------
        now_s
            Time on the bridge's clock [s].
        boot_ms
            Time of the echo on the autopilot's clock [ms].
        outcome
            The fusion's result.
        air
            The air temperature used for compensation; its uncertainty is added to the variance.
        confidence
            In a distance (`Fusion.confidence`).
        """
        fused = outcome.fused
        if self.fused is None or (fused is None and not is_no_echo(outcome)):
            return False
        message = self._message(self.fused, boot_ms, outcome.reading.sensor, fused, air, confidence)
        self.outbox.send_now(now_s, message)
        return True

    def send_single(self, now_s: float, boot_ms: int, reading: Reading, filtered: Filtered, air: Air) -> bool:
        """Send the message of the sensor's own stream for a reading; False if there is nothing usable.

        Parameters
        ----------
        now_s, boot_ms, air
            As for `send_fused`.
        reading, filtered
            The sensor's answer, and its filters' result.
        """
        sensor, estimate = reading.sensor, filtered.estimate
        stream = self.singles[sensor]
        if filtered.rejected in (None, UNEXPECTED):
            self._agree[sensor].append(filtered.rejected is None)
        if estimate is None and not is_no_echo(reading):
            return False
        confidence = sum(self._agree[sensor]) / CONFIDENCE_READINGS
        self.outbox.put(now_s, stream.id, self._message(stream, boot_ms, sensor, estimate, air, confidence))
        return True

    def send_object(self, now_s: float, boot_ms: int, reading: Reading, air: Air) -> None:
        """Send the distance of an object below a downward sensor, unless the sensor has its own stream."""
        stream = self.objects.get(reading.sensor)
        if stream is None or reading.range_m is None:
            return
        estimate = Estimate(reading.range_m, reading.variance_m2)
        self.outbox.put(now_s, stream.id, self._message(stream, boot_ms, reading.sensor, estimate, air, 1.0))

    def _message(
        self,
        stream: Stream,
        boot_ms: int,
        sensor: str,
        estimate: Estimate | Fused | None,
        air: Air,
        confidence: float,
    ) -> Any:
        """A stream's message: a distance, or without an estimate 'no echo'."""
        range_m: float | None = None
        variance_m2, seen_m = float("inf"), stream.max_distance_cm / 100
        if estimate is not None:
            range_m = seen_m = estimate.range_m
            variance_m2 = estimate.variance_m2 + air_variance_m2(seen_m, air)
        view_rad = self._beams[sensor].field_of_view_rad(seen_m)
        return distance_sensor(stream, boot_ms, range_m, variance_m2, view_rad, round(QUALITY_BEST * confidence))
