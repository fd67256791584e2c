"""What is below one sensor and is not ground: an object nearer than the ground of the others, or a hole.

A sensor's readings against the ground enter, a height over the ground leaves while three of its last four agree. That
takes three readings, because two outliers agree by chance several times in a day of hovering, and three hardly ever.
"""

from collections import deque

OBJECT_M = 0.12
"""Less than this above or below the ground is not reported [m]: kerbs, grass and the noise of two readings."""
NEAR_M = 0.08
"""Readings of one object lie within this of each other [m]: four times a reading's noise."""
SAME_M = 0.12
"""A reading this close to a known object is of it [m]: what moves below the vehicle has no flat top."""
READINGS_OF_AN_OBJECT, OF_THE_LAST = 3, 4
"""So many of a sensor's last readings must agree on an object. Two of three would find it a reading sooner, and ten
times a day where there is none."""
READINGS_TO_LOSE_IT = 2
"""Readings of the ground in a row after which an object is gone."""


class Below:
    """What one sensor sees that is not ground.

    Attributes
    ----------
    object_m
        Height over the ground, negative for a hole [m]; None: it sees the ground, or nothing.
    """

    __slots__ = ("_offs", "_on_ground", "_seen_s", "object_m")

    def __init__(self) -> None:
        self.object_m: float | None = None
        self._offs: deque[float | None] = deque(maxlen=OF_THE_LAST)
        self._on_ground = 0
        self._seen_s = float("-inf")

    def ground(self, time_s: float) -> None:
        """The sensor saw the ground."""
        self._seen_s = time_s
        self._offs.append(None)
        self._on_ground += 1
        if self._on_ground >= READINGS_TO_LOSE_IT:
            self.object_m = None

    def nothing(self, time_s: float, memory_s: float) -> None:
        """The sensor's reading had no range, or none to be believed."""
        self._offs.append(None)
        if time_s - self._seen_s > memory_s:
            self.object_m = None

    def off(self, time_s: float, off_m: float, ground_is_seen: bool) -> None:
        """The sensor saw something ``off_m`` farther than the ground, which the others see, or do not see."""
        self._seen_s, self._on_ground = time_s, 0
        self._offs.append(off_m)
        if not ground_is_seen or abs(off_m) < OBJECT_M:
            return
        if self.object_m is not None:
            if self.is_object(off_m):
                self.object_m += (-off_m - self.object_m) / 2
            return
        near = [other_m for other_m in self._offs if other_m is not None and abs(other_m - off_m) < NEAR_M]
        if len(near) >= READINGS_OF_AN_OBJECT:
            self.object_m = -sum(near) / len(near)

    def is_object(self, off_m: float) -> bool:
        """Whether a reading so much farther than the ground is of the object that is known."""
        return self.object_m is not None and abs(off_m + self.object_m) < SAME_M

    def clear(self) -> None:
        """Know of nothing below."""
        self._offs.clear()
        self.object_m = None

    def move(self, by_m: float) -> None:
        """The ground is now taken to be ``by_m`` lower than before: what was below is to be seen anew."""
        self._offs.clear()
        if self.object_m is not None:
            self.object_m += by_m
            if abs(self.object_m) < OBJECT_M:
                self.object_m = None
