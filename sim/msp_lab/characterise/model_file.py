"""The sensor model file that a characterisation writes: the starting one with what was fitted, and where it is from.

A starting `SensorModel`, findings and changes enter, YAML with comments leaves. The text is read back as a sensor model
before it is written, so what is on disk loads.
"""

import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from pydantic_core import to_jsonable_python

from msp_lab.characterise.analysis import Changes, provenance
from msp_lab.characterise.findings import Findings
from msp_lab.characterise.point_findings import IntervalEstimate
from msp_range.reading_model.fit_result import MIN_WEIGHT
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import ConfigError
from msp_range.yaml_loader import load_yaml

_DIGITS = 6
_WRAPPER = textwrap.TextWrapper(width=118, break_long_words=False, break_on_hyphens=False)


def changed(sensor: SensorModel, findings: Findings, changes: Changes) -> SensorModel:
    """The starting model with what was found in it.

    Raises
    ------
    ConfigError
        What was found cannot be a sensor model together with the rest of the starting one.
    """
    fields = {name: value for name, value in vars(changes).items() if value is not None}
    if "breakaway" in fields:
        farthest_cm = fields["breakaway"][-1].range_cm
        heard_cm = fields.get("heard_on_axis_cm", sensor.heard_on_axis_cm)
        fields["heard_on_axis_cm"] = None if heard_cm is None else max(heard_cm, farthest_cm)
    content = sensor.model_dump(mode="json")
    content |= to_jsonable_python(fields)
    # The means over a flight were those of the starting model.
    content |= {"in_flight": None, "evidence": [*content["evidence"], provenance(findings)]}
    try:
        return SensorModel.model_validate(_rounded(content))
    except ValidationError as error:
        problems = "; ".join(each["msg"] for each in error.errors())
        raise ConfigError(f"what was found does not go with the rest of the sensor model: {problems}") from None


def write_model(path: Path, sensor: SensorModel, findings: Findings, changes: Changes, started_from: str) -> None:
    """Write the model file.

    Parameters
    ----------
    path
        Where; there must be no file yet. Folders that are missing are made.
    sensor
        The new model, from `changed`.
    findings, changes
        For the comments: what was fitted and what was kept.
    started_from
        Name of the starting model's file.

    Raises
    ------
    ConfigError
        There is a file already, or it cannot be written.
    """
    text = model_text(sensor, findings, changes, started_from)
    assert SensorModel.model_validate(load_yaml(text)) == sensor, "what is written is not what was found"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise ConfigError(f"{path}: there is a file already, and none is overwritten") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be written: {error.strerror}") from None


def model_text(sensor: SensorModel, findings: Findings, changes: Changes, started_from: str) -> str:
    """Return the model file's text, with a comment over each part on whether it was fitted."""
    content = sensor.model_dump(mode="json")
    kept = f"Kept from {started_from}"
    sections: list[tuple[list[str], Sequence[str]]] = [
        ([kept + "."], ("name", "maker", "driver", "medium", "minimum_cm", "maximum_cm")),
        ([f"{kept}." if changes.resolution_cm is None else "Step of the readings."], ("resolution_cm",)),
        ([kept + "."], ("calibration_temperature_c",)),
        (_oblique_comment(findings, changes, kept), ("oblique_reading",)),
        ([kept + "."], ("timing", "frequency_hz")),
        (_breakaway_comment(findings, changes, kept), ("breakaway",)),
        (_on_axis_comment(findings, changes, kept), ("heard_on_axis_cm",)),
        (_calibration_comment(findings, changes, kept), ("calibration",)),
        (_mixture_comment(findings, changes, kept), ("reading_model",)),
        (_effects_comment(sensor, findings, changes, kept), ("effects", "in_flight")),
        (["What this file was made from, the newest last."], ("evidence",)),
    ]
    named = {name for _, names in sections for name in names}
    assert named == set(content), f"no section for {set(content) ^ named}"
    lines = [f"# Sensor model of the {sensor.name}, characterised {findings.date} by msp-lab characterise.", ""]
    for comments, names in sections:
        lines += [f"# {line}" for comment in comments for line in _WRAPPER.wrap(comment)]
        lines += [_yaml(name, content[name]) for name in names]
        lines.append("")
    return "\n".join(lines)


