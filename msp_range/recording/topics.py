"""What a recording holds: its topics, and the JSON schema of each one's messages.

Topics of a sensor are ``/<sensor>/reading``, ``/<sensor>/corrected``, ``/<sensor>/filtered`` and, from a simulator,
``/truth/<sensor>``; the rest are ``/fused``, ``/mavlink/sent``, ``/mavlink/received`` and ``/health``. No key is
required: one that is absent is unknown. Every property has one plain type, because Foxglove and Lichtblick refuse
schemas with unions and with null.
"""

import json
from typing import Any

from msp_range.recording.csv_form import CONTEXT_COLUMNS, WORD_COLUMNS

_TIME_S = ("number", "time of the echo, or of the ping where there was none, on the bridge's clock [s]")
_RANGE_M = ("number", "distance along the beam [m]")
_VARIANCE_M2 = ("number", "variance of the error of range_m [m^2]")
_MAVLINK = {
    "name": ("string", "name of the MAVLink message"),
    "hex": ("string", "the whole frame as it is on the link, in hexadecimal"),
    "fields": ("object", "the message's fields, in MAVLink's units"),
}

_PropertyTable = dict[str, tuple[str, str]]

SENSOR_TOPICS: dict[str, tuple[str, _PropertyTable]] = {
    "reading": (
        "one ranging as the sensor gave it",
        {
            "time_s": _TIME_S,
            "ping_s": ("number", "time of the ping on the bridge's clock [s]"),
            "read_s": ("number", "time of the last try to read the answer on the bridge's clock [s]"),
            "status": ("string", "what the answer means"),
            "raw": ("integer", "the sensor's 16-bit answer; absent where there was none"),
            "range_m": _RANGE_M,
            "std_m": ("number", "standard deviation of range_m [m]"),
            "suspect": ("boolean", "a legal range that is also a known fault code"),
        },
    ),
    "corrected": (
        "a range after the correction for air temperature",
        {
            "time_s": _TIME_S,
            "range_m": _RANGE_M,
            "temperature_c": ("number", "air temperature used [deg C]"),
            "source": ("string", "where the temperature is from; fixed: the airframe file's constant"),
        },
    ),
    "filtered": (
        "what the filter chain made of a reading",
        {
            "time_s": _TIME_S,
            "range_m": _RANGE_M,
            "variance_m2": _VARIANCE_M2,
            "rejected": ("string", "why the reading was not used; absent where it was"),
        },
    ),
}
"""Last part of ``/<sensor>/<stage>`` -> what it is, and its properties as (JSON type, description)."""

TOPICS: dict[str, tuple[str, _PropertyTable]] = {
    "/fused": (
        "height from all downward sensors",
        {"time_s": _TIME_S, "range_m": ("number", "fused distance [m]"), "variance_m2": _VARIANCE_M2},
    ),
    "/mavlink/sent": ("a MAVLink message that went out", _MAVLINK),
    "/mavlink/received": ("a MAVLink message that came in", _MAVLINK),
    "/health": (
        "a change of health",
        {"text": ("string", "what changed"), "severity": ("string", "how bad it is")},
    ),
}
"""Topics that are not one sensor's."""

TRUTH_PREFIX = "/truth/"
_TRUTH: tuple[str, _PropertyTable] = (
    "what the simulator knows of a ping; written when the ping goes out, before its reading",
    {
        name: ("string" if name in WORD_COLUMNS else "number", meaning)
        for name, meaning in {
            "true_range_cm": "perpendicular distance to the surface [cm]",
            **CONTEXT_COLUMNS,
        }.items()
    },
)


def schema_of(topic: str) -> tuple[str, bytes]:
    """Name and JSON schema of a topic's messages.

    Raises
    ------
    ValueError
        No such topic.

    Examples
    --------
    >>> schema_of("/front_left/reading")[0]
    'msp_range.Reading'
    """
    _, _, stage = topic.rpartition("/")
    if topic in TOPICS:
        name, (meaning, properties) = topic.strip("/").replace("/", "_"), TOPICS[topic]
    elif topic.startswith(TRUTH_PREFIX):
        name, (meaning, properties) = "truth", _TRUTH
    elif stage in SENSOR_TOPICS:
        name, (meaning, properties) = stage, SENSOR_TOPICS[stage]
    else:
        known = [*TOPICS, TRUTH_PREFIX + "<sensor>", *(f"/<sensor>/{each}" for each in SENSOR_TOPICS)]
        raise ValueError(f"no topic {topic!r}; known: {', '.join(known)}")
    schema: dict[str, Any] = {
        "title": "msp_range." + "".join(part.capitalize() for part in name.split("_")),
        "description": meaning,
        "type": "object",
        "properties": {key: _property(*each) for key, each in properties.items()},
    }
    return schema["title"], json.dumps(schema).encode()


def _property(json_type: str, meaning: str) -> dict[str, Any]:
    # Foxglove looks for the properties of every object, even where they are free.
    free: dict[str, Any] = {"properties": {}} if json_type == "object" else {}
    return {"type": json_type, "description": meaning, **free}
