"""One reading with a range, and what it is over a ground: expected, longer by so much, and the height by it."""

from typing import NamedTuple

from msp_range.fusion.ground_filter import GroundFilter
from msp_range.fusion.modes import SensorMode
from msp_range.fusion.mounting import TurnedSensor, View
from msp_range.reading import Reading, Status


class Seen(NamedTuple):
    """A reading over some ground: what was expected, how much longer it was, and the height by it [m]."""

    view: View
    innovation_m: float
    height_m: float


class Look(NamedTuple):
    """A reading with a range: whose, with what variance of its error [m^2], and where that sensor was and looked."""

    mode: SensorMode
    reading: Reading
    range_m: float
    variance_m2: float
    turned: TurnedSensor

    def over(self, known: GroundFilter | None) -> Seen | None:
        """The reading over a known ground, or over any level; None where the sensor looks past it."""
        plane = (0.0, 0.0, 0.0) if known is None else (known.height_m, known.rise_north, known.rise_east)
        view = self.turned.view(*plane)
        if view is None:
            return None
        innovation_m = self.range_m - view.expected_m
        return Seen(view, innovation_m, plane[0] + innovation_m / view.by_height)

    @property
    def is_least(self) -> bool:
        """Whether the answer stands for this range or less, as on the ground."""
        return self.reading.status is Status.AT_MINIMUM

    @property
    def by_raw_m(self) -> float:
        """What one step of the raw answer is [m]."""
        return self.range_m / self.reading.raw if self.reading.raw else 1.0

    def garbled_words(self, raw: float) -> tuple[int, ...]:
        """Answers that bytes lost on the bus would make this one of."""
        return self.mode.mounted.garbled_from(int(raw))

    def garbled_m(self, seen: Seen) -> list[float]:
        """How much higher the vehicle would be, were the answer garbled on the bus [m]."""
        words = self.garbled_words(self.reading.raw) if self.reading.raw else ()
        return [(word * self.by_raw_m - self.range_m) / seen.view.by_height for word in words]
