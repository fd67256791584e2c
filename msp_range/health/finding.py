"""What a sensor was found to do otherwise than its model, and its text for the pilot."""

from typing import Literal, NamedTuple

from msp_range.pilot_texts import FINDINGS, LONGEST_TEXT

Kind = Literal["short", "missed", "wider", "shifted", "repeats"]

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
        off = f"{abs(shift_cm):.0f} cm too {'long' if shift_cm > 0.0 else 'short'}"
        full, brief, by_how_much = FINDINGS[self.kind]
        size = {"off": off, "shift_cm": shift_cm, "times": times}
        return full.format(**size), brief.format(**size), by_how_much.format(**size)
