"""``named.json``: what `name` found, for `add` to go on from.

Findings and models enter a folder, and come back. Numbers keep all their digits, so that `add` ends with the same model
whether it follows at once or a day later.
"""

import json
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from msp_lab.gap.extended_model import entry_of, to_sensor
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.findings_file import LARGEST_BYTES, findings_form
from msp_lab.gap.naming import ExtendedModels, ModelStep
from msp_range.input_file import read_text
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import ConfigError, writing
from msp_sim.model.model import Model

NAMED = "named.json"


def write_named(models: ExtendedModels, findings: GapFindings, folder: Path) -> None:
    """Write the file; an older one is replaced.

    Raises
    ------
    ConfigError
        It cannot be written.
    """
    given = len(models.path[0].model.effects)
    content = {
        "terms": [entry_of(each) for each in models.training_fit.effects[given:]],
        "split": {"training_runs": findings.training_runs, "held_out_runs": findings.held_out_runs},
        "training_fit": _content(models.training_fit),
        "final_fit": _content(models.final_fit),
        "path": [{"added": each.added, "model": _content(each.model)} for each in models.path],
        "findings": findings_form().dump_python(findings, mode="json"),
    }
    path = folder / NAMED
    with writing(path):
        path.write_text(json.dumps(content, ensure_ascii=False) + "\n", encoding="utf-8")


def read_named(folder: Path) -> tuple[ExtendedModels, GapFindings]:
    """Read the file.

    Raises
    ------
    ConfigError
        There is none, or it is not one that `name` wrote.
    """
    path = folder / NAMED
    try:
        content = json.loads(read_text(path, LARGEST_BYTES))
        given = len(_model(content["path"][0]["model"]).effects)
        models = ExtendedModels(
            _model(content["training_fit"]).added_from(given),
            _model(content["final_fit"]).added_from(given),
            tuple(ModelStep(each["added"], _model(each["model"]).added_from(given)) for each in content["path"]),
        )
        return models, findings_form().validate_python(content["findings"])
    except FileNotFoundError:
        raise ConfigError(f"{path}: no such file; run 'msp-lab name {folder}' first") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except (ValidationError, ValueError, KeyError, IndexError, TypeError):
        raise ConfigError(f"{path}: not written by msp-lab name; run 'msp-lab name {folder}' again") from None


def _content(model: Model) -> dict[str, Any]:
    return to_sensor(model).model_dump(mode="json")


def _model(content: Any) -> Model:
    return Model.of(SensorModel.model_validate(content))
