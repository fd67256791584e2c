"""The air temperature for the speed of sound, with its uncertainty.

`AirTemperature` chooses among the values of the airframe's sources: that of the first source, in the order of trust,
with a new and good value that does not settle; otherwise the best old value, with a standard deviation that grows with
its age; otherwise the airframe's fixed temperature. A source that jumps is used when another source or the raw ranges
confirm it, or after a long steady time. `conditions` returns what is reported to the pilot.
"""

import math
from typing import Any

from msp_range.acoustics.air import FIXED, HELD, Air, air_error_m, coldest_c, compensate_range
from msp_range.correction.humidity import HYGROMETER, Humidity
from msp_range.correction.range_comparison import RangeHistory
from msp_range.correction.temperature import MAVLINK_FIELDS, FileSource, MavlinkSource, TemperatureParameters
from msp_range.correction.temperature_track import BELIEVED_AFTER_S, TemperatureTrack
from msp_range.correction.thermometer import LoopReader
from msp_range.pilot_texts import Condition, Text
from msp_range.reading import Reading, Status

GRACE_S = 5.0
"""Time for which all sources may be silent before it is reported [s]; shorter reports a rebooting autopilot."""
JUMP_REPORTED_S = 2.0
"""A jump that ends sooner is not reported [s]: a single damaged value."""
AGREE_STDS = 2.0
"""Two sources agree if they differ by at most this many standard deviations of their difference. Larger confirms more
jumps, also wrong ones."""
WORTH_REPORTING_M = 0.10
"""A missing or lagging thermometer is reported if the error of ranges may exceed this [m]: 8 C at the maximum of an
MB1242. With less it is also reported if somebody states the temperature before each flight."""


