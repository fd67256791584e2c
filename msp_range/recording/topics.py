"""What a recording holds: its topics, and the JSON schema of each one's messages.

Topics of a sensor are ``/range/<sensor>``, every stage of a reading in one message, and, from a simulator or a bench,
``/truth/<sensor>``; the rest are ``/fused``, ``/attitude``, ``/motion``, ``/mavlink/sent``, ``/mavlink/withheld``,
``/acceptance``, ``/health``, ``/mark`` and ``/campaign``. A key that is absent is unknown, and a message without the
required ones is left out. Every key has one plain type, because Foxglove and Lichtblick refuse schemas with unions and
with null.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from msp_range.input_file import CONTROL
from msp_range.recording.columns import CONTEXT_COLUMNS, LARGEST_NUMBER, WORD_COLUMNS

_TIME_S = "time of the echo, or of the ping where there was none, on the bridge's clock [s]"
_MAVLINK = {
    "name": "name of the MAVLink message",
    "hex": "the whole frame as it is on the link, in hexadecimal; of one not sent, unnumbered and unsigned",
}

LONGEST_TOPIC = 200
"""Characters of a topic; a sensor's name has 32 at most."""
LONGEST_TEXT = 10_000
"""Characters of a text in a message; the longest is the plan of a point at the bench."""
LARGEST_TIME_S = 1e10
"""Times are not farther from the clock's zero than this [s]: 300 years, at which a float still tells microseconds."""

FUSED_TOPIC, ATTITUDE_TOPIC, MOTION_TOPIC = "/fused", "/attitude", "/motion"
SENT_TOPIC, WITHHELD_TOPIC = "/mavlink/sent", "/mavlink/withheld"
HEALTH_TOPIC, MARK_TOPIC, CAMPAIGN_TOPIC = "/health", "/mark", "/campaign"
ACCEPTANCE_TOPIC = "/acceptance"
RANGE_PREFIX = "/range/"
TRUTH_PREFIX = "/truth/"
_TYPES: dict[str, type] = {
    "suspect": bool,
    **dict.fromkeys(("attempt", "readings"), int),
    **dict.fromkeys(("status", "temperature_source", "rejected", "name", "hex", "text", "severity"), str),
    **dict.fromkeys(("event", "point", "planned", *WORD_COLUMNS), str),
}
"""Type of a key; the others are numbers."""
_JSON_TYPES = {float: "number", int: "integer", str: "string", bool: "boolean"}


class Topic(NamedTuple):
    """Messages that are recorded on a topic."""

    meaning: str
    """Content of a message, in words."""
    keys: Mapping[str, str]
    """What each of its keys means."""
    required: frozenset[str] | None = None
    """Keys that a message needs to be used; None: nothing reads the topic back."""

    def fits(self, message: Mapping[str, Any]) -> bool:
        """Whether a message has these keys; those that are not named hold one number, text or truth value."""
        for key, value in message.items():
            kind = type(value)
            expected = _TYPES.get(key, float) if key in self.keys else kind
            if kind not in _JSON_TYPES or not (kind is expected or (kind is int and expected is float)):
                return False
            if kind is str:
                if len(value) > LONGEST_TEXT or not (value.isprintable() or CONTROL.search(value) is None):
                    return False
            elif abs(value) > (LARGEST_TIME_S if key.endswith("_s") else LARGEST_NUMBER):
                return False
        return self.required is None or self.required <= message.keys()


