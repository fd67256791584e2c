"""The autopilot's parameters for an airframe, in the order in which they are set, each with its reason and source.

The values are those of docs/flying.md and docs/sitl.md, with which ArduCopter and PX4 were flown in their simulators.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from msp_range.assembly import downward_stream, streams_of
from msp_range.config import Airframe
from msp_range.mavlink.distance_sensor import Autopilot, Stream
from msp_range.mavlink.orientation import DOWN, PITCH_90
from msp_range.mavlink.transport.url import SerialUrl, parse_url

Vehicle = Literal["copter", "plane", "sub", "rover"]

ADDRESS = "RNGFND1_ADDR"
"""The address of a sensor on the autopilot's own I2C or CAN; with `DISTANCE_SENSOR_BY_MAVLINK` nothing before ArduPilot
4.8, the only id that is taken from then on (AP_RangeFinder_MAVLink.cpp)."""
PROXIMITY_ORIENTATIONS = frozenset({*range(8), 24})
"""Orientations that ArduPilot's proximity takes: eight around the vehicle, and up (AP_Proximity_MAV.cpp)."""
DISTANCE_SENSOR_BY_MAVLINK = 10
PX4_TELEM_BASE = 100
"""PX4's number of the port TELEM n is this plus n (Tools/serial/generate_config.py)."""
DOCUMENT = "docs/flying.md, Set up the autopilot"
"""Source of the settings that the documents explain."""
USB_PATHS = ("/dev/ttyACM", "/dev/autopilot")
"""Serial ports that are an autopilot's own USB: it speaks MAVLink there without being set up."""

NO_COVARIANCE = "No autopilot reads the covariance that the messages have: its estimator assumes"
ARDUPILOT_USE = (
    f"{NO_COVARIANCE} EK3_RNG_M_NSE (0.5 m). It counts where the range is a source of the height (EK3_SRC1_POSZ 2, "
    "EK3_RNG_USE_HGT) and for the terrain with optical flow; less follows the stream more closely.",
)
COPTER_USE = (
    "SURFTRAK_MODE 1 (default): Loiter, AltHold and PosHold keep the height above the ground by the stream; 0: they "
    "do not use it.",
    "WP_RFND_USE 1 (default): targets above the terrain, and a take-off in GUIDED below RNGFND1_MAX, rely on the "
    "stream alone; 0: on the terrain database, and on the height above home.",
)
PX4_USE = (
    f"{NO_COVARIANCE} EKF2_RNG_NOISE (0.1 m) and EKF2_RNG_SFE (0.05 of the distance); less follows the stream more "
    "closely, and less than it scatters rejects good distances.",
    "MPC_ALT_MODE 2 (default): Altitude and Position keep the height above the ground by the stream while the vehicle "
    "stands still; 1: also while it moves; 0: they do not use it.",
    "EKF2_RNG_DELAY is to be the latency that you measure [ms]: msp-range doctor prints it.",
)
"""Parameters that decide what becomes of the stream, with their defaults (AP_NavEKF3.cpp, ArduCopter/Parameters.cpp,
AC_WPNav.cpp, mode_guided.cpp; PX4's params_range_finder.yaml, multicopter_altitude_mode_params.c)."""


UNARMED = f"While RNGFND1_TYPE is {DISTANCE_SENSOR_BY_MAVLINK} and no distances come, ArduPilot does not arm."
"""For a vehicle that sends nothing yet: half a second without a distance is 'No Data', which fails the check before
arming (AP_RangeFinder.cpp; docs/flying.md has what was seen)."""


@dataclass(frozen=True)
class Firmware:
    """What decides names and units of parameters."""

    autopilot: Autopilot
    """ArduPilot or PX4."""
    vehicle: Vehicle = "copter"
    """ArduPilot's kind of vehicle; without meaning for PX4."""
    centimetres: bool = False
    """ArduPilot before 4.7: limits of range finders have other names and are in centimetres."""
    any_id: bool = False
    """ArduPilot before 4.8: `ADDRESS` does nothing to distances by MAVLink."""

    def __str__(self) -> str:
        if self.autopilot == "px4":
            return "PX4"
        return f"Ardu{self.vehicle.capitalize()} " + ("before 4.7" if self.centimetres else "4.7 or later")