class AirTemperature:
    """Selects the best value of the air temperature.

    Parameters
    ----------
    parameters
        Temperature sources and fixed temperature.
    start_s
        Present time [s].
    reader
        Reads the file sources.
    maximum_m
        Longest range of the vehicle's ultrasonic sensors, for the reports to the pilot [m]; 0: none, and no reports.
    """

    def __init__(self, parameters: TemperatureParameters, start_s: float, reader: LoopReader, maximum_m: float) -> None:
        self._reader = reader
        self._maximum_m = maximum_m
        self._fixed = parameters.fixed_air
        self._air = self._fixed
        self._humidity = Humidity()
        self._history = RangeHistory()
        self._tracks = [TemperatureTrack(source, self._history) for source in parameters.sources]
        self._had_value_s = start_s
        self._decision = Text.NO_TEMPERATURE.over
        self._lag_m = 0.0
        fixed_error_m = air_error_m(maximum_m, self._fixed)
        self._no_thermometer = Text.NO_THERMOMETER.when(
            not parameters.sources and fixed_error_m > WORTH_REPORTING_M,
            off_cm=100 * fixed_error_m,
            coldest_c=coldest_c(self._fixed),
            maximum_m=maximum_m,
        )

    def on_message(self, now_s: float, message: Any) -> None:
        """Update with any message from the autopilot."""
        kind = message.msgname
        if kind == HYGROMETER:
            self._humidity.on_message(now_s, message)
        for track in self._tracks:
            source = track.source
            if isinstance(source, MavlinkSource) and source.message == kind:
                known = MAVLINK_FIELDS[kind, source.field]
                reported_c = getattr(message, source.field) * known.c_per_unit
                if reported_c != known.absent_c:
                    track.update(now_s, reported_c)

    def record_range(self, reading: Reading) -> None:
        """Record a raw reading of a downward sensor, for comparison if a thermometer jumps."""
        if self._tracks and reading.status is Status.OK and reading.range_m is not None and not reading.suspect:
            self._history.record(reading.time_s, reading.sensor, reading.range_m)

    def now(self, now_s: float) -> Air:
        """The air at ``now_s``; reads the files that are due."""
        self._decision = Text.NO_TEMPERATURE.over
        for track in self._tracks:
            source = track.source
            if isinstance(source, FileSource) and (sample := self._reader.newest(source, now_s)) is not None:
                track.update(*sample)
        for track in self._tracks:
            self._decide(track, now_s)
        used, air = self._best(now_s)
        self._lag_m = self._reported_lag_m(used, air.temperature_c)
        if air.source not in (FIXED, HELD):
            self._had_value_s = now_s
        self._air = self._humidity.applied(now_s, air)
        return self._air

    def _best(self, now_s: float) -> tuple[TemperatureTrack | None, Air]:
        known = [(track, good) for track in self._tracks if (good := track.good(now_s)) is not None]
        if new := [(track, good) for track, good in known if good.source != HELD]:
            track, good = min(new, key=lambda each: each[0].settles)
        elif old := [(track, good) for track, good in known if good.std_c < self._fixed.std_c]:
            track, good = min(old, key=lambda each: each[1].std_c)
        else:
            return None, self._fixed
        return track, track.air(now_s, good)

    def _reported_lag_m(self, used: TemperatureTrack | None, temperature_c: float) -> float:
        """The error that is reported of a source that settles [m]: from a large one on until it has settled, else 0."""
        if used is None or used.jump is not None or used.settling is None:
            return 0.0
        left_c = used.settling.lag_c - used.settling.ahead_c
        error_m = abs(compensate_range(self._maximum_m, temperature_c, temperature_c + left_c) - self._maximum_m)
        return error_m if self._lag_m or error_m > WORTH_REPORTING_M else 0.0

    def _decide(self, track: TemperatureTrack, now_s: float) -> None:
        """Decide whether to use a jump, if that is possible now."""
        jump = track.jump
        if jump is None:
            return
        good, new = track.good(now_s), track.reported(now_s)
        if good is None or new is None:
            return
        others = [other for each in self._tracks if each is not track and (other := each.reported(now_s)) is not None]
        verdicts = {_agree(new, other) for other in others if _agree(new, other) != _agree(good, other)}
        agree, disagree, doubt_c = Text.SOURCE_AGREES, Text.SOURCE_DISAGREES, track.doubt_c
        if not verdicts:
            jump.ranges.update(now_s)
            changed = jump.ranges.changed(now_s, good.temperature_c, new.temperature_c)
            verdicts = set() if changed is None else {changed}
            agree, disagree = Text.RANGES_AGREE, Text.RANGES_DISAGREE
        if verdicts == {True}:
            decision = agree
            track.confirm()
        elif verdicts == {False}:
            decision = disagree
            jump.refused = True
        elif not jump.refused and now_s - jump.steady_since_s >= BELIEVED_AFTER_S:
            decision = Text.USED
            track.confirm(doubt_c)
        else:
            return
        after_min = BELIEVED_AFTER_S / 60
        _, self._decision = decision.said(to_c=new.temperature_c, after_min=after_min, doubt_c=doubt_c)

    def conditions(self, now_s: float) -> list[Condition]:
        """Conditions to report to the pilot, as of the last call of `now`."""
        if not self._maximum_m:
            return []
        using_c = self._air.temperature_c
        is_without = bool(self._tracks) and self._air.source in (FIXED, HELD)
        flapping_c = {track: levels_c for track in self._tracks if (levels_c := track.flapping_c(now_s))}
        low_c, high_c = next(iter(flapping_c.values()), (0.0, 0.0))
        jumps = [track.jump for track in self._tracks if track.jump is not None and track not in flapping_c]
        jump_c = jumps[0].value_c if jumps else None
        wrong_c = next((jump.value_c for jump in jumps if jump.refused), None)
        # If another source has a value, that decides.
        is_open = is_without and jumps and wrong_c is None and now_s - jumps[0].since_s >= JUMP_REPORTED_S
        is_silent = is_without and not jumps and not flapping_c and now_s - self._had_value_s > GRACE_S
        return [
            self._no_thermometer,
            Text.JUMP.when(is_open, to_c=jump_c, using_c=using_c)._replace(over=self._decision),
            Text.WRONG_THERMOMETER.when(wrong_c is not None, to_c=wrong_c, using_c=using_c),
            Text.FLAPS.when(flapping_c, low_c=low_c, high_c=high_c, using_c=using_c),
            Text.LAGS.when(self._lag_m, off_cm=100 * self._lag_m, maximum_m=self._maximum_m),
            Text.NO_TEMPERATURE.when(is_silent, using_c=using_c),
            Text.HANGS.when(self._reader.hangs(now_s)),
        ]


def _agree(one: Air, other: Air) -> bool:
    return abs(one.temperature_c - other.temperature_c) <= AGREE_STDS * math.hypot(one.std_c, other.std_c)
