"""Files of a gap run's folder: ``gap.json``, what the workflow found, and ``named.json``, for `add` to go on from.

In ``named.json`` numbers keep all their digits, so that `add` ends with the same model whether it follows at once or a
day later.

And the model file: the given model, what was added to it, and the evidence for that. Its text is read back as a model
before it is written, so what is on disk loads, and flies.
"""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from msp_lab.gap.extended_model import entry_of, to_sensor
from msp_lab.gap.findings import FoundEffect, GapFindings, UnknownEffect
from msp_lab.gap.naming import ExtendedModels, ModelStep
from msp_lab.model_text import model_text, rounded
from msp_range.input_file import read_text
from msp_range.reading_model.sensor_model import InFlight, SensorModel
from msp_range.yaml_file import ConfigError, writing
from msp_range.yaml_loader import load_yaml
from msp_sim.model.model import Model

NUMBERS, NAMED = "gap.json", "named.json"
LARGEST_BYTES = 64 * 2**20
"""A larger file was not written by the gap workflow, whose files have 0.1 to 1 MB."""

Content = TypeVar("Content")
MODEL = "model.yaml"
TRAINING_FIT = "model_training_fit.yaml"


@cache
def _form() -> TypeAdapter[GapFindings]:
    return TypeAdapter(GapFindings)


def as_json(findings: GapFindings) -> str:
    """Findings as JSON, numbers to seven digits; what is not finite is null.

    Examples
    --------
    >>> found = GapFindings("nothing missing", rows=2000, runs=10)
    >>> from_json(as_json(found)) == found
    True
    """
    content = json.loads(_form().dump_json(findings), parse_float=lambda number: float(f"{float(number):.7g}"))
    return json.dumps(content, indent=2, ensure_ascii=False) + "\n"


def from_json(text: str) -> GapFindings:
    """`as_json` backwards.

    Raises
    ------
    ValueError
        It is no such JSON.
    """
    try:
        return _form().validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise ValueError(f"not written by msp-lab gap: {place + ': ' if place else ''}{first['msg']}") from None


def write_findings(findings: GapFindings, folder: Path) -> None:
    """Write ``gap.json`` into a folder; an older one is replaced.

    Raises
    ------
    ConfigError
        It cannot be written.
    """
    with writing(folder / NUMBERS):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / NUMBERS).write_text(as_json(findings), encoding="utf-8")


def read_findings(folder: Path) -> GapFindings:
    """Read ``gap.json`` of a folder.

    Raises
    ------
    ConfigError
        There is none, or it is none.
    """
    return _read(folder / NUMBERS, "'msp-lab compare' or 'msp-lab gap' makes it", from_json)


def write_named(models: ExtendedModels, findings: GapFindings, folder: Path) -> None:
    """Write ``named.json``; an older one is replaced.

    Raises
    ------
    ConfigError
        It cannot be written.
    """
    given = len(models.path[0].model.effects)
    content = {
        "terms": [entry_of(term) for term in models.training_fit.effects[given:]],
        "split": {"training_runs": findings.training_runs, "held_out_runs": findings.held_out_runs},
        "training_fit": _content(models.training_fit),
        "final_fit": _content(models.final_fit),
        "path": [{"added": step.added, "model": _content(step.model)} for step in models.path],
        "findings": _form().dump_python(findings, mode="json"),
    }
    with writing(folder / NAMED):
        (folder / NAMED).write_text(json.dumps(content, ensure_ascii=False) + "\n", encoding="utf-8")


def read_named(folder: Path) -> tuple[ExtendedModels, GapFindings]:
    """Read ``named.json``.

    Raises
    ------
    ConfigError
        There is none, or it is not one that `name` wrote.
    """

    def parse(text: str) -> tuple[ExtendedModels, GapFindings]:
        try:
            content = json.loads(text)
            given = len(_model(content["path"][0]["model"]).effects)
            models = ExtendedModels(
                _model(content["training_fit"]).added_from(given),
                _model(content["final_fit"]).added_from(given),
                tuple(ModelStep(step["added"], _model(step["model"]).added_from(given)) for step in content["path"]),
            )
            return models, _form().validate_python(content["findings"])
        except (ValidationError, ValueError, KeyError, IndexError, TypeError):
            raise ValueError(f"not written by msp-lab name; run 'msp-lab name {folder}' again") from None

    return _read(folder / NAMED, f"run 'msp-lab name {folder}' first", parse)


def _read(path: Path, to_do: str, parse: Callable[[str], Content]) -> Content:
    """What a file holds; ConfigError where there is none, with what is to be done, or where it holds something else."""
    try:
        return parse(read_text(path, LARGEST_BYTES))
    except NotADirectoryError:
        raise ConfigError(f"{path.parent}: is a file; expected the folder that 'msp-lab gap' wrote (--out)") from None
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; {to_do}") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: {error}") from None


def _content(model: Model) -> dict[str, Any]:
    return to_sensor(model).model_dump(mode="json")


def _model(content: Any) -> Model:
    return Model.of(SensorModel.model_validate(content))


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
    effects = {(effect.name, effect.of): effect for effect in findings.effects}
    curves = {(curve.channel, curve.variables, curve.period): curve for curve in findings.unknown}
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
        "data": [{"name": Path(file.path).name, "sha256": file.sha256, "rows": file.rows} for file in findings.sources],
    }
    if findings.gap is not None:
        for side in ("before", "after"):
            found[f"gap_{side}"] = {name: getattr(measure, side) for name, measure in findings.gap.measures.items()}
    return found


def _calibrated(findings: GapFindings) -> dict[str, Any]:
    """For the model's own list: what this file was made from, and which of its base numbers changed."""
    return {
        "made_by": "msp-lab gap",
        "from": Path(findings.settings.model).name,
        **_provenance(findings),
        "verdict": findings.verdict,
        "calibration": [number.finding for number in findings.calibration],
    }
