"""Whether the autopilot receives the distances, and whether its estimator follows them, by the messages that it sends.

ArduPilot reports the distance and the health of its range finder, and the ratio of the innovation to its limit only
with optical flow, or where `EK3_RNG_USE_HGT` makes range its source of height, which is while it takes off or lands;
that ratio is the last one from before (`NavEKF3_core::send_status_report`, `EstimateTerrainOffset`). PX4 reports its
height above the ground, and that ratio where range gives it its terrain (`EKF2.cpp`, `streams/ALTITUDE.hpp`). What is
not reported is shown to be so, and nothing is inferred from it.
"""

import math
from collections import deque
from typing import Any, NamedTuple

from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.distance_sensor import Autopilot
from msp_range.mavlink.orientation import DOWN
from msp_range.pilot_texts import Condition, Text

ACCEPTANCE_RATES: dict[Autopilot, dict[str, float]] = {
    "ardupilot": {"DISTANCE_SENSOR": 2.0, "SYS_STATUS": 2.0, "EKF_STATUS_REPORT": 2.0},
    "px4": {"DISTANCE_SENSOR": 2.0, "SYS_STATUS": 1.0, "ESTIMATOR_STATUS": 2.0, "ALTITUDE": 4.0},
}
"""Requested rates [Hz] by message: an estimator that does not follow is reported within 2 s. Watchers get the first two
unchanged."""
LAG_S = 1.0
"""The autopilot's height is one that was sent in this time, or between two of them [s]. Longer reports an offset later,
shorter mistakes the autopilot's own delay in a climb for one."""
OLD_S = 3.0
"""A message that is older does not count [s]: three of the slowest."""
MISSING_S = 4.0
"""Distances that have gone out for this long [s] without one of the autopilot's own are not received: a message has to
be asked for, and asked for again if the request is lost. Shorter takes a slow link for a wrong parameter."""
RETURNED_M = 0.15
"""What an autopilot reports as received may differ from what was sent by this [m]: whole centimetres, and a vehicle
that moves between two of its messages."""
OFF_M = 0.5
"""A height above ground that differs more from the distances is off [m]. Smaller counts sensors far below the
autopilot's own place (`EKF2_RNG_POS_Z`), larger leaves a box unseen that the estimator rejects."""
RESET_SHOWN_S = 10.0
"""How long a terrain that was set anew is mentioned [s]: long enough to be read."""
OTHER_FIRST = "is another range finder set up as the first one? See RNGFND1_TYPE, RNGFND1_ORIENT"
"""What to do where the autopilot has another distance than the bridge."""
PARAMETERS = "{}; msp-range params shows its parameters, and --write sets them"
_RANGE_FINDER: int = dialect.MAV_SYS_STATUS_SENSOR_LASER_POSITION
"""Of range finders of any kind; ArduPilot has it for one that looks down."""


class Acceptance(NamedTuple):
    """What is known now; a number that is not reported is None."""

    text: str
    """For a person."""
    problem: Condition = Text.NOT_RECEIVED.when(False)
    """What is wrong, if anything is."""
    received_m: float | None = None
    """The distance that the autopilot says it has [m]."""
    height_m: float | None = None
    """Its estimator's height above the ground [m]."""
    off_m: float | None = None
    """How much larger that is than what was sent [m]; 0 within what was sent in `LAG_S`."""
    ratio: float | None = None
    """Innovation over its limit: from 1 on the estimator rejects distances."""

    @property
    def numbers(self) -> dict[str, float]:
        """Those that are reported, by name."""
        return {name: value for name, value in self._asdict().items() if isinstance(value, float)}


class _Sent(NamedTuple):
    """When a distance went out [s], the distance, and the same straight down [m]; infinite: above the maximum."""

    time_s: float
    range_m: float
    down_m: float


