"""Hover and review of the log: a recording of the bridge, from the first flight with this airframe file."""

from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from msp_range.arrays import Array
from msp_range.commission.motion import NotMeasured, Places, places
from msp_range.commission.noise import compare_noise
from msp_range.commission.outcome import StepOutcome
from msp_range.commission.samples import Samples, SensorReadings, samples_of
from msp_range.commission.session import Session
from msp_range.commission.steps.places import compare_lag, compare_places
from msp_range.config import Airframe, load_airframe_from
from msp_range.doctor.finding import Finding, first_of, unknown, wrong
from msp_range.pilot_texts import EXPLAINED
from msp_range.recording.reader import Recording, newest_recording
from msp_range.recording.topics import HEALTH_TOPIC, SENT_TOPIC, Message

HIGH_M, STEADY_M, HOVER_S = 0.8, 0.6, 20.0
"""A hover: at least this high above the lowest distance [m], within this of its median [m], for this long [s]."""
SILENT_S = 0.7
"""Longest time between two fused distances that is usual [s]; ArduPilot drops a range finder after 0.5 s, and PX4 gets
ten a second."""
MOST_REJECTED, MOST_MISSED = 0.10, 0.20
"""Shares of readings that were rejected or missed in a hover. Model and simulator have 4 %; above these one of four
sensors contributes little, and wash, vibration or the ground is the reason."""


def flown_part(airframe: Airframe) -> dict[str, Any]:
    """What a flight depends on: all but whether its distances were sent."""
    return airframe.model_dump(mode="json", exclude={"send": {"nothing"}})


def hover(session: Session) -> StepOutcome:
    """Whether there is a recording of a hover with this airframe, and whether distances came all the time."""
    airframe = session.airframe()
    path = _recording(session, airframe)
    if path is None:
        text = (
            "no recording: fly a hover of half a minute at 1.5 to 3 m over flat ground in a mode that does not rely on "
            "the range finder (Stabilize, Manual), with 'msp-range run' recording; send: {nothing: true, ...} will do"
        )
        return StepOutcome([unknown("hover", text, "then again, or name the file: --recording FLIGHT.mcap")])
    recording = Recording(path)
    outcome = StepOutcome(measured={"recording": str(path)})
    if flown_part(load_airframe_from(recording.files, path)) != flown_part(airframe):
        text = f"{path.name} was flown with another airframe file than the present one"
        outcome.wrong("hover", text, "fly again with this one, or give the recording that belongs to it")
        return outcome
    part = hovering(recording)
    if part is None:
        text = f"{path.name} contains no hover: {HOVER_S:.0f} s within {STEADY_M:g} m, {HIGH_M:g} m above the ground"
        outcome.wrong("hover", text, "fly one, or name another recording: --recording FLIGHT.mcap")
        return outcome
    times_s = part.fused[:, 0]
    outcome.right("hover", f"{path.name}: {times_s[-1] - times_s[0]:.0f} s at {np.median(part.fused[:, 1]):.1f} m")
    outcome.findings.append(gaps(times_s))
    return outcome


def gaps(times_s: Array) -> Finding:
    """Whether fused distances came all the time, by their times [s]."""
    longest_s = float(np.diff(times_s).max())
    text = f"{len(times_s) / (times_s[-1] - times_s[0]):.1f} a second, at most {longest_s:.2f} s apart"
    remedy = "the review says which sensor has no readings, and why"
    return first_of("fused distance", (longest_s > SILENT_S, text, remedy), (True, text))


def review(session: Session) -> StepOutcome:
    """What the hover's recording says of each sensor."""
    airframe = session.airframe()
    name = session.measured.get("hover", {}).get("recording")
    path = session.recording or (Path(name) if isinstance(name, str) else _recording(session, airframe))
    if path is None:
        return StepOutcome(
            [unknown("review", "there is no recording", f"msp-range commission {airframe.path} --step hover")]
        )
    records = Recording(path)
    part = hovering(records)
    if part is None:
        return StepOutcome(
            [wrong("review", f"{path} contains no hover", f"msp-range commission {airframe.path} --step hover")]
        )
    outcome = compare(airframe, part)
    reported = Counter(
        str(message["text"])
        for topic, _, message in records
        if topic == HEALTH_TOPIC and "text" in message and message.get("severity") in ("error", "warning")
    )
    for text, count in reported.most_common(8):
        outcome.unknown("reported in flight", f"{text}{f' ({count} times)' if count > 1 else ''}", EXPLAINED)
    sent = Counter(str(message["name"]) for topic, _, message in records if topic == SENT_TOPIC)
    outcome.measured["sent"] = dict(sent)
    return outcome


