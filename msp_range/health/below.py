"""Objects and holes below single sensors, as observations that the pilot gets: nothing is wrong with the vehicle."""

from msp_range.pilot_texts import Report, Severity, Text


class ObservationsBelow:
    """What all sensors have below them, reported when it comes and when it goes.

    Parameters
    ----------
    report
        Called with (severity, text) at each change.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        # Height over the ground, negative in a hole [m], and what was reported.
        self._of: dict[str, tuple[float, tuple[Severity, str]]] = {}

    def update(
        self, sensor: str, object_m: float | None, is_ground_in_doubt: bool = False, sees_ground: bool = False
    ) -> None:
        """Report a change: ``object_m`` is the height of what is not ground [m]; None: the ground, or nothing.

        Where the ground is in doubt, a sensor that sees farther than the others may be the only one that is right: as
        well a hole below it as a bus that loses a byte of the others' answers. ``sees_ground``: whether its reading is
        of the ground.
        """
        if (object_m is None) == (sensor not in self._of):
            return
        if object_m is None:
            height_m, _ = self._of.pop(sensor)
            text = Text.GROUND if sees_ground else Text.NOT_SEEN
            self._report(*text.said(sensor=sensor, what="object" if height_m > 0 else "hole"))
            return
        text = Text.OBJECT if object_m > 0 else Text.GARBLED if is_ground_in_doubt else Text.HOLE
        said = text.said(sensor=sensor, high_m=object_m, deep_m=-object_m)
        self._of[sensor] = object_m, said
        self._report(*said)

    def texts(self) -> list[tuple[Severity, str]]:
        """All that is there now, for an autopilot that has just come."""
        return [said for _, said in self._of.values()]
