"""What `msp-range check` shows of an airframe: where sensors are and look, what is sent, and what becomes of it."""

from collections.abc import Iterator

from rich.table import Table

from msp_range.acoustics.air import Air, air_error_m, coldest_c
from msp_range.assembly import intervals_s, sensor_watch_of, streams_of
from msp_range.config import Airframe
from msp_range.correction.humidity import HYGROMETER, Humidity
from msp_range.correction.temperature import TemperatureParameters
from msp_range.mavlink.orientation import CUSTOM, DOWN, PITCH_90
from msp_range.mavlink.transport.url import SerialUrl, parse_url
from msp_range.plausible import doubts
from msp_range.terminal import PlainConsole, plain_table

WIDTH, HEIGHT = 33, 9
"""Size of the drawing [characters]; a character is twice as high as wide."""


def show(airframe: Airframe, console: PlainConsole) -> None:
    """Print all of it."""
    console.print(_table(airframe))
    for line in lines(airframe):
        console.print(line)


def lines(airframe: Airframe) -> Iterator[str]:
    """What stands below the table."""
    yield from drawing(airframe)
    yield ""
    yield from (f"warning: {doubt}" for doubt in doubts(airframe))
    url, near = parse_url(airframe.link.url), airframe.polling.near
    how = f"{url.path} at {url.baud} baud" if isinstance(url, SerialUrl) else f"{url}, no serial port"
    yield f"link: {how}, as component {airframe.link.component_id}"
    order = ", then ".join(" with ".join(group) for group in airframe.polling_groups)
    faster = f", {near.ping_interval_s:g} s below {near.below_m:g} m" if near else ""
    yield f"polling: {order}; {airframe.polling_interval_s:g} s apart{faster}"
    if by_themselves := [sensor.name for sensor in airframe.sensors if sensor.driver.is_serial]:
        yield f"{', '.join(by_themselves)}: not pinged; each range is read when the sensor has sent it"
    yield from _streams(airframe)
    watch = sensor_watch_of(airframe)
    yield f"sensor watch: off, {watch}" if isinstance(watch, str) else "sensor watch: on"
    yield from describe_air(airframe.temperature, airframe.maximum_by_sound_m)
    folder = airframe.recording.folder if airframe.recording else "none, unless --record names a folder"
    yield f"recording: {folder}"
    yield f"the autopilot's parameters for this: msp-range params {airframe.path}"


def _table(airframe: Airframe) -> Table:
    title = f"{airframe.vehicle}: bus {airframe.bus}, link {airframe.link.url}, {airframe.link.autopilot}"
    header = ("sensor", "id", "address", "orientation", "sent", "in fused")
    rows = [
        (
            sensor.name,
            str(sensor.id),
            sensor.shown_address,
            f"{sensor.orientation.value} {sensor.orientation.name}",
            "yes" if sensor.name in airframe.sent_names and not airframe.send.nothing else "no",
            "yes" if sensor.name in airframe.fused_names else "no",
        )
        for sensor in airframe.sensors
    ]
    return plain_table(header, rows, "l", title)


def drawing(airframe: Airframe) -> list[str]:
    """The sensors from above by their ids, forward is up; + is the reference point.

    Sensors at one place share a cell, where the last id is shown.
    """
    farthest_m = max([abs(distance_m) for sensor in airframe.sensors for distance_m in sensor.position_m[:2]] + [0.01])
    rows = [[" "] * WIDTH for _ in range(HEIGHT)]
    middle_row, middle_column = HEIGHT // 2, WIDTH // 2
    rows[middle_row][middle_column] = "+"
    for sensor in airframe.sensors:
        forward_m, right_m, _ = sensor.position_m
        row = middle_row - round(forward_m / farthest_m * middle_row)
        column = middle_column + round(right_m / farthest_m * (middle_column - 2))
        for offset, letter in enumerate(str(sensor.id)):
            rows[row][column + offset] = letter
    names = ", ".join(f"{sensor.id} {sensor.name}" for sensor in airframe.sensors)
    heights = {sensor.position_m[2] for sensor in airframe.sensors}
    below = ", ".join(f"{height:g}" for height in sorted(heights))
    return [
        f"from above, forward is up, {2 * farthest_m:g} m from edge to edge, {below} m below the reference point (+):",
        *[f"  |{''.join(row)}|" for row in rows],
        f"  {names}",
    ]


def describe_air(parameters: TemperatureParameters, maximum_m: float) -> list[str]:
    """Describe the accuracy of an airframe file's temperature sources, one line each.

    Parameters
    ----------
    maximum_m
        Longest range of the vehicle's ultrasonic sensors [m]; 0 if there are none.

    Examples
    --------
    >>> print(*describe_air(TemperatureParameters(), 7.65), sep="\\n")
    air: no thermometer
      fixed_c 20 C +-12 C: up to 33 cm off at 7.65 m; right for air of -4 to 44 C
    """

    if not maximum_m:
        return ["air temperature: no sensor depends on it"]

    def off(air: Air) -> str:
        return f"+-{air.std_c:.3g} C: up to {100 * air_error_m(maximum_m, air):.0f} cm off at {maximum_m:.2f} m"

    fixed = parameters.fixed_air
    sources = [
        f"  {source.name} {off(Air(fixed.temperature_c, source.error_std_c, ''))}" for source in parameters.sources
    ]
    humid = Humidity().applied(0.0, Air(fixed.temperature_c, 0.0, ""))
    humidity = f"  humidity, unless the autopilot sends {HYGROMETER}: also {off(humid)}"
    held_c = f"{coldest_c(fixed):.0f} to {2 * fixed.temperature_c - coldest_c(fixed):.0f} C"
    return [
        "air temperature: the first of these with a value is used" if sources else "air: no thermometer",
        *([*sources, humidity] if sources else []),
        f"  fixed_c {fixed.temperature_c:g} C {off(fixed)}; right for air of {held_c}",
    ]


def _streams(airframe: Airframe) -> Iterator[str]:
    if airframe.send.nothing:
        yield "send: nothing; these streams are worked out, recorded and shown, but not sent:"
    if (bounds := streams_of(airframe).fused) is not None:
        yield (
            f"fused: id {bounds.id}, orientation 25 down, from {len(airframe.downward)} sensors, "
            f"{bounds.min_distance_cm + 1} to {bounds.max_distance_cm} cm: {_use(airframe, DOWN)}"
        )
    if airframe.sent_names:
        names = ", ".join(parameters.filter for parameters in airframe.filters) or "none"
        yield f"filters of the single streams: {names}"
    for sensor in airframe.sent:
        yield f"{sensor.name}: id {sensor.id}: {_use(airframe, sensor.orientation.value)}"
    for name, interval_s in intervals_s(airframe).items():
        yield f"{name}: a message every {interval_s:.2f} s"


def _use(airframe: Airframe, orientation: int) -> str:
    """What the autopilot makes of a stream, by its orientation (docs/flying.md)."""
    if airframe.link.autopilot == "ardupilot":
        if orientation == DOWN:
            return "height above ground (RNGFND1)"
        if orientation == CUSTOM:
            return "shown in the ground station, and not used: no axis of ArduPilot's fits the mounting"
        around = orientation in range(8) or orientation == PITCH_90
        return "obstacles (PRX1_TYPE 2)" if around else "not used: no axis of ArduPilot's proximity"
    if orientation == DOWN:
        return "height above ground (EKF2_RNG_CTRL)"
    return "not used: it looks up" if orientation == PITCH_90 else "collision prevention (CP_DIST)"
