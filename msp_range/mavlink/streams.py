"""Send a reading's messages: on the sensor's single stream, on the fused stream, or none.

A distance is sent if filter or fusion gave one, 'no echo' if a single sensor received no echo or the vehicle is above
the range of its downward sensors; a fault is silence.

Fused messages are sent at once, those of single streams spaced out after them: PX4 keeps one unread message per link,
so of several in one burst only the last is seen.
"""

from collections.abc import Callable, Mapping
from typing import Any

from msp_range.acoustics.air import Air, air_variance_m2
from msp_range.acoustics.beam import BreakawayTable
from msp_range.filters.base import Estimate
from msp_range.filters.chain import UNEXPECTED, Filtered
from msp_range.fusion import Fused, Outcome
from msp_range.fusion.fusion import FIT_OUTLIER, FIT_READINGS, FIT_TOLERATED
from msp_range.mavlink.distance_sensor import QUALITY_BEST, QUALITY_LOWEST, Stream, distance_sensor
from msp_range.reading import Reading, Status

DOUBT_FIT, DOUBT_QUALITY = 3.0, 90
"""Quality at this mean square of the normalised innovations; ArduSub drops a distance of less than 90 (RNGFND_SQ_MIN).
One outlier among good readings takes the mean square to 2.1, a second one soon after it to 3.1. In 350 flights of the
fault campaign (seed 5) it was over 3 in 1.7 % of the time, with two thirds of the errors over 25 cm (4 s in all). Over
4 was one third of them; at 2 ArduSub would drop distances for single outliers."""
TIED_QUALITY = 50
"""Quality at most while the newest readings of as many sensors are off the ground as on it: either may be right.
Anything below 90 and above 1 makes ArduSub wait for the end of that."""
SPACING_S = 0.020
"""Time from a message to the next one of a single stream [s]: more delays the last of several streams."""


class Outbox:
    """Messages of the single streams that wait for their turn.

    Parameters
    ----------
    send
        Sends a message now.
    """

    def __init__(self, send: Callable[[Any], object]) -> None:
        self._send = send
        self._waiting: dict[int, Any] = {}
        self._free_s = float("-inf")

    @property
    def next_event_s(self) -> float:
        """When `send_due` has something to do [s]; infinite if nothing waits."""
        return self._free_s if self._waiting else float("inf")

    def send_now(self, now_s: float, message: Any) -> None:
        """Send a message before all waiting ones."""
        self._send(message)
        self._free_s = now_s + SPACING_S

    def put(self, now_s: float, stream_id: int, message: Any) -> None:
        """Queue a message, in place of a waiting one of the same stream, and send the next one if it is due."""
        self._waiting[stream_id] = message
        self.send_due(now_s)

    def send_due(self, now_s: float) -> None:
        """Send the next waiting message if it is due."""
        if now_s >= self.next_event_s:
            self.send_now(now_s, self._waiting.pop(next(iter(self._waiting))))


def quality_of(fit: float, is_tied: bool = False) -> int:
    """``signal_quality`` of a distance: 100 where its error is as stated, less where readings contradict it.

    100 - 10 (fit - 1.5) / (3 - 1.5) from a fit of 1.5 on, up to which the filter's variance stands. Sensors that are
    silent or get no echo change nothing.

    Parameters
    ----------
    fit
        Mean square of the last innovations over their variance (`Fusion.fit`).
    is_tied
        Whether as many sensors see something else (`Fusion.is_tied`).

    Returns
    -------
    int
        100 to 2.

    Examples
    --------
    >>> [quality_of(fit) for fit in (1.0, 2.1, 3.0, 4.0, 25.0)], quality_of(1.0, is_tied=True)
    ([100, 96, 90, 83, 2], 50)
    """
    excess = max(fit - FIT_TOLERATED, 0.0) / (DOUBT_FIT - FIT_TOLERATED)
    quality = max(round(QUALITY_BEST - (QUALITY_BEST - DOUBT_QUALITY) * excess), QUALITY_LOWEST)
    return min(quality, TIED_QUALITY) if is_tied else quality


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
    """

    def __init__(self, beams: Mapping[str, BreakawayTable], send: Callable[[Any], object]) -> None:
        self._beams = beams
        self._fits = dict.fromkeys(beams, 1.0)
        self.outbox = Outbox(send)

    def set_streams(self, singles: Mapping[str, Stream], fused: Stream | None, objects: Mapping[str, Stream]) -> None:
        """Set the streams with the limits that they have in air of the present temperature.

        Parameters
        ----------
        singles
            Streams of single sensors, by name.
        fused
            The fused stream, or None.
        objects
            Streams that send only while an object is below a sensor, by name.
        """
        self._singles, self._fused, self._objects = singles, fused, objects

    def send_fused(self, now_s: float, boot_ms: int, outcome: Outcome, air: Air, quality: int) -> bool:
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
        quality
            Of a distance; see `quality_of`.
        """
        if self._fused is None or (outcome.fused is None and not outcome.above_maximum):
            return False
        self.outbox.send_now(
            now_s, self._message(self._fused, boot_ms, outcome.reading.sensor, outcome.fused, air, quality)
        )
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
        stream = self._singles[sensor]
        if filtered.rejected in (None, UNEXPECTED):
            # A filter does not say how far off a reading was that it used: by as much as stated, then.
            square = 1.0 if filtered.rejected is None else FIT_OUTLIER
            self._fits[sensor] += (square - self._fits[sensor]) / FIT_READINGS
        if estimate is None and reading.status is not Status.NO_ECHO:
            return False
        quality = quality_of(self._fits[sensor])
        self.outbox.put(now_s, stream.id, self._message(stream, boot_ms, sensor, estimate, air, quality))
        return True

    def send_object(self, now_s: float, boot_ms: int, reading: Reading, air: Air) -> None:
        """Send the distance of an object below a downward sensor, unless the sensor has its own stream."""
        stream = self._objects.get(reading.sensor)
        if stream is None or reading.range_m is None:
            return
        variance_m2 = float("inf") if reading.std_m is None else reading.std_m**2
        estimate = Estimate(reading.range_m, variance_m2)
        self.outbox.put(now_s, stream.id, self._message(stream, boot_ms, reading.sensor, estimate, air, QUALITY_BEST))

    def _message(
        self,
        stream: Stream,
        boot_ms: int,
        sensor: str,
        estimate: Estimate | Fused | None,
        air: Air,
        quality: int,
    ) -> Any:
        """A stream's message: a distance, or without an estimate 'no echo'."""
        beam = self._beams[sensor]
        if estimate is None:
            view_rad = beam.field_of_view_rad(stream.max_distance_cm / 100)
            return distance_sensor(stream, boot_ms, None, float("inf"), view_rad, quality)
        variance_m2 = estimate.variance_m2 + air_variance_m2(estimate.range_m, air)
        view_rad = beam.field_of_view_rad(estimate.range_m)
        return distance_sensor(stream, boot_ms, estimate.range_m, variance_m2, view_rad, quality)