def _oblique_comment(findings: Findings, changes: Changes, kept: str) -> list[str]:
    view = findings.field_of_view
    if view is None:
        return [f"{kept}: no angles were measured."]
    if changes.oblique_reading is None:
        return [f"{kept}: {view.oblique.reason}."]
    return [f"Fitted: {view.oblique.reason}."]


def _breakaway_comment(findings: Findings, changes: Changes, kept: str) -> list[str]:
    view = findings.field_of_view
    if changes.breakaway is None or view is None:
        return [f"{kept}: no breakaway angle was measured."]
    shown = ", ".join(f"{each.range_cm:g} cm {_interval(each.half_angle, 1)}" for each in view.angles)
    return [f"Fitted: the smaller of both sides [deg]: {shown}.", f"Reliable: {view.criterion}."]


def _on_axis_comment(findings: Findings, changes: Changes, kept: str) -> list[str]:
    if changes.heard_on_axis_cm is None:
        return [f"{kept}."]
    return ["Fitted: longest range of the maximum range experiment that was read reliably."]


def _calibration_comment(findings: Findings, changes: Changes, kept: str) -> list[str]:
    found = findings.calibration
    if changes.calibration is None or found is None:
        return [f"{kept}: {found.reason if found else 'nothing was measured on the axis'}."]
    stated = "is not stated" if found.reference_std_cm is None else f"of {found.reference_std_cm:g} cm is in it"
    bias = f"Mean error {_interval(found.bias, 2)} cm over {found.bias.n} points; the reference's own {stated}."
    return [f"Fitted: {found.form}. {found.reason[0].upper()}{found.reason[1:]}. {bias}"]


def _effects_comment(sensor: SensorModel, findings: Findings, changes: Changes, kept: str) -> list[str]:
    found = [f"{kept}: added to another base than this one." if sensor.effects else kept + "."]
    if changes.effects is None or findings.calibration is None or findings.calibration.set_up_offset is None:
        return found
    between = _interval(findings.calibration.set_up_offset, 2)
    return [f"Fitted: an offset that differs between placements, {between} cm, beyond the error of their true ranges."]


def _mixture_comment(findings: Findings, changes: Changes, kept: str) -> list[str]:
    found = findings.mixture
    if changes.reading_model is None or found is None:
        return [f"{kept}: {findings.absent.get('mixture', 'nothing was fitted')}."]
    shown = "; ".join(
        f"{each.name} {_interval(each.fitted, 4)}{', at its bound' if each.at_bound else ''}"
        for each in found.parameters
    )
    return [
        f"Fitted to {found.readings} undisturbed readings by maximum likelihood, 95 % intervals: {shown}.",
        "These were measured on a bench. A vehicle shakes, and there are objects below it: kinds of reading that the "
        f"bench did not show have a weight of {MIN_WEIGHT:g}, and a filter with this spread may be overconfident.",
    ]


def _interval(estimate: IntervalEstimate, digits: int) -> str:
    low, high = ("?" if end is None else f"{round(end, digits):g}" for end in (estimate.low, estimate.high))
    return f"{round(estimate.value, digits):g} ({low} to {high})"


def _yaml(name: str, value: Any) -> str:
    # A number or a word alone, or none of several, stands behind its name.
    flow = False if not isinstance(value, dict | list) or not value else None
    text: str = yaml.safe_dump({name: value}, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=118)
    return text.rstrip()


def _rounded(value: Any) -> Any:
    """Numbers to six significant digits: what a person reads, and more than any of them is known to."""
    if isinstance(value, dict):
        return {name: _rounded(each) for name, each in value.items()}
    if isinstance(value, list):
        return [_rounded(each) for each in value]
    return float(f"{value:.{_DIGITS}g}") if isinstance(value, float) else value
