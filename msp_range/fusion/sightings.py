"""What each sensor sees, against the ground that all of them make up: ground, something nearer, something farther.

A reading that fits the plane is ground. One that does not is set aside; what is aside is judged together. Where more
sensors agree on another height than still see the old ground, the ground has a step. Where one sensor keeps seeing
the same thing beside the ground of the others, that is an object below it, or a hole. A single wild reading is neither.
"""

from collections import deque
from collections.abc import Collection
from statistics import median

WINDOW_S = 0.65
"""What a sensor saw longer ago than this has no vote [s]: a round of four sensors at ten readings a second, and half
of one."""
HELD_S = 1.1
"""A sensor that saw the ground keeps its vote for it this long [s], unless it agrees with the others: a round more, so
that one wild or missed reading of it does not make a box below two others the ground."""
AGREE_M = 0.12
"""Readings of different sensors that are this close, moved to one time and place, see the same ground [m]."""
LEAVING_M_S = 2.0
"""Readings of two sensors that move on may differ by as much as the vehicle climbs between them [m/s]."""
LEAVING_M = 0.5
"""What moves away from the ground that stuck sensors hold is first seen no farther from it than this [m]."""
OBJECT_M = 0.12
"""Less than this above or below the ground is not told [m]."""
CLOSE_M, NEAR_M = 0.06, 0.08
"""Two readings in a row this close to each other show an object [m]; two of three need only be this near, where none
of the three saw the ground."""
READINGS_TO_LOSE_IT = 2
"""Readings of the ground in a row after which an object is gone."""
FORGOTTEN_S = 1.5
"""What a sensor has not seen for this long is no longer told [s]."""


class Sight:
    """One sensor's newest view.

    Attributes
    ----------
    seen_s
        Time of its last reading with a range [s].
    ground_s
        Time at which it last saw the ground [s].
    off_m
        How much farther than the ground that was [m]; None where it was the ground.
    repeated
        Whether it has given the same answer for long: where others move on, it has no say.
    object_m
        Height of what it sees above the ground, negative for a hole [m]; None: it sees the ground, or nothing.
    """

    __slots__ = ("_aside", "_on_ground", "ground_s", "object_m", "off_m", "repeated", "seen_s")

    def __init__(self) -> None:
        self.seen_s = self.ground_s = float("-inf")
        self.off_m: float | None = None
        self.repeated = False
        self.object_m: float | None = None
        self._aside: deque[float | None] = deque(maxlen=3)
        self._on_ground = 0

    def ground(self, time_s: float) -> None:
        """It saw the ground."""
        self.seen_s, self.ground_s, self.off_m = time_s, time_s, None
        self._aside.clear()
        self._on_ground += 1
        if self._on_ground >= READINGS_TO_LOSE_IT:
            self.object_m = None

    def nothing(self, time_s: float) -> None:
        """Its reading had no range, or none to be believed."""
        self._aside.append(None)
        if time_s - self.seen_s > FORGOTTEN_S:
            self.object_m = None

    def aside(self, time_s: float, off_m: float, told: bool) -> None:
        """It saw something ``off_m`` farther than the ground; ``told``: the others see the ground well enough."""
        self.seen_s, self.off_m, self._on_ground = time_s, off_m, 0
        earlier = list(self._aside)
        self._aside.append(off_m)
        if not told or abs(off_m) < OBJECT_M:
            return
        if self.object_m is not None:
            if self.is_object(off_m):
                self.object_m += (-off_m - self.object_m) / 2
            return
        for i, before_m in enumerate(reversed(earlier)):
            close_m = CLOSE_M if i == 0 and len(earlier) < 2 else NEAR_M
            if before_m is not None and abs(off_m - before_m) < close_m:
                self.object_m = -(off_m + before_m) / 2
                return

    def is_object(self, off_m: float) -> bool:
        """Whether a reading so much farther than the ground is of the object that is known."""
        return self.object_m is not None and abs(off_m + self.object_m) < AGREE_M

    def moved(self, by_m: float) -> None:
        """The ground is now taken to be ``by_m`` lower than before."""
        self._aside.clear()
        if self.off_m is not None:
            self.off_m -= by_m
            self.ground_s = float("-inf")
            if abs(self.off_m) < AGREE_M:
                self.ground_s, self.off_m, self.object_m = self.seen_s, None, None
        else:
            self.ground_s, self.off_m = float("-inf"), -by_m


def step_m(newest: Sight, sights: Collection[Sight], time_s: float) -> float | None:
    """How much lower the ground is by the sensors that agree with the newest reading; None where they are too few.

    More sensors must see it than still see the old ground, and two at least. Sensors that repeat themselves are not
    counted: where they alone hold the old ground, they may be stuck, and the others may be climbing.
    """
    if newest.off_m is None:
        return None
    recent = [sight for sight in sights if time_s - sight.seen_s <= WINDOW_S]
    held = [sight for sight in recent if sight.off_m is None]
    moving = bool(held) and all(sight.repeated for sight in held) and abs(newest.off_m) < LEAVING_M
    speed_m_s = LEAVING_M_S if moving else 0.0
    agreeing = [
        sight
        for sight in recent
        if sight.off_m is not None
        and abs(sight.off_m - newest.off_m) < AGREE_M + speed_m_s * (newest.seen_s - sight.seen_s)
    ]
    agree = [sight.off_m for sight in agreeing if sight.off_m is not None]
    old = [
        sight for sight in sights if time_s - sight.ground_s <= HELD_S and not sight.repeated and sight not in agreeing
    ]
    if len(agree) < 2 or len(agree) <= len(old):
        return None
    if len(agree) == 2 and old and abs(agree[0] - agree[1]) > CLOSE_M:
        return None  # Two of three, which two wild readings can be as well: they must agree closely.
    return newest.off_m if moving else median(agree)
