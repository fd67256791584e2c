"""Make DISTANCE_SENSOR messages from estimates. This is the only place where metres become the message's centimetres.

How autopilots interpret the fields (ArduPilot 4.7, PX4 main): quality 0 means unknown and is accepted; covariance 255
means unknown; the sensor's shortest report, 20 cm, has to be above ``min_distance`` to be accepted; a fault is silence.
`msp_range.mavlink.no_echo` has the form of 'no echo'.
"""

import math
from typing import Any, Literal, NamedTuple

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.no_echo import QUALITY_INVALID, no_echo_cm
from msp_range.mavlink.orientation import Orientation
from msp_range.numbers import limited

COVARIANCE_UNKNOWN = 255
QUALITY_LOWEST, QUALITY_BEST = 2, 100

Autopilot = Literal["ardupilot", "px4"]

_Message = dialect.MAVLink_distance_sensor_message


class Stream(NamedTuple):
    """The constant fields of a stream's messages, with the bounds that the autopilot expects."""

    id: int
    """The message's ``id``."""
    orientation: Orientation
    """Orientation of the stream."""
    shortest_cm: int
    max_distance_cm: int
    """Shortest and longest distance that the stream can report [cm]."""
    autopilot: Autopilot
    """Who receives it."""
    type: int = dialect.MAV_DISTANCE_SENSOR_ULTRASOUND
    """MAV_DISTANCE_SENSOR."""

    @property
    def min_distance_cm(self) -> int:
        """A centimetre below the shortest distance, but not below 0 [cm]: a distance that equals ``min_distance`` is
        out of range for both autopilots."""
        return max(self.shortest_cm - 1, 0)


def distance_sensor(
    stream: Stream,
    time_boot_ms: int,
    range_m: float | None,
    variance_m2: float,
    field_of_view_rad: float,
    quality: int,
) -> Any:
    """DISTANCE_SENSOR with a distance, or of a working sensor without an echo.

    Parameters
    ----------
    time_boot_ms
        Time of the echo on the autopilot's clock [ms].
    range_m
        Distance [m]; limited to what the sensor can report. None: no echo, of which only the field of view counts.
    variance_m2
        Variance of its error [m^2]; infinite if unknown. Sent in cm^2, rounded up, 1 to 254.
    field_of_view_rad
        Full angle of the beam at this range, horizontal and vertical [rad].
    quality
        2 to 100.

    Raises
    ------
    ValueError
        The range is not a number: that is a fault, and a fault is never sent.
    """
    covariance, minimum_cm = COVARIANCE_UNKNOWN, stream.min_distance_cm
    if range_m is None:
        current_cm = no_echo_cm(stream.max_distance_cm, stream.orientation.value, stream.autopilot)
        quality = QUALITY_INVALID
    else:
        if not math.isfinite(range_m):
            raise ValueError(f"a distance of {range_m} m cannot be sent")
        current_cm = round(limited(range_m * 100, minimum_cm + 1, stream.max_distance_cm))
        quality = round(limited(quality, QUALITY_LOWEST, QUALITY_BEST))
        if math.isfinite(variance_m2):
            covariance = math.ceil(limited(variance_m2 * 1e4, 1, 254))
    return _Message(
        time_boot_ms & 0xFFFFFFFF,
        minimum_cm,
        stream.max_distance_cm,
        current_cm,
        stream.type,
        stream.id,
        stream.orientation.value,
        covariance,
        field_of_view_rad,
        field_of_view_rad,
        stream.orientation.quaternion,
        quality,
    )
