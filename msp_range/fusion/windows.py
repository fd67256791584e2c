"""How long what a sensor saw counts, from how often it is read.

Each duration is a number of turns (from a sensor's reading to its next one) or of gaps (from any downward sensor's
reading to the next one's), computed from the airframe's polling order, so that one sensor at 20 Hz and eight sensors at
2 s each keep the same number of readings in view. None is shorter than with four sensors 100 ms apart, for which
the times were chosen: more readings in the same time only make them surer.
"""

SHORTEST_TURN_S, SHORTEST_GAP_S = 0.4, 0.1
"""Windows are at least those of four sensors 100 ms apart [s]. Shorter ones would forget the ground between two
readings of a vehicle that pings faster near the ground, and gain nothing."""


class Windows:
    """Durations that follow the polling [s].

    Parameters
    ----------
    turn_s
        From a sensor's reading to its next one, at the airframe's usual spacing.
    gap_s
        The longest time between readings of any two downward sensors in turn.

    Attributes
    ----------
    turn_s, gap_s
        As given.
    fresh_s
        A sensor's newest reading is current for this long: a turn, and half of one for a reading that is late.
    held_s
        A sensor that saw the ground counts for it this long, over one missed reading and one outlier.
    memory_s
        Ground, objects and filter states that no reading has confirmed for this long are forgotten.
    newest_s
        A distance goes out only while the ground has been seen within this time: two gaps, and half of one.
    silence_s
        Nothing usable sent for so long is reported: two turns, never less than a second, and a little sooner.
    """

    def __init__(self, turn_s: float = SHORTEST_TURN_S, gap_s: float = SHORTEST_GAP_S) -> None:
        self.turn_s, self.gap_s = turn_s, gap_s
        turn_s, gap_s = max(turn_s, SHORTEST_TURN_S), max(gap_s, SHORTEST_GAP_S)
        self.fresh_s = 1.6 * turn_s
        self.held_s = 3.1 * turn_s
        self.memory_s = 3.75 * turn_s
        self.newest_s = 2.5 * gap_s
        self.silence_s = 0.95 * max(1.0, 2.0 * self.turn_s)
