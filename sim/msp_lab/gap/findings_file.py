"""Files of a gap run's folder: ``gap.json``, what the workflow found, and ``named.json``, for `add` to go on from.

In ``named.json`` numbers keep all their digits, so that `add` ends with the same model whether it follows at once or a
day later.
"""

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from msp_lab.gap.extended_model import entry_of, to_sensor
from msp_lab.gap.findings import GapFindings
from msp_lab.gap.naming import ExtendedModels, ModelStep
from msp_range.input_file import read_text
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import ConfigError, writing
from msp_sim.model.model import Model

NUMBERS, NAMED = "gap.json", "named.json"
LARGEST_BYTES = 64 * 2**20
"""A larger file was not written by the gap workflow, whose files have 0.1 to 1 MB."""

Content = TypeVar("Content")


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
        "terms": [entry_of(each) for each in models.training_fit.effects[given:]],
        "split": {"training_runs": findings.training_runs, "held_out_runs": findings.held_out_runs},
        "training_fit": _content(models.training_fit),
        "final_fit": _content(models.final_fit),
        "path": [{"added": each.added, "model": _content(each.model)} for each in models.path],
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
                tuple(ModelStep(each["added"], _model(each["model"]).added_from(given)) for each in content["path"]),
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
