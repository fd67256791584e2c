"""Read a recorded flight, simulated or real, for its table and picture.

An MCAP recording becomes a `FlightResult`. A simulator records the truth with each ping; real flights have none.
"""

from collections import Counter, defaultdict
from pathlib import Path

from msp_range.reading import Status
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.topics import FUSED_TOPIC, HEALTH_TOPIC, MARK_TOPIC, RANGE_PREFIX, SENT_TOPIC, TRUTH_PREFIX
from msp_sim.flight.flight_log import FlightResult, SensorTrack, at_echo_m


def recorded_flight(path: Path) -> FlightResult:
    """Read what became of each reading, and the fused stream; times count from the first ping.

    Raises
    ------
    RecordingError
        The file is not a recording, or has no readings.
    """
    tracks: dict[str, SensorTrack] = defaultdict(SensorTrack)
    truths_m: dict[str, float | None] = {}
    fused = SensorTrack()
    start_s: float | None = None
    last_s = 0.0
    texts: list[tuple[float, str, str]] = []
    sent: Counter[str] = Counter()
    for topic, time_s, message in Recording(path):
        if topic.startswith(TRUTH_PREFIX):
            range_cm, rate_cm_s = message.get("true_range_cm"), message.get("range_rate_cm_s", 0.0)
            air_c = message.get("air_temperature_c", 20.0)
            truths_m[topic.removeprefix(TRUTH_PREFIX)] = range_cm and at_echo_m(range_cm, rate_cm_s, air_c)
        elif topic.startswith(RANGE_PREFIX):
            start_s = message["ping_s"] if start_s is None else start_s
            last_s = message["time_s"] - start_s
            name = topic.removeprefix(RANGE_PREFIX)
            at_minimum = message["status"] if message["status"] == Status.AT_MINIMUM.value else None
            why = message.get("rejected", at_minimum)
            truth_m = truths_m.pop(name, None)
            tracks[name].add(last_s, truth_m, message.get("range_m"), message.get("filtered_m"), why)
        elif topic == FUSED_TOPIC and start_s is not None and {"time_s", "range_m"} <= message.keys():
            fused.add(message["time_s"] - start_s, None, None, message["range_m"], None)
        elif topic == SENT_TOPIC:
            sent[str(message.get("name"))] += 1
        elif topic in (HEALTH_TOPIC, MARK_TOPIC) and "text" in message:
            severity = str(message.get("severity", "mark"))
            texts.append((time_s - (time_s if start_s is None else start_s), severity, str(message["text"])))
    if not tracks:
        raise RecordingError(f"{path}: holds no readings; expected what msp-range run or msp-sim fly recorded")
    return FlightResult(dict(tracks), fused, texts, sent=dict(sent), duration_s=last_s)
