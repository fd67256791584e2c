"""What measured places of the sensors mean for the airframe file, by hand or in flight."""

from collections.abc import Sequence
from itertools import combinations

from msp_range.commission.edit import Edit
from msp_range.commission.motion import Measured, Places
from msp_range.commission.outcome import StepOutcome, shown
from msp_range.config import Airframe
from msp_range.doctor.finding import UNKNOWN

SIDEWAYS_M, DEEPER_M = 0.05, 0.02
"""A place in the file that differs by less [m], sideways or in height, stays. An error of 5 cm sideways costs 1 cm at
10 degrees; in height tape, floor and sensor are not better."""
WIDEST_M = 0.10
"""Wider intervals [m] do not check a place: the vehicle was hardly tilted."""

LATE_S = 0.10
"""Attitudes that are later than this [s] are reported, where that is known as well: at 20 deg/s a sensor 0.25 m away is
1 cm off. In a calm hover the readings show little of it, and an interval that is wider than this is not its error."""


def compare_places(airframe: Airframe, found: Places, outcome: StepOutcome, dim: Sequence[str] = ()) -> None:
    """Add what the measured places mean for the airframe file, but for sensors that see little of the floor."""
    mirrored: dict[int, list[str]] = {0: [], 1: []}
    for i, sensor in enumerate(airframe.sensors):
        measured = found.position_m.get(sensor.name)
        if measured is None:
            continue
        if sensor.name in dim:
            text = "it looks aside and sees little of the floor"
            outcome.unknown(f"place of {sensor.name}", text, "turn it, then: --step lift")
            continue
        edits, parts = [], []
        for axis, (name, each, in_file) in enumerate(zip(("x", "y", "z"), measured, sensor.position_m, strict=True)):
            if each.half_width > WIDEST_M:
                text = f"{name} {shown(each)} is not known well enough"
                remedy = "rock it by 15 to 20 degrees to all sides, slowly, 1 m over the floor"
                outcome.unknown(f"place of {sensor.name}", text, remedy)
                outcome.complete = False
                continue
            if not each.differs_from(in_file, DEEPER_M if axis == 2 else SIDEWAYS_M):
                continue
            is_mirrored = axis < 2 and abs(each.value + in_file) <= max(each.half_width, SIDEWAYS_M)
            if is_mirrored:
                mirrored[axis].append(sensor.name)
            value = -in_file if is_mirrored else round(each.value, 2)
            edits.append(Edit(("sensors", i, "position_m", axis), value))
            parts.append(f"{name} {shown(each)}, {in_file:g} in the file{': wrong sign' if is_mirrored else ''}")
        if edits:
            outcome.propose(f"{sensor.name}: {'; '.join(parts)}", *edits)
        else:
            at = ", ".join(f"{each.value:.2f}" for each in measured)
            widest = max(each.half_width for each in measured)
            outcome.right(f"place of {sensor.name}", f"[{at}] m, each to {widest:.2f}, as in the file")
    for axis, (letter, meaning) in enumerate((("x", "forward"), ("y", "to the right"))):
        of_axis = [sensor.name for sensor in airframe.sensors if abs(sensor.position_m[axis]) > SIDEWAYS_M]
        if len(of_axis) > 1 and set(of_axis) == set(mirrored[axis]):
            text = f"every {letter} in the file has the wrong sign: positions count {meaning}"
            outcome.unknown("places", text, "the changes below turn them round")
    _exchanged(airframe, found, outcome)


def _exchanged(airframe: Airframe, found: Places, outcome: StepOutcome) -> None:
    """Report two sensors that sit at each other's place."""
    places_m = {sensor.name: sensor.position_m for sensor in airframe.sensors}

    def sits_at(name: str, other: str) -> bool:
        measured = found.position_m.get(name)
        return measured is not None and all(
            abs(each.value - there) <= max(each.half_width, SIDEWAYS_M)
            for each, there in zip(measured, places_m[other], strict=True)
        )

    for one, other in combinations(places_m, 2):
        apart = max(abs(a - b) for a, b in zip(places_m[one], places_m[other], strict=True))
        if apart > 2 * SIDEWAYS_M and sits_at(one, other) and sits_at(other, one):
            text = f"{one} and {other} sit at each other's place"
            outcome.unknown(
                "places",
                text,
                f"if their addresses are exchanged: msp-range commission {airframe.path} --step addresses",
            )


def compare_lag(found: Places, outcome: StepOutcome) -> None:
    """Add whether the attitudes come in time."""
    lag = Measured(1e3 * found.lag.value, 1e3 * found.lag.half_width)
    outcome.measured["attitude_later_s"] = round(found.lag.value, 3)
    text = f"the attitude is {shown(lag, 'ms', 0)} later than the readings"
    is_known = found.lag.half_width < LATE_S
    remedy = "does the autopilot answer TIMESYNC, and is the link slow or shared? A distance is off while it turns"
    outcome.add(
        "delay of the attitude",
        (is_known and found.lag.value > LATE_S, text, remedy),
        (is_known, text),
        (True, f"{text}: not known well enough, as it hardly tilted", None, UNKNOWN),
    )
