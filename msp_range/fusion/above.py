"""Whether the vehicle is above its sensors' range, or they miss a ground that is near.

'Above the maximum' is an answer that an autopilot believes, so it is given only where the vehicle can be there: where
it may have climbed so far since the ground was last seen, or, where no ground was ever seen, where all sensors have had
no echo for some turns. Sensors that lean away from the ground get no echo at any height: then it must have climbed so
far for sure.
"""

from msp_range.fusion.modes import ABOVE_CODES, ABOVE_MARGIN_M, ABOVE_RANGES, ABOVE_SIGMAS, ABOVE_TURNS
from msp_range.fusion.vertical import Climb, Known, VerticalMotion
from msp_range.numbers import limited

ACCELERATION_M_S2, FASTEST_M_S = 2.0, 5.0
"""How fast a vehicle without a barometer may have begun to climb [m/s^2], and the fastest that it may climb [m/s].
Larger says 'above the maximum' sooner over ground without an echo, smaller is silent longer after a climb through the
maximum."""


class AboveMaximum:
    """Decides at each reading whether the vehicle is above its sensors' range.

    Parameters
    ----------
    maximum_m
        The longest distance that the sensors can measure [m]; also an attribute, which follows the air.
    motion
        How the vehicle moves by its barometer.
    """

    def __init__(self, maximum_m: float, motion: VerticalMotion) -> None:
        self.maximum_m = maximum_m
        self._motion = motion
        self._no_echo: dict[str, int] = {}
        self._ranges = self._codes = 0
        self._leans = self._was_above = False
        self._last: Known | None = None

    def update(self, sensor: str, no_echo: bool, works: bool, faces: bool) -> None:
        """Count readings in a row: each sensor's without an echo, and all that have a range; faults do not count.

        ``faces``: whether level ground at the maximum would give this sensor an echo, as the vehicle leans.
        """
        self._leans = not faces
        if works:
            self._codes = 0
            self._no_echo[sensor] = self._no_echo.get(sensor, 0) + 1 if no_echo else 0
            self._ranges = 0 if no_echo else self._ranges + 1
        else:
            self._no_echo.pop(sensor, None)

    def update_with_code(self) -> None:
        """Count a reading that is a range or no echo, nobody knows which."""
        self._codes += 1

    def on_ground_seen(self, known: Known) -> None:
        """The ground is seen: from here the vehicle climbs or does not."""
        self._last, self._was_above = known, False

    def decide(self, now_s: float) -> bool:
        """Whether the vehicle is above the maximum: most working sensors have no echo, and it may have got there."""
        counts = self._no_echo.values()
        silent = sum([count > 0 for count in counts])
        if not silent or 2 * silent <= len(counts) or self._ranges >= ABOVE_RANGES or self._codes >= ABOVE_CODES:
            return False
        if self._last is None:
            if min(counts) < ABOVE_TURNS or self._leans:
                return False
            self._last = Known(now_s, self.maximum_m, self.maximum_m, 0.0, self._motion.mark(now_s))
        climb = self._motion.climbed(self._last.mark, now_s)
        if self._leans and climb is not None:
            lowest_m = self._last.range_m + climb.height_m - ABOVE_SIGMAS * climb.std_m
            self._was_above = lowest_m >= self.maximum_m
        elif not self._leans:
            self._was_above = self._reachable(self._last, climb, now_s)
        return self._was_above

    def _reachable(self, last: Known, climb: Climb | None, now_s: float) -> bool:
        elapsed_s = now_s - last.time_s
        if climb is not None:
            highest_m = climb.height_m + ABOVE_SIGMAS * climb.std_m
        else:
            rate_m_s = limited(last.climb_m_s, 0.0, FASTEST_M_S)
            speeding_s = min((FASTEST_M_S - rate_m_s) / ACCELERATION_M_S2, elapsed_s)
            highest_m = rate_m_s * speeding_s + 0.5 * ACCELERATION_M_S2 * speeding_s**2
            highest_m += FASTEST_M_S * (elapsed_s - speeding_s)
        return last.range_m + highest_m >= self.maximum_m - ABOVE_MARGIN_M
