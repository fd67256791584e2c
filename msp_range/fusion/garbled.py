"""Answers that are the ground's with a byte lost or mixed up on the bus.

A reading that does not fit the ground enters with the answers that such a fault could have made it of; how far the best
of them is from the ground leaves, where that is close enough to believe it. 'Close' is what is known of the ground, and
looser on a bus that has garbled an answer just now.
"""

import math
from collections.abc import Sequence

NEAR_M, SIGMAS, WIDEST_M = 0.04, 3.0, 0.25
"""A reading is the garbled form of the ground's where it is this close to it [m], and so many standard deviations of
what is known of the ground and of the reading, if that is no more than the third in all [m]. Wider takes a roof of just
the wrong height for a fault."""
AGAIN_S, AGAIN_M = 10.0, 0.25
"""On a bus that has garbled an answer within this time [s] another one is garbled, too, where it is this close [m].
Longer keeps a real step of the same height out for longer."""
STD_M = 0.05
"""How far a garbled answer is trusted to be that of the ground, standard deviation [m]: it may be a code by itself."""


class GarbledAnswers:
    """Recognises them; knows when the bus garbled the last one."""

    def __init__(self) -> None:
        self._last_s = float("-inf")

    def innovation_m(
        self, time_s: float, answers_m: Sequence[float], expected_m: float, variance_m2: float
    ) -> float | None:
        """How much longer than expected the ungarbled answer is [m]; None where the reading is not garbled.

        Parameters
        ----------
        time_s
            Of the reading [s].
        answers_m
            Ranges that it would have been without the fault [m].
        expected_m, variance_m2
            Range over the known ground [m], and the variance of what the reading is off from it [m^2].
        """
        if not answers_m:
            return None
        off_m = min([answer_m - expected_m for answer_m in answers_m], key=abs)
        near_m = NEAR_M + SIGMAS * math.sqrt(variance_m2)
        again = time_s - self._last_s < AGAIN_S and abs(off_m) < AGAIN_M
        if not again and not abs(off_m) < near_m < WIDEST_M:
            return None
        self._last_s = time_s
        return off_m
