"""What a recording holds: its topics, and the JSON schema of each one's messages.

Topics of a sensor are ``/range/<sensor>``, every stage of a reading in one message, and, from a simulator or a bench,
``/truth/<sensor>``; the rest are ``/fused``, ``/attitude``, ``/motion``, ``/mavlink/sent``, ``/mavlink/withheld``,
``/health``, ``/mark`` and ``/campaign``. A key that is absent is unknown, and a reading without those of `REQUIRED` is
none. Every property has one plain type, because Foxglove and Lichtblick refuse schemas with unions and with null.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from msp_range.input_file import CONTROL
from msp_range.recording.columns import CONTEXT_COLUMNS, LARGEST_NUMBER, WORD_COLUMNS

_TIME_S = ("number", "time of the echo, or of the ping where there was none, on the bridge's clock [s]")
_RANGE_M = ("number", "distance along the beam [m]")
_MAVLINK = {
    "name": ("string", "name of the MAVLink message"),
    "hex": ("string", "the whole frame as it is on the link, in hexadecimal; of one not sent, unnumbered and unsigned"),
}

_PropertyTable = dict[str, tuple[str, str]]

LONGEST_TOPIC = 200
"""Characters of a topic; a sensor's name has 32 at most."""
LONGEST_TEXT = 10_000
"""Characters of a text in a message; the longest is the plan of a point at the bench."""
LARGEST_TIME_S = 1e10
"""Times are not farther from the clock's zero than this [s]: 300 years, at which a float still tells microseconds."""

FUSED_TOPIC, ATTITUDE_TOPIC, MOTION_TOPIC = "/fused", "/attitude", "/motion"
SENT_TOPIC, WITHHELD_TOPIC = "/mavlink/sent", "/mavlink/withheld"
HEALTH_TOPIC, MARK_TOPIC, CAMPAIGN_TOPIC = "/health", "/mark", "/campaign"
RANGE_PREFIX = "/range/"
TRUTH_PREFIX = "/truth/"
_RANGE: tuple[str, _PropertyTable] = (
    "one ranging of a sensor, and what became of it stage by stage",
    {
        "time_s": _TIME_S,
        "ping_s": ("number", "time of the ping on the bridge's clock [s]"),
        "read_s": ("number", "time of the last try to read the answer on the bridge's clock [s]"),
        "status": ("string", "what the answer means"),
        "raw": ("integer", "the sensor's 16-bit answer; absent where there was none"),
        "suspect": ("boolean", "a legal range that is also a known fault code"),
        "range_m": _RANGE_M,
        "std_m": ("number", "standard deviation of range_m [m]"),
        "temperature_c": ("number", "air temperature of the correction [deg C]"),
        "temperature_std_c": (
            "number",
            "standard deviation of its error, with that of the humidity as degrees [deg C]",
        ),
        "humidity_pct": ("number", "relative humidity of the correction [%]; absent where none was measured"),
        "temperature_source": ("string", "where it is from; fixed: the airframe file's constant; held: an old value"),
        "corrected_m": ("number", "range_m after the correction for air temperature [m]"),
        "filtered_m": ("number", "what the filter chain made of it [m]; absent where it was rejected"),
        "variance_m2": ("number", "variance of the error of filtered_m [m^2]"),
        "rejected": ("string", "why the reading was not used; absent where it was"),
    },
)

TOPICS: dict[str, tuple[str, _PropertyTable]] = {
    FUSED_TOPIC: (
        "the ground from all downward sensors",
        {
            "time_s": _TIME_S,
            "range_m": ("number", "distance along the vehicle's down axis [m]"),
            "variance_m2": ("number", "variance of its error [m^2]"),
            "height_m": ("number", "height above the plane of the ground, straight up [m]"),
            "climb_m_s": ("number", "how fast that grows [m/s]"),
            "rise_north": ("number", "rise of the ground per metre north; forward where the attitude is not known"),
            "rise_east": ("number", "rise of the ground per metre east; right where the attitude is not known"),
            "probability": ("number", "that this is the ground, and no object or fault"),
        },
    ),
    ATTITUDE_TOPIC: (
        "how the vehicle is turned, as the autopilot says",
        {
            "time_s": ("number", "when the vehicle was turned so, on the bridge's clock [s]"),
            "roll_rad": ("number", "Euler angles, intrinsic yaw, pitch, roll [rad]"),
            "pitch_rad": ("number", "see roll_rad [rad]"),
            "yaw_rad": ("number", "see roll_rad [rad]"),
        },
    ),
    MOTION_TOPIC: (
        "how the vehicle moves up and down, by the autopilot's accelerometer or barometer",
        {
            "time_s": ("number", "when it was received, on the bridge's clock [s]"),
            "up_m_s2": ("number", "acceleration upwards, gravity taken off [m/s^2]; absent in a pressure"),
            "pressure_height_m": ("number", "the pressure as a height over any level [m]; absent in an acceleration"),
        },
    ),
    SENT_TOPIC: ("a MAVLink message that went out", _MAVLINK),
    WITHHELD_TOPIC: ("a distance that would have gone out, but the airframe file says: send nothing", _MAVLINK),
    HEALTH_TOPIC: (
        "a change of health",
        {"text": ("string", "what changed"), "severity": ("string", "how bad it is")},
    ),
    MARK_TOPIC: ("what somebody noted while it flew", {"text": ("string", "the note")}),
    CAMPAIGN_TOPIC: (
        "a step of a campaign at the bench",
        {
            "event": ("string", "begin or done"),
            "point": ("string", "name of the point in the campaign"),
            "attempt": ("integer", "1, or more where the point was read again"),
            "run": ("string", "run of the readings that follow"),
            "readings": ("integer", "planned readings of each sensor"),
            "planned": ("string", "the point's set-up as the campaign has it, as JSON"),
        },
    ),
}
"""Topics that are not one sensor's."""