class AcceptanceWatch:
    """Compares an autopilot's messages with the downward distances that it was sent.

    Parameters
    ----------
    autopilot
        Which one it is.
    """

    _matched_s = _sending_s = _reset_s = float("-inf")
    _off_m = _reset_m = _terrain_m = math.nan

    def __init__(self, autopilot: Autopilot) -> None:
        self._autopilot = autopilot
        self._sent: deque[_Sent] = deque()
        self._newest: dict[str, tuple[float, Any]] = {}

    def on_sent(self, now_s: float, message: Any, cos_lean: float) -> None:
        """Note a DISTANCE_SENSOR that went out; ``cos_lean`` is that of the angle between down axis and plumb line."""
        if message.orientation != DOWN:
            return
        if not self._sent or now_s - self._sent[-1].time_s > LAG_S:
            self._sending_s = now_s
        is_range = message.current_distance <= message.max_distance
        range_m = message.current_distance / 100 if is_range else math.inf
        self._sent.append(_Sent(now_s, range_m, range_m * cos_lean))
        self._forget(now_s)

    def on_message(self, now_s: float, message: Any) -> None:
        """Note a message of the autopilot."""
        kind = message.msgname
        if kind not in ACCEPTANCE_RATES[self._autopilot] or (kind == "DISTANCE_SENSOR" and message.orientation != DOWN):
            return
        # Where EKF2 rejects distances its height comes and goes: the last one counts until it is old.
        if kind == "ALTITUDE" and not math.isfinite(message.bottom_clearance):
            return
        known_s, known = self._newest.get(kind, (-math.inf, None))
        if kind == "DISTANCE_SENSOR" and now_s - known_s < OLD_S and not is_first(known, message):
            return
        self._newest[kind] = now_s, message
        self._forget(now_s)
        if kind == "ALTITUDE":
            self._on_height(now_s, message)
        elif kind == "DISTANCE_SENSOR":
            beyond_m = _beyond([each.range_m for each in self._sent], message.current_distance / 100)
            if not abs(beyond_m) > RETURNED_M:  # Where nothing was sent it counts as the same.
                self._matched_s = now_s

    def _forget(self, now_s: float) -> None:
        """Distances that were sent before `LAG_S` are compared with nothing any more."""
        while self._sent and now_s - self._sent[0].time_s > LAG_S:
            self._sent.popleft()

    def _on_height(self, now_s: float, message: Any) -> None:
        """Compare the estimator's height with the distances, and notice when it takes them for a new terrain."""
        before_m, self._off_m = self._off_m, _beyond([each.down_m for each in self._sent], message.bottom_clearance)
        moved_m, self._terrain_m = message.altitude_terrain - self._terrain_m, message.altitude_terrain
        if abs(before_m) > OFF_M >= abs(self._off_m) and abs(moved_m) > abs(before_m) / 2:
            self._reset_s, self._reset_m = now_s, moved_m

    def now(self, now_s: float) -> Acceptance:
        """What the autopilot makes of the distances now."""
        if not self._sent or now_s - self._sent[-1].time_s > LAG_S:
            return Acceptance("is sent nothing now")
        newest = {kind: message for kind, (time_s, message) in self._newest.items() if now_s - time_s < OLD_S}
        own, status = newest.get("DISTANCE_SENSOR"), newest.get("SYS_STATUS")
        estimator = newest.get("ESTIMATOR_STATUS") or newest.get("EKF_STATUS_REPORT")
        received_m = None if own is None else own.current_distance / 100
        height_m = newest["ALTITUDE"].bottom_clearance if "ALTITUDE" in newest else None
        ratio = None if estimator is None else _ratio(estimator)
        found = Acceptance("", Text.NOT_RECEIVED.when(False), received_m, height_m, None, ratio)
        if height_m is not None:
            return self._followed(now_s, found, height_m)
        is_over = now_s - self._sending_s > MISSING_S
        if own is None:
            why = not_received(self._autopilot, status)
            if not is_over or why is None:
                return found._replace(text="reports nothing of the distances")
            problem = Text.NOT_RECEIVED.when(True)._replace(remedy=PARAMETERS.format(why))
            return found._replace(text=f"does not receive them: {why}", problem=problem)
        text = f"has {received_m:.2f} m"
        if is_over and now_s - self._matched_s > OLD_S:
            problem = Text.OTHER_RANGE.when(True, has_m=received_m)._replace(remedy=PARAMETERS.format(OTHER_FIRST))
            return found._replace(text=f"{text}, which is not what is sent", problem=problem)
        if ratio is not None and ratio >= 1:
            problem = Text.REJECTED.when(True, ratio=ratio)
            return found._replace(text=f"{text}: rejected by its estimator (ratio {ratio:.1f})", problem=problem)
        if self._autopilot == "px4":
            return found._replace(text=f"{text}, but its estimator gives no height above the ground: see EKF2_RNG_CTRL")
        healthy = "" if status is None else ", healthy" if is_healthy(status) else ", not healthy"
        use = "not reported by this autopilot" if ratio is None else f"ratio {ratio:.2f}"
        return found._replace(text=f"{text}{healthy}; its estimator: {use}")

    def _followed(self, now_s: float, found: Acceptance, height_m: float) -> Acceptance:
        """Whether the estimator's height is what was sent; if not, it rejects that.

        Its ratio alone does not say so: EKF2 rejects by the vehicle's motion, too, with a ratio below 1.
        """
        off_m, ratio = self._off_m, found.ratio
        text = f"is {height_m:.2f} m above the ground"
        text += "" if ratio is None else f", ratio {ratio:.2f}"
        if abs(off_m) > OFF_M:
            problem = Text.NOT_FOLLOWED.when(True, off_m=abs(off_m))
            return found._replace(text=f"{text}: {abs(off_m):.1f} m off: rejected", problem=problem, off_m=off_m)
        if now_s - self._reset_s < RESET_SHOWN_S:
            text += f": terrain reset by {self._reset_m:+.1f} m"
        return found._replace(text=text, off_m=_finite(off_m))