@dataclass(frozen=True)
class Setting:
    """One parameter."""

    name: str
    value: float
    """Name and value as the autopilot has them."""
    reason: str
    """Why this value, in one sentence."""
    source: str
    """Where the value comes from: a key of the airframe file, a document."""
    as_good: float | None = None
    """Another value that does the same."""


def settings(airframe: Airframe, firmware: Firmware, port: int) -> list[Setting]:
    """The parameters to set, in this order.

    Parameters
    ----------
    airframe
        The vehicle.
    firmware
        The autopilot's.
    port
        Number of the autopilot's telemetry port that the bridge is wired to: SERIALn of ArduPilot, TELEM n of PX4.
        Only a serial link needs it.

    Examples
    --------
    >>> from msp_range.config import load_airframe
    >>> for each in settings(load_airframe("configs/loopback.yaml"), Firmware("px4"), 2):
    ...     print(each.name, f"{each.value:g}")
    EKF2_RNG_CTRL 2
    EKF2_HGT_REF 1
    EKF2_MIN_RNG 0.2
    EKF2_RNG_POS_Z 0.05
    """
    make = _px4 if firmware.autopilot == "px4" else _ardupilot
    return list(make(airframe, firmware, port))


def remarks(airframe: Airframe, firmware: Firmware) -> list[str]:
    """What is to be known as well as the values."""
    lines = ["Restart the autopilot after setting them: some count only from then on."]
    if airframe.send.nothing:
        lines.append("The airframe file sends nothing: none of these makes the autopilot expect distances.")
        return lines + [UNARMED] * (firmware.autopilot == "ardupilot")
    if downward_stream(airframe) is not None:
        lines.append("For you to choose, as no value of them follows from the airframe:")
        lines += PX4_USE if firmware.autopilot == "px4" else ARDUPILOT_USE
        if firmware.autopilot == "ardupilot" and firmware.vehicle == "copter":
            lines += [line.replace("WP_", "WPNAV_") if firmware.centimetres else line for line in COPTER_USE]
    outward = [
        stream for stream in streams_of(airframe).singles.values() if stream.orientation.value not in (DOWN, PITCH_90)
    ]
    if firmware.autopilot == "px4" and outward:
        lines.append("CP_DIST switches collision prevention on: it is the distance to keep [m], for you to choose.")
    if firmware.autopilot == "ardupilot" and firmware.vehicle == "sub":
        lines.append("ArduSub ignores distances that readings contradict: of a quality below RNGFND_SQ_MIN (90).")
    return lines


