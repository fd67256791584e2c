"""How long what a sensor saw counts, from how often it is read.

The airframe's polling order enters, durations leave. Each is a number of turns (from a sensor's reading to its next
one) or of gaps (from any downward sensor's reading to the next one's), so that one sensor at 20 Hz and eight sensors at
2 s each keep the same number of readings in view. None is shorter than with four sensors 100 ms apart, for which the
votes were designed: more readings in the same time only make them surer.
"""

from dataclasses import dataclass

SHORTEST_TURN_S, SHORTEST_GAP_S = 0.4, 0.1
"""Windows are at least those of four sensors 100 ms apart [s]. Shorter ones would forget the ground between two
readings of a vehicle that pings faster near the ground, and gain nothing."""


@dataclass(frozen=True, slots=True)
class Windows:
    """Durations that follow the polling [s].

    Attributes
    ----------
    turn_s
        From a sensor's reading to its next one, at the airframe's usual spacing.
    gap_s
        The longest time between readings of any two downward sensors in turn.
    """

    turn_s: float = SHORTEST_TURN_S
    gap_s: float = SHORTEST_GAP_S

    @property
    def fresh_s(self) -> float:
        """A sensor's newest reading is current for this long: a turn, and half of one for a reading that is late."""
        return 1.6 * max(self.turn_s, SHORTEST_TURN_S)

    @property
    def held_s(self) -> float:
        """A sensor that saw the ground keeps its vote for it this long, over one missed reading and one outlier."""
        return 3.1 * max(self.turn_s, SHORTEST_TURN_S)

    @property
    def memory_s(self) -> float:
        """Ground, objects and filter states that no reading has confirmed for this long are forgotten."""
        return 3.75 * max(self.turn_s, SHORTEST_TURN_S)

    @property
    def newest_s(self) -> float:
        """A distance goes out only while the ground has been seen within this time: two gaps, and half of one."""
        return 2.5 * max(self.gap_s, SHORTEST_GAP_S)

    @property
    def lost_s(self) -> float:
        """Where no reading was of the ground for this long, readings that agree may make a new one: three gaps."""
        return 3.5 * max(self.gap_s, SHORTEST_GAP_S)

    @property
    def silence_s(self) -> float:
        """Nothing usable sent for so long is reported: two turns, never less than a second, and a little sooner."""
        return 0.95 * max(1.0, 2.0 * self.turn_s)
