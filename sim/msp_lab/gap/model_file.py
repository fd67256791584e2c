"""The model file that the gap workflow writes: the given model, what was added to it, and the evidence for that.

The extended model and the findings are written as YAML. The text is read back as a model before it is written, so what
is on disk loads, and flies.
"""

from pathlib import Path
from typing import Any

from pydantic import ValidationError

from msp_lab.gap.extended_model import to_sensor
from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.model_text import model_text, rounded
from msp_range.reading_model.sensor_model import InFlight, SensorModel
from msp_range.yaml_file import ConfigError, writing
from msp_range.yaml_loader import load_yaml
from msp_sim.model.model import Model

MODEL = "model.yaml"
TRAINING_FIT = "model_training_fit.yaml"


def extended_text(model: Model, findings: GapFindings, heading: str, flown: InFlight | None = None) -> str:
    """The text of the extended model's file, with what was added and why, and a heading as its first line.

    `flown` is what the effects make of the readings of a flight, for the bridge. ConfigError if what was added does not
    go with the rest of the model.
    """
    content = to_sensor(model).model_dump(mode="json")
    content["in_flight"] = flown if flown is None else flown.model_dump()
    content["effects"] = _with_evidence(content["effects"], findings)
    content["evidence"] = [*content["evidence"], _calibrated(findings)]
    text = model_text(rounded(content), [heading, findings.sentence], {})
    try:
        Model.of(SensorModel.model_validate(load_yaml(text)))
    except (ValidationError, ConfigError) as error:
        raise ConfigError(f"what was added does not make a model file: {error}") from None
    return text


def write_model(path: Path, model: Model, findings: GapFindings, heading: str, flown: InFlight | None = None) -> None:
    """Write `extended_text`; an older file of this name is replaced. ConfigError also if it cannot be written."""
    text = extended_text(model, findings, heading, flown)
    with writing(path):
        path.write_text(text, encoding="utf-8")


def _with_evidence(entries: list[dict[str, Any]], findings: GapFindings) -> list[dict[str, Any]]:
    """The entries of the added effects, which are the last ones, with intervals and evidence."""
    effects = {(each.name, each.of): each for each in findings.effects}
    curves = {(each.channel, each.variables, each.period): each for each in findings.unknown}
    found = []
    for entry in reversed(entries):
        effect = effects.pop((entry["name"], entry.get("of")), None)
        knots = entry.get("knots", [None])[0]
        period = knots["period"] if isinstance(knots, dict) else None
        curve = curves.pop((entry.get("channel", ""), tuple(entry.get("variables", ())), period), None)
        if effect is not None:
            values = {name: _value(name, value, effect) for name, value in entry.get("parameters", {}).items()}
            entry = {**entry, "parameters": values, "evidence": _of_effect(effect, findings)}
        elif curve is not None:
            entry = {**entry, "evidence": _of_curve(curve, findings)}
        found.append(entry)
    return found[::-1]


def _value(name: str, value: float, effect: FoundEffect) -> Any:
    found = effect.parameters.get(name)
    if found is None or found.low is None or found.high is None:
        return value
    return {"value": value, "low": found.low, "high": found.high, "unit": found.unit}


def _of_effect(effect: FoundEffect, findings: GapFindings) -> dict[str, Any]:
    return {
        **_provenance(findings),
        "verdict": effect.verdict,
        "gain_nats_per_reading": effect.gain_nats,
        "z": effect.z,
        "alternatives": [
            other.name if other.of is None else f"{other.name} of {other.of}" for other in effect.alternatives
        ],
        "experiment": effect.experiment,
    }


def _of_curve(curve: UnknownEffect, findings: GapFindings) -> dict[str, Any]:
    return {
        **_provenance(findings),
        "verdict": "unknown",
        "formula": curve.formula,
        "gain_nats_per_reading": curve.gain_nats,
        "alternatives": [],
    }


def _provenance(findings: GapFindings) -> dict[str, Any]:
    """Data, date, and the gap before and after."""
    found: dict[str, Any] = {
        "date": findings.date,
        "data": [{"name": Path(each.path).name, "sha256": each.sha256, "rows": each.rows} for each in findings.sources],
    }
    if findings.gap is not None:
        for side in ("before", "after"):
            found[f"gap_{side}"] = {name: getattr(each, side) for name, each in findings.gap.measures.items()}
    return found


def _calibrated(findings: GapFindings) -> dict[str, Any]:
    """For the model's own list: what this file was made from, and which of its base numbers changed."""
    return {
        "made_by": "msp-lab gap",
        "from": Path(findings.settings.model).name,
        **_provenance(findings),
        "verdict": findings.verdict,
        "calibration": [each.finding for each in findings.calibration],
    }