def _ardupilot(airframe: Airframe, firmware: Firmware, port: int) -> Iterator[Setting]:
    baud = _baud(airframe)
    if baud is not None:
        yield Setting(f"SERIAL{port}_PROTOCOL", 2, "MAVLink 2 on the port that the bridge is wired to", DOCUMENT)
        yield Setting(f"SERIAL{port}_BAUD", baud // 1000, f"{baud} baud, as this file says", "link.url")
    if airframe.send.nothing:
        return
    stream = downward_stream(airframe)
    if stream is not None:
        yield Setting("RNGFND1_TYPE", DISTANCE_SENSOR_BY_MAVLINK, "distances come as MAVLink messages", DOCUMENT)
        yield Setting("RNGFND1_ORIENT", DOWN, "down: the orientation selects the stream", DOCUMENT)
        reason = (
            "every id is taken; from 4.8 on another value takes only that id, so that one left over from a sensor on "
            "the autopilot's own I2C or CAN (112: an MB1242) rejects all distances without a word"
        )
        yield Setting(ADDRESS, 0, reason, DOCUMENT, as_good=stream.id)
        nearest_cm, farthest_cm = stream.min_distance_cm, 10 * math.ceil(stream.max_distance_cm / 10 - 1)
        nearest = "below the shortest report, which is out of range otherwise: that is the reading on the ground"
        farthest = "below the longest report, which stands for 'no echo'"
        model = "the sensor model's limits"
        per_m, unit, clearance = (100, "_CM", "GNDCLEAR") if firmware.centimetres else (1, "", "GNDCLR")
        yield Setting(f"RNGFND1_MIN{unit}", nearest_cm * per_m / 100, nearest, model)
        yield Setting(f"RNGFND1_MAX{unit}", farthest_cm * per_m / 100, farthest, model)
        yield _standing(f"RNGFND1_{clearance}", airframe, stream, per_m)
        yield _position("RNGFND1_POS_Z", airframe)
        if firmware.vehicle == "plane":
            yield Setting("RNGFND_LANDING", 1, "the plane uses the range finder to land", "ArduPlane/Parameters.cpp")
    around = [
        stream for stream in streams_of(airframe).singles.values() if stream.orientation.value in PROXIMITY_ORIENTATIONS
    ]
    # ArduPlane has no proximity (ArduPlane/Parameters.cpp).
    if around and firmware.vehicle != "plane":
        yield Setting("PRX1_TYPE", 2, f"{len(around)} of the streams look around the vehicle", DOCUMENT)


def _px4(airframe: Airframe, _: Firmware, port: int) -> Iterator[Setting]:
    baud = _baud(airframe)
    if baud is not None:
        instance = port - 1
        what = "MAVLink on the port that the bridge is wired to"
        yield Setting(f"MAV_{instance}_CONFIG", PX4_TELEM_BASE + port, f"{what}, TELEM {port}", DOCUMENT)
        yield Setting(f"MAV_{instance}_MODE", 2, "onboard mode: for a companion computer", DOCUMENT)
        yield Setting(f"SER_TEL{port}_BAUD", baud, f"{baud} baud, as this file says", "link.url")
    if airframe.send.nothing:
        return
    stream = downward_stream(airframe)
    if stream is not None:
        yield Setting("EKF2_RNG_CTRL", 2, "the range is used always; with 1 only when slow and low", DOCUMENT)
        yield Setting("EKF2_HGT_REF", 1, "with 2 the vehicle cannot be armed from PX4 1.17 on", DOCUMENT)
        yield _standing("EKF2_MIN_RNG", airframe, stream)
        yield _position("EKF2_RNG_POS_Z", airframe)


def standing_m(airframe: Airframe, stream: Stream) -> float:
    """What the downward stream reads when the vehicle stands on the ground, as far as the airframe file shows [m]."""
    return airframe.send.standing_m or (stream.min_distance_cm + 1) / 100


def _standing(name: str, airframe: Airframe, stream: Stream, per_m: int = 1) -> Setting:
    source = "send.standing_m"
    if airframe.send.standing_m is None:
        source = "the shortest report; send.standing_m is not given, msp-range commission measures it"
    return Setting(
        name,
        round(per_m * standing_m(airframe, stream), 2),
        "what it reads when the vehicle stands on the ground; shorter readings are taken for this one",
        source,
    )


def _position(name: str, airframe: Airframe) -> Setting:
    fused = airframe.send.fused
    if fused is not None:
        return Setting(name, fused.reference_down_m, "where the distance starts", "send.fused.reference_down_m")
    down = next(sensor for sensor in airframe.sent if sensor.orientation.value == DOWN)
    return Setting(name, down.position_m[2], "where the sensor is", f"position_m of {down.name}")


def _baud(airframe: Airframe) -> int | None:
    """The rate of a serial port that the autopilot must be set up for; None where there is none."""
    url = parse_url(airframe.link.url)
    if not isinstance(url, SerialUrl) or url.path.startswith(USB_PATHS):
        return None
    return url.baud