def compare(airframe: Airframe, part: Samples) -> StepOutcome:
    """What a hover means for the airframe file."""
    outcome = StepOutcome(again=lambda changed: compare(changed, part))
    for sensor in airframe.downward:
        readings = part.readings.get(sensor.name)
        if readings is None:
            outcome.wrong(
                f"flight of {sensor.name}", "no reading", f"msp-range commission {airframe.path} --step wires"
            )
            continue
        _rates(sensor.name, readings, outcome)
    try:
        found = places(part, {sensor.name: sensor.position_m for sensor in airframe.downward})
    except NotMeasured as error:
        outcome.unknown("residuals", str(error))
        return outcome
    _residuals(airframe, found, outcome)
    return outcome


def _rates(name: str, readings: SensorReadings, outcome: StepOutcome) -> None:
    """Shares of missed and rejected readings."""
    total = len(readings.status)
    missed = np.mean(~np.isin(readings.status, ("ok", "at_minimum")))
    reasons = Counter(reason for reason in readings.rejected.tolist() if reason not in ("", "no_echo", "suspect"))
    rejected = np.mean(np.isin(readings.rejected, [*reasons.keys() - {"no_answer", "clock_fault", "impossible"}]))
    listed = ", ".join(
        f"{reason.replace('_', ' ')} {100 * count / total:.0f} %" for reason, count in reasons.most_common(3)
    )
    text = f"{100 * missed:.0f} % without an echo, {100 * rejected:.0f} % rejected{f' ({listed})' if listed else ''}"
    remedy = "prop wash, vibration, soft or rough ground, or a sensor that looks aside: move or damp it, or fly lower"
    outcome.add(f"flight of {name}", (missed > MOST_MISSED or rejected > MOST_REJECTED, text, remedy), (True, text))


def _residuals(airframe: Airframe, found: Places, outcome: StepOutcome) -> None:
    """Places and noise as the flight shows them; tilts are small, so that only large errors sideways are seen."""
    compare_lag(found, outcome)
    in_flight = StepOutcome()
    compare_places(airframe, found, in_flight)
    for proposal in in_flight.proposals:
        outcome.propose(f"in flight: {proposal.text}", *proposal.edits)
    for name in found.elsewhere:
        text = "its distances do not follow the ground of the others"
        outcome.wrong(f"residuals of {name}", text, f"msp-range commission {airframe.path} --step lift")
    outcome.measured["noise_in_flight_cm"] = {name: round(100 * std_m.value, 2) for name, std_m in found.std_m.items()}
    compare_noise(airframe, found.std_m, "in flight", outcome)


def hovering(records: Iterable[Message]) -> Samples | None:
    """The longest part of a flight at one height, well above the ground; None where there is none.

    The records are read twice: a recording is not kept in memory.
    """
    fused = samples_of(records).fused
    if len(fused) < 10:
        return None
    time_s, height_m = fused[:, 0], fused[:, 2]
    least_m = height_m.min() + HIGH_M
    first_s = last_s = time_s[0]
    begin = 0
    for end in range(len(fused)):
        while np.ptp(height_m[begin : end + 1]) > 2 * STEADY_M:
            begin += 1
        is_longer = time_s[end] - time_s[begin] > last_s - first_s
        if is_longer and np.median(height_m[begin : end + 1]) >= least_m:
            first_s, last_s = time_s[begin], time_s[end]
    return samples_of(records, first_s, last_s) if last_s - first_s >= HOVER_S else None


def _recording(session: Session, airframe: Airframe) -> Path | None:
    """The recording that was named, or the newest one of the airframe's folder."""
    if session.recording is not None:
        return session.recording
    return None if airframe.recording is None else newest_recording(airframe.recording.folder)