def not_received(autopilot: Autopilot, status: Any) -> str | None:
    """Why an autopilot that sends no distance of its own does not receive any; None: it does not say.

    Parameters
    ----------
    status
        Its SYS_STATUS, or None.
    """
    if autopilot == "px4" or status is None:
        return None
    if not status.onboard_control_sensors_present & _RANGE_FINDER:
        return "it has no range finder that looks down (RNGFND1_TYPE 10, RNGFND1_ORIENT 25)"
    return "its downward range finder gets none: RNGFND1_TYPE or RNGFND1_ADDR is another"


def is_first(known: Any, message: Any) -> bool:
    """Whether of two of the autopilot's DISTANCE_SENSOR the second counts: that of its first one which looks down.

    An autopilot with several range finders sends one message for each, with its number as the id. ``known``: the first,
    or None.
    """
    return known is None or known.orientation != DOWN or (message.orientation == DOWN and message.id <= known.id)


def is_healthy(status: Any) -> bool:
    """Whether SYS_STATUS calls the range finder healthy, or has none."""
    return not _RANGE_FINDER & status.onboard_control_sensors_present & ~status.onboard_control_sensors_health


def _ratio(estimator: Any) -> float | None:
    """Innovation over its limit; ArduPilot has 0 where it is not computed, PX4 NaN."""
    if estimator.msgname == "ESTIMATOR_STATUS":
        return _finite(estimator.hagl_ratio)
    return _finite(estimator.terrain_alt_variance) or None


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _beyond(sent_m: list[float], value_m: float) -> float:
    """How much larger a value is than all that was sent, or smaller (negative) [m]; nan: nothing to compare it with."""
    if not sent_m or not all(map(math.isfinite, (value_m, *sent_m))):
        return math.nan
    return value_m - min(max(value_m, min(sent_m)), max(sent_m))