_TRUTH: tuple[str, _PropertyTable] = (
    "what a simulator or a bench knows of a ping; written before its reading",
    {
        name: ("string" if name in WORD_COLUMNS else "number", meaning)
        for name, meaning in {
            "run": "which set-up of a campaign, and which session",
            "true_range_cm": "perpendicular distance to the surface [cm]",
            **CONTEXT_COLUMNS,
        }.items()
    },
)


REQUIRED: dict[str, frozenset[str]] = {
    RANGE_PREFIX: frozenset({"time_s", "ping_s", "read_s", "status"}),
    TRUTH_PREFIX: frozenset(),
    FUSED_TOPIC: frozenset(),
    ATTITUDE_TOPIC: frozenset({"time_s", "roll_rad", "pitch_rad", "yaw_rad"}),
    MOTION_TOPIC: frozenset({"time_s"}),
    CAMPAIGN_TOPIC: frozenset({"event", "point", "attempt", "run", "planned"}),
}
"""Topics, or their prefixes, whose messages are read back -> keys without which a message is of no use."""

_TYPES: dict[str, frozenset[type]] = {
    "number": frozenset({int, float}),
    "integer": frozenset({int}),
    "string": frozenset({str}),
    "boolean": frozenset({bool}),
}
_ANY = frozenset({int, float, str, bool})


class Message(NamedTuple):
    """One recorded message; ``time_s`` is on the bridge's clock, or since 1970 in a file of another program."""

    topic: str
    time_s: float
    message: dict[str, Any]


class Form(NamedTuple):
    """What the messages of a topic hold: the type of each key, and the keys that each message has."""

    types: Mapping[str, frozenset[type]]
    required: frozenset[str]

    def fits(self, message: Mapping[str, Any]) -> bool:
        """Whether a message has this form; keys that it does not name hold one number, text or truth value."""
        for key, value in message.items():
            kind = type(value)
            if kind not in self.types.get(key, _ANY):
                return False
            if kind is str:
                if len(value) > LONGEST_TEXT or not (value.isprintable() or CONTROL.search(value) is None):
                    return False
            elif abs(value) > (LARGEST_TIME_S if key.endswith("_s") else LARGEST_NUMBER):
                return False
        return self.required <= message.keys()


def form_of(topic: str) -> Form | None:
    """The form of a topic's messages; None for topics that nobody reads back, of this program or another."""
    found = _topic(topic)
    if found is None or found[0] not in REQUIRED:
        return None
    key, (_, properties) = found
    return Form({name: _TYPES[kind] for name, (kind, _) in properties.items()}, REQUIRED[key])


def _topic(topic: str) -> tuple[str, tuple[str, _PropertyTable]] | None:
    """The topic, or the prefix of a sensor's, with what its messages hold."""
    if topic in TOPICS:
        return topic, TOPICS[topic]
    for prefix, each in ((TRUTH_PREFIX, _TRUTH), (RANGE_PREFIX, _RANGE)):
        if topic.startswith(prefix):
            return prefix, each
    return None


def schema_of(topic: str) -> tuple[str, bytes]:
    """Name and JSON schema of a topic's messages.

    Raises
    ------
    ValueError
        No such topic.

    Examples
    --------
    >>> schema_of("/range/front_left")[0]
    'msp_range.Range'
    """
    found = _topic(topic)
    if found is None:
        known = [*TOPICS, TRUTH_PREFIX + "<sensor>", RANGE_PREFIX + "<sensor>"]
        raise ValueError(f"no topic {topic!r}; known: {', '.join(known)}")
    key, (meaning, properties) = found
    name = key.strip("/").replace("/", "_")
    schema: dict[str, Any] = {
        "title": "msp_range." + "".join(part.capitalize() for part in name.split("_")),
        "description": meaning,
        "type": "object",
        "properties": {key: _property(*each) for key, each in properties.items()},
    }
    return schema["title"], json.dumps(schema).encode()


def _property(json_type: str, meaning: str) -> dict[str, Any]:
    return {"type": json_type, "description": meaning}
