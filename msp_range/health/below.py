"""Objects and holes below single sensors, as observations that the pilot gets: nothing is wrong with the vehicle."""

from typing import Literal, NamedTuple

from msp_range.health.conditions import Report, Severity


class Observation(NamedTuple):
    """What one sensor has below it.

    Attributes
    ----------
    sensor
        Its name.
    kind
        An object, a hole, the ground again, 'unseen': what was there, and then no ground either, or 'doubt': as well a
        hole below this sensor as a bus that loses a byte of the others' answers.
    height_m
        Over the ground, negative in a hole [m].
    """

    sensor: str
    kind: Literal["object", "hole", "ground", "unseen", "doubt"]
    height_m: float

    @property
    def text(self) -> str:
        """For the pilot."""
        if self.kind == "object":
            return f"Range {self.sensor}: object below, {self.height_m:.1f} m high"
        if self.kind == "hole":
            return f"Range {self.sensor}: hole below, {-self.height_m:.1f} m deep"
        if self.kind == "doubt":
            return f"Range {self.sensor} {-self.height_m:.1f} m longer: garbled?"
        if self.kind == "unseen":
            return f"Range {self.sensor}: {'object' if self.height_m > 0 else 'hole'} not seen now"
        return f"Range {self.sensor}: ground below"


class ObservationsBelow:
    """What all sensors have below them, reported when it comes and when it goes.

    Parameters
    ----------
    report
        Called with (severity, text) at each change.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        self._of: dict[str, Observation] = {}

    def update(
        self, sensor: str, object_m: float | None, is_ground_in_doubt: bool = False, sees_ground: bool = False
    ) -> None:
        """Report a change: ``object_m`` is the height of what is not ground [m]; None: the ground, or nothing.

        Where the ground is in doubt, a sensor that sees farther than the others may be the only one that is right.
        ``sees_ground``: whether its reading is of the ground.
        """
        if (object_m is None) == (sensor not in self._of):
            return
        if object_m is None:
            before = self._of.pop(sensor)
            self._report(Severity.INFO, before._replace(kind="ground" if sees_ground else "unseen").text)
        else:
            hole: Literal["hole", "doubt"] = "doubt" if is_ground_in_doubt else "hole"
            self._of[sensor] = Observation(sensor, "object" if object_m > 0 else hole, object_m)
            self._report(Severity.WARNING, self._of[sensor].text)

    def is_object(self, sensor: str) -> bool:
        """Whether an object, and no hole, is below a sensor."""
        return sensor in self._of and self._of[sensor].kind == "object"

    def texts(self) -> list[tuple[Severity, str]]:
        """All that is there now, for an autopilot that has just come."""
        return [(Severity.WARNING, each.text) for each in self._of.values()]
