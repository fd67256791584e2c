"""What a sensor was found to do otherwise than its model, and its text for the pilot."""

from typing import Literal, NamedTuple

Kind = Literal["short", "missed", "wider", "shifted", "repeats"]

LONGEST_TEXT = 50
"""Characters of a STATUSTEXT. A sensor's name may have 32 of them, which leaves 10."""
MOST_TIMES = 99.0
"""Larger ratios are shown as this one."""


class SensorFinding(NamedTuple):
    """What a sensor does otherwise than its model.

    Attributes
    ----------
    sensor, kind
        Which sensor, and which alternative.
    size
        Times as often, or deviation over the model's; of a shift the distance [m], positive for too long.

    Examples
    --------
    >>> SensorFinding("front_left", "short", 5.2).text
    'Range front_left: 5x expected short readings'
    """

    sensor: str
    kind: Kind
    size: float

    @property
    def text(self) -> str:
        """For the pilot, in at most 50 characters."""
        times, shift_cm = f"{min(self.size, MOST_TIMES):.0f}x", 100.0 * self.size
        full, brief = {
            "short": (f"{times} expected short readings", f"{times} short"),
            "missed": (f"{times} expected missed echoes", f"{times} missed"),
            "wider": (f"{min(self.size, MOST_TIMES):.1f}x expected scatter", f"{times} wide"),
            "shifted": (f"{abs(shift_cm):.0f} cm too {'long' if shift_cm > 0.0 else 'short'}", f"{shift_cm:+.0f} cm"),
            "repeats": ("repeats old readings", "repeats"),
        }[self.kind]
        text = f"Range {self.sensor}: {full}"
        return text if len(text) <= LONGEST_TEXT else f"Range {self.sensor}: {brief}"
