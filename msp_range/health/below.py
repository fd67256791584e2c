"""Objects and holes below single sensors, as observations that the pilot gets: nothing is wrong with the vehicle."""

from msp_range.health.conditions import Report, Severity


class ObservationsBelow:
    """What all sensors have below them, reported when it comes and when it goes.

    Parameters
    ----------
    report
        Called with (severity, text) at each change.
    """

    def __init__(self, report: Report) -> None:
        self._report = report
        # Height over the ground, negative in a hole [m], and the text.
        self._of: dict[str, tuple[float, str]] = {}

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
            what = "ground below" if sees_ground else f"{'object' if height_m > 0 else 'hole'} not seen now"
            self._report(Severity.INFO, f"Range {sensor}: {what}")
            return
        text = f"Range {sensor}: hole below, {-object_m:.1f} m deep"
        if object_m > 0:
            text = f"Range {sensor}: object below, {object_m:.1f} m high"
        elif is_ground_in_doubt:
            text = f"Range {sensor} {-object_m:.1f} m longer: garbled?"
        self._of[sensor] = object_m, text
        self._report(Severity.WARNING, text)

    def texts(self) -> list[tuple[Severity, str]]:
        """All that is there now, for an autopilot that has just come."""
        return [(Severity.WARNING, text) for _, text in self._of.values()]