TOPICS = {
    FUSED_TOPIC: Topic(
        "the ground from all downward sensors",
        {
            "time_s": _TIME_S,
            "range_m": "distance along the vehicle's down axis [m]",
            "variance_m2": "variance of its error [m^2]",
            "height_m": "height above the plane of the ground, straight up [m]",
            "climb_m_s": "how fast that grows [m/s]",
            "rise_north": "rise of the ground per metre north; forward where the attitude is not known",
            "rise_east": "rise of the ground per metre east; right where the attitude is not known",
            "probability": "that this is the ground, and no object or fault",
        },
        frozenset(),
    ),
    ATTITUDE_TOPIC: Topic(
        "how the vehicle is turned, as the autopilot says",
        {
            "time_s": "when the vehicle was turned so, on the bridge's clock [s]",
            "roll_rad": "Euler angles, intrinsic yaw, pitch, roll [rad]",
            "pitch_rad": "see roll_rad [rad]",
            "yaw_rad": "see roll_rad [rad]",
        },
        frozenset({"time_s", "roll_rad", "pitch_rad", "yaw_rad"}),
    ),
    MOTION_TOPIC: Topic(
        "how the vehicle moves up and down, by the autopilot's accelerometer or barometer",
        {
            "time_s": "when it was received, on the bridge's clock [s]",
            "up_m_s2": "acceleration upwards, gravity taken off [m/s^2]; absent in a pressure",
            "pressure_height_m": "the pressure as a height over any level [m]; absent in an acceleration",
        },
        frozenset({"time_s"}),
    ),
    SENT_TOPIC: Topic("a MAVLink message that went out", _MAVLINK),
    WITHHELD_TOPIC: Topic("a distance that would have gone out, but the airframe file says: send nothing", _MAVLINK),
    ACCEPTANCE_TOPIC: Topic(
        "what the autopilot makes of the distances, by its own messages",
        {
            "text": "the same in words",
            "received_m": "the distance that it says it has [m]",
            "height_m": "its estimator's height above the ground [m]",
            "off_m": "how much larger that is than the distances of the last second [m]",
            "ratio": "its estimator's innovation over its limit: from 1 on distances are rejected",
        },
    ),
    HEALTH_TOPIC: Topic("a change of health", {"text": "what changed", "severity": "how bad it is"}),
    MARK_TOPIC: Topic("what somebody noted while it flew", {"text": "the note"}),
    CAMPAIGN_TOPIC: Topic(
        "a step of a campaign at the bench",
        {
            "event": "begin or done",
            "point": "name of the point in the campaign",
            "attempt": "1, or more where the point was read again",
            "run": "run of the readings that follow",
            "readings": "planned readings of each sensor",
            "planned": "the point's set-up as the campaign has it, as JSON",
        },
        frozenset({"event", "point", "attempt", "run", "planned"}),
    ),
    TRUTH_PREFIX: Topic(
        "what a simulator or a bench knows of a ping; written before its reading",
        {
            "run": "which set-up of a campaign, and which session",
            "true_range_cm": "perpendicular distance to the surface [cm]",
            **CONTEXT_COLUMNS,
        },
        frozenset(),
    ),
    RANGE_PREFIX: Topic(
        "one ranging of a sensor, and what became of it stage by stage",
        {
            "time_s": _TIME_S,
            "ping_s": "time of the ping on the bridge's clock [s]",
            "read_s": "time of the last try to read the answer on the bridge's clock [s]",
            "status": "what the answer means",
            "raw": "the sensor's own answer [cm]; absent where there was none",
            "suspect": "a legal range that is also a known fault code",
            "range_m": "distance along the beam [m]",
            "std_m": "standard deviation of range_m [m]",
            "temperature_c": "air temperature of the correction [deg C]",
            "temperature_std_c": "standard deviation of its error, with that of the humidity as degrees [deg C]",
            "humidity_pct": "relative humidity of the correction [%]; absent where none was measured",
            "temperature_source": "where it is from; fixed: the airframe file's constant; held: an old value",
            "corrected_m": "range_m after the correction for air temperature [m]",
            "filtered_m": "what the filter chain made of it [m]; absent where it was rejected",
            "variance_m2": "variance of the error of filtered_m [m^2]",
            "rejected": "why the reading was not used; absent where it was",
        },
        frozenset({"time_s", "ping_s", "read_s", "status"}),
    ),
}
"""Topics, and the prefixes of those of one sensor."""


class Message(NamedTuple):
    """One recorded message; ``time_s`` is on the bridge's clock, or since 1970 in a file of another program."""

    topic: str
    time_s: float
    message: dict[str, Any]


def _known(topic: str) -> str:
    """The topic, or its prefix if it is one of a sensor."""
    return next((prefix for prefix in (TRUTH_PREFIX, RANGE_PREFIX) if topic.startswith(prefix)), topic)


def read_back(topic: str) -> Topic | None:
    """The messages recorded on a topic; None for topics that nothing reads back, of this program or another."""
    found = TOPICS.get(_known(topic))
    return None if found is None or found.required is None else found


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
    key = _known(topic)
    if key not in TOPICS:
        known = [f"{known_topic}<sensor>" if known_topic.endswith("/") else known_topic for known_topic in TOPICS]
        raise ValueError(f"no topic {topic!r}; known: {', '.join(known)}")
    meaning, keys, _ = TOPICS[key]
    words = key.strip("/").replace("/", "_").split("_")
    schema: dict[str, Any] = {
        "title": "msp_range." + "".join(word.capitalize() for word in words),
        "description": meaning,
        "type": "object",
        "properties": {
            name: {"type": _JSON_TYPES[_TYPES.get(name, float)], "description": meaning_of_key}
            for name, meaning_of_key in keys.items()
        },
    }
    return schema["title"], json.dumps(schema).encode()
