"""What one reading means for the fused stream: the distance now, and why the reading was not used where it was not."""

from typing import NamedTuple

from msp_range.reading import Reading, Status

GARBLED, FIXED = Status.GARBLED.value, Status.FIXED.value
OBJECT, OUTLIER, SUSPECT, REPEATED, PAST = "object", "outlier", "suspect", "repeated", "past_the_ground"
"""Why a reading with a range was not used for the ground: it is of an object below its sensor, of nothing that is
known, a fault code away from the ground, the same answer as ever while others see other things, or made past the ground
on a vehicle that leans."""


class Fused(NamedTuple):
    """The distance for the autopilot and what it comes from."""

    range_m: float
    variance_m2: float
    """Distance from the reference point along the body's down axis to the plane of the ground [m], and the variance of
    its error [m^2]."""
    height_m: float
    climb_m_s: float
    rise_north: float
    rise_east: float
    """As in `msp_range.fusion.ground_filter.GroundFilter`."""
    probability: float
    """Probability that this surface is the ground."""

    def record(self, time_s: float) -> dict[str, float]:
        """The message of a recording's ``/fused``."""
        return {"time_s": time_s, **self._asdict()}


class Outcome(NamedTuple):
    """What one reading means for the fused stream."""

    reading: Reading
    """The reading; without its range where the sensor turned out to be stuck or its answer garbled."""
    fused: Fused | None
    """The distance now; None where nothing is known well enough."""
    above_maximum: bool
    """Whether the vehicle is above what its sensors can measure; then there is no distance."""
    rejected: str | None
    """Why the reading was not used for the ground; None where it was."""
