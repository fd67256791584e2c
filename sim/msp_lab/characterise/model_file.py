"""The sensor model file that a characterisation writes: the starting one with what was fitted, and where it is from.

The starting `SensorModel` with the findings' changes is written as YAML with comments. The text is read back as a
sensor model before it is written, so what is on disk loads.
"""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import to_jsonable_python

from msp_lab.characterise.beam import predict_breakaway
from msp_lab.characterise.findings import Findings
from msp_lab.mixture_fit.parameters import MIN_WEIGHT
from msp_lab.model_text import model_text, rounded
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.error import new_file
from msp_range.yaml_file import ConfigError
from msp_range.yaml_loader import load_yaml
from msp_sim.page.text import capitalised


def changed(sensor: SensorModel, findings: Findings, changes: Mapping[str, Any]) -> SensorModel:
    """The starting model with what was found in it; ConfigError if that does not go with the rest of it."""
    content = sensor.model_dump(mode="json") | to_jsonable_python(changes)
    if "breakaway" in changes and content["heard_on_axis_cm"] is not None:
        content["heard_on_axis_cm"] = max(content["heard_on_axis_cm"], content["breakaway"][-1]["range_cm"])
    # The means over a flight and the predicted angles were those of the starting model.
    content |= {"in_flight": None, "predicted_breakaway": None}
    data = [asdict(source) for source in findings.sources]
    content["evidence"].append({"what": "characterisation", "date": findings.date, "data": data})
    try:
        model = SensorModel.model_validate(rounded(content))
    except ValidationError as error:
        problems = "; ".join(problem["msg"] for problem in error.errors())
        raise ConfigError(f"what was found does not go with the rest of the sensor model: {problems}") from None
    predicted = predict_breakaway(model) if model.medium == "sound" else None
    return model.model_copy(update={"predicted_breakaway": predicted})


def write_new(path: Path, text: str) -> None:
    """Write a file that must not exist yet, and make its folder; RecordingError if it does, or cannot be written."""
    with new_file(path) as unfinished:
        path.parent.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(text, encoding="utf-8")


def commented(sensor: SensorModel, findings: Findings, changes: Mapping[str, Any], start: str) -> str:
    """The text of the new model's file, with a comment over each part on how it was fitted or why it was kept.

    `sensor` is that of `changed`, and `start` is the name of the starting model's file.
    """
    content, kept, fitted = sensor.model_dump(mode="json"), _kept(sensor, findings), _fitted(findings)
    comments = {
        name: fitted[name]
        if name in fitted and name in (*changes, "predicted_breakaway", "evidence")
        else [f"Kept from {start}{': ' if kept.get(name) else ''}{kept.get(name, '')}."]
        for name in content
    }
    heading = f"Sensor model of the {sensor.name}, characterised {findings.date} by msp-lab characterise."
    text = model_text(content, [heading], comments)
    assert SensorModel.model_validate(load_yaml(text)) == sensor, "what is written is not what was found"
    return text


def _kept(sensor: SensorModel, findings: Findings) -> dict[str, str]:
    """Why sections of the starting model were kept, where there is more to say than that."""
    view, calibration = findings.field_of_view, findings.calibration
    return {
        "oblique_reading": view.oblique.reason if view else "no angles were measured",
        "breakaway": "no breakaway angle was measured",
        "calibration": calibration.reason if calibration else "nothing was measured on the axis",
        "reading_model": findings.absent.get("mixture", "nothing was fitted"),
        "effects": "added to another base than this one" if sensor.effects else "",
    }


def _fitted(findings: Findings) -> dict[str, list[str]]:
    """How fields of the new model were found, where they can be."""
    found = {
        "predicted_breakaway": ["Beyond these angles, for sound: by the sonar equation that is fitted to them."],
        "evidence": ["What this file was made from, the newest last."],
        "resolution_cm": ["Step of the readings."],
        "heard_on_axis_cm": ["Fitted: longest range of the maximum range experiment that was read reliably."],
    }
    view, calibration, mixture = findings.field_of_view, findings.calibration, findings.mixture
    if view is not None:
        shown = ", ".join(f"{angle.range_cm:g} cm {angle.half_angle}" for angle in view.angles)
        found["oblique_reading"] = [f"Fitted: {view.oblique.reason}."]
        smaller = f"Fitted: the smaller of both sides: {shown}."
        found["breakaway"] = [smaller, f"Reliable: {view.criterion}."]
    if calibration is not None:
        std_cm, bias = calibration.reference_std_cm, calibration.bias
        stated = "is not stated" if std_cm is None else f"of {std_cm:g} cm is in it"
        reason = capitalised(calibration.reason)
        mean = f"Mean error {bias} over {bias.n} points; the reference's own {stated}."
        found["calibration"] = [f"Fitted: {calibration.form}. {reason}. {mean}"]
        if calibration.set_up_offset is not None:
            between = f"an offset that differs between placements, {calibration.set_up_offset}"
            found["effects"] = [f"Fitted: {between}, beyond the error of their true ranges."]
    if mixture is not None:
        shown = "; ".join(
            f"{parameter.name} {parameter.fitted}{', at its bound' if parameter.at_bound else ''}"
            for parameter in mixture.parameters
        )
        found["reading_model"] = [
            f"Fitted to {mixture.readings} undisturbed readings by maximum likelihood, 95 % intervals: {shown}.",
            "These were measured on a bench. A vehicle shakes, and there are objects below it: kinds of reading that "
            f"the bench did not show have a weight of {MIN_WEIGHT:g}, and a filter with this spread may be "
            "overconfident.",
        ]
    return found
