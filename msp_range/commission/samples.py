"""Readings and attitudes of some seconds as arrays, whatever they come from.

They are made of a bridge's records: those of a bridge in this process, of a running one's socket, or of a recording.
They have the same topics (`msp_range.recording.topics`).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from msp_range.arrays import Array, Flags, Texts
from msp_range.recording.topics import ATTITUDE_TOPIC, FUSED_TOPIC, RANGE_PREFIX, Message

LONGEST_GAP_S = 0.6
"""Between two attitudes further apart than this the vehicle's turn is not known [s]: the bridge asks for ten a second,
and a hand turns a vehicle by some 20 degrees in this time."""


@dataclass(frozen=True)
class SensorReadings:
    """The readings of one sensor in the order of their times."""

    time_s: Array
    """Time of each echo, or of the ping where there was none, shape (n,) [s]."""
    range_m: Array
    """Distance after the correction for the air's temperature, shape (n,) [m]; NaN where there is none."""
    status: Texts
    """What each answer means, n words; ``suspect`` for a distance that is also the damaged form of 'no echo'."""
    rejected: Texts
    """Why each was not used, n words; empty where it was."""
    latency_s: float
    """Shortest time from an echo to its answer [s]; infinite where there was none."""
    air_c: float | None
    air_source: str | None
    """Temperature of the last correction [deg C], and its source; None for a sensor that needs none."""

    @property
    def is_distance(self) -> Flags:
        """True where the sensor measured a distance: an echo beyond its minimum. Shape (n,)."""
        return np.isin(self.status, "ok")


@dataclass(frozen=True)
class Samples:
    """What was received in some seconds."""

    readings: Mapping[str, SensorReadings]
    """Readings by the sensor's name; sensors without a reading are left out."""
    attitude: Array
    """Rows of (time [s], roll [rad], pitch [rad]), shape (m, 3)."""
    fused: Array
    """Rows of (time [s], fused distance [m], height [m]), shape (k, 3)."""

    def down_at(self, time_s: Array, lag_s: float = 0.0) -> Array:
        """The direction of straight down in the body's axes (FRD) at some times, shape (n, 3).

        NaN where no attitude was received around that time. With R the rotation from body to level, it is the third row
        of R: (-sin pitch, cos pitch sin roll, cos pitch cos roll).

        Parameters
        ----------
        time_s
            Times [s], shape (n,).
        lag_s
            How much later than the readings the attitudes seem to be [s].
        """
        time_s = np.asarray(time_s, dtype=float) + lag_s
        if len(self.attitude) < 2:
            return np.full((len(time_s), 3), np.nan)
        known_s = self.attitude[:, 0]
        roll, pitch = (np.interp(time_s, known_s, self.attitude[:, column]) for column in (1, 2))
        after = np.clip(np.searchsorted(known_s, time_s), 1, len(known_s) - 1)
        around = (known_s[after] - known_s[after - 1] <= LONGEST_GAP_S) & (time_s >= known_s[0] - LONGEST_GAP_S / 2)
        around &= time_s <= known_s[-1] + LONGEST_GAP_S / 2
        down = np.stack([-np.sin(pitch), np.cos(pitch) * np.sin(roll), np.cos(pitch) * np.cos(roll)], axis=1)
        return np.where(around[:, None], down, np.nan)


def samples_of(records: Iterable[Message], first_s: float = -np.inf, last_s: float = np.inf) -> Samples:
    """The readings and attitudes among a bridge's records, from one time to another [s].

    Examples
    --------
    >>> record = Message("/range/front", 1.0, {"time_s": 0.9, "read_s": 0.93, "status": "ok", "corrected_m": 2.0})
    >>> samples_of([record]).readings["front"].range_m.tolist()
    [2.0]
    """
    of_sensor: dict[str, list[Mapping[str, Any]]] = {}
    attitude: list[tuple[float, float, float]] = []
    fused: list[tuple[float, float, float]] = []
    for topic, _, message in records:
        if not first_s <= message.get("time_s", np.nan) <= last_s:
            continue
        if topic.startswith(RANGE_PREFIX):
            of_sensor.setdefault(topic.removeprefix(RANGE_PREFIX), []).append(message)
        elif topic == ATTITUDE_TOPIC:
            attitude.append((message["time_s"], message["roll_rad"], message["pitch_rad"]))
        elif topic == FUSED_TOPIC and {"range_m", "height_m"} <= message.keys():
            fused.append((message["time_s"], message["range_m"], message["height_m"]))
    return Samples(
        {name: _readings(messages) for name, messages in of_sensor.items()},
        np.array(sorted(attitude), dtype=float).reshape(-1, 3),
        np.array(sorted(fused), dtype=float).reshape(-1, 3),
    )


def _readings(messages: list[Mapping[str, Any]]) -> SensorReadings:
    messages = sorted(messages, key=lambda message: float(message["time_s"]))
    latencies_s = [record["read_s"] - record["time_s"] for record in messages if np.isfinite(_distance_m(record))]
    return SensorReadings(
        np.array([float(record["time_s"]) for record in messages]),
        np.array([_distance_m(record) for record in messages]),
        np.array(["suspect" if record.get("suspect") else record["status"] for record in messages]),
        np.array([record.get("rejected") or "" for record in messages]),
        min(latencies_s, default=np.inf),
        messages[-1].get("temperature_c"),
        messages[-1].get("temperature_source"),
    )


def _distance_m(message: Mapping[str, Any]) -> float:
    """The corrected distance; as it was read where the fusion takes the sensor for stuck, and NaN without one."""
    known_m = [message[key] for key in ("corrected_m", "range_m") if message.get(key) is not None]
    return float(known_m[0]) if known_m else np.nan
