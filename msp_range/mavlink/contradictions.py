"""Whether an autopilot's messages contradict each other, because two autopilots send with the same ids.

Times since boot go back where two boots take turns. Attitudes jump and jump back by more than the vehicle can have
turned meanwhile, also where both autopilots were switched on together.
"""

import math
from typing import Any, NamedTuple

from msp_range.geometry import Vector, angle_between, down_axis
from msp_range.mavlink.time_sync import LATEST_ARRIVAL_S, shortest

TILT_RAD = math.radians(15.0)
"""Two attitudes of one vehicle differ by less than this on top of what their rates explain [rad]. Smaller takes hard
manoeuvres between slow attitudes for two vehicles, larger misses two that hover side by side in wind."""
RATE_FACTOR = 2.0
"""Between two attitudes a vehicle turns at most this many times as fast as at the faster one of them."""

_TIMES = {
    **dict.fromkeys(("ATTITUDE", "SCALED_PRESSURE", "SYSTEM_TIME"), ("time_boot_ms", 1e-3)),
    **dict.fromkeys(("HIGHRES_IMU", "RAW_IMU"), ("time_usec", 1e-6)),
}
"""Messages that the bridge uses: their field with the time since boot, and its unit [s]."""


class _Attitude(NamedTuple):
    """Where down is, the fastest rotation [rad/s], and the time [s] of one attitude."""

    down: Vector
    rate_rad_s: float
    time_s: float

    def fits(self, other: "_Attitude") -> bool:
        """Whether one vehicle can have had both."""
        rate_rad_s = max(self.rate_rad_s, other.rate_rad_s)
        turned_rad = RATE_FACTOR * rate_rad_s * abs(self.time_s - other.time_s)
        return angle_between(self.down, other.down) < TILT_RAD + turned_rad


class Contradictions:
    """The newest times and attitudes with one autopilot's ids."""

    _newest: _Attitude | None = None
    _other: _Attitude | None = None

    def __init__(self) -> None:
        self._times_s: dict[str, float] = {}

    def update(self, message: Any) -> bool:
        """Whether a message contradicts those before it."""
        kind = message.msgname
        if kind not in _TIMES:
            return False
        field, unit_s = _TIMES[kind]
        time_s = getattr(message, field) * unit_s
        before_s, self._times_s[kind] = self._times_s.get(kind, time_s), time_s
        jumps_back = kind == "ATTITUDE" and self._jumps_back(message, time_s)
        return jumps_back or shortest(time_s - before_s) < -LATEST_ARRIVAL_S

    def _jumps_back(self, message: Any, time_s: float) -> bool:
        """Whether an attitude fits the one before the newest, and not that one."""
        rate_rad_s = abs(message.rollspeed) + abs(message.pitchspeed)
        if not math.isfinite(message.roll + message.pitch + rate_rad_s):
            return False
        attitude = _Attitude(down_axis(message.roll, message.pitch), rate_rad_s, time_s)
        if self._newest is None or attitude.fits(self._newest):
            self._newest = attitude
            return False
        other, self._newest, self._other = self._other, attitude, self._newest
        return other is not None and attitude.fits(other)
