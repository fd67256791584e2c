"""What a sensor was found to do otherwise than its model, and its text for the pilot."""

from typing import Literal, NamedTuple

Kind = Literal["short", "missed", "wider", "shifted", "repeats"]

LONGEST_TEXT = 50
"""Characters of a STATUSTEXT. A sensor's name may have 32 of them, which leaves 10."""
MOST_TIMES = 99.0
"""Larger ratios are shown as this one."""


class SensorFinding(NamedTuple):
    """What a sensor does otherwise than its model.

    Examples
    --------
    >>> SensorFinding("front_left", "short", 5.2).text
    'Range front_left: often too short, check sensor'
    """

    sensor: str
    kind: Kind
    """Which sensor, and which alternative."""
    size: float
    """How many times as often, or the deviation over the model's; for a shift its distance [m], positive for too
    long."""

    @property
    def text(self) -> str:
        """For the pilot, in at most 50 characters."""
        full, brief, _ = self._words
        texts = [f"Range {self.sensor}: {each}" for each in (f"{full}, check sensor", full, brief)]
        return next((text for text in texts if len(text) <= LONGEST_TEXT), texts[-1])

    @property
    def remedy(self) -> str:
        """By how much, and what to do."""
        return f"{self._words[2]}: clean it, check its mount and wires, and look for what is in its beam"

    @property
    def _words(self) -> tuple[str, str, str]:
        """What it does, the same in ten characters, and by how much."""
        shift_cm, times = 100.0 * self.size, min(self.size, MOST_TIMES)
        cm = f"{abs(shift_cm):.0f} cm too {'long' if shift_cm > 0.0 else 'short'}"
        return {
            "short": ("often too short", "too short", f"too short {times:.0f} times as often as its model says"),
            "missed": ("often no echo", "no echoes", f"no echo {times:.0f} times as often as its model says"),
            "wider": ("unsteady readings", "unsteady", f"scatters {times:.1f} times as much as its model says"),
            "shifted": (cm, f"{shift_cm:+.0f} cm", f"{cm} by the other sensors"),
            "repeats": ("repeats readings", "repeats", "the same answer although the height has changed"),
        }[self.kind]
