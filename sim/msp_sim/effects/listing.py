"""The catalogue of effects as text and as data, for `msp-lab effects`."""

import textwrap
from collections.abc import Mapping
from typing import Any

from msp_sim.effects.base import Effect, Parameter

_DESCRIBED = ("name", "sentence", "finding", "physics", "source", "channels", "requires", "optional", "per")
_NUMBERS = ("unit", "meaning", "low", "high", "neutral", "default")


def as_data(catalogue: Mapping[str, Effect]) -> list[dict[str, Any]]:
    """All fields of each effect as plain values, for JSON."""
    return [
        {
            **{key: getattr(effect, key) for key in _DESCRIBED},
            "parameters": {
                parameter.name: {key: getattr(parameter, key) for key in _NUMBERS} for parameter in effect.parameters
            },
            "experiment": effect.experiment,
            "calibration": effect.base,
            "equivalent_causes": effect.equivalent_causes,
        }
        for effect in catalogue.values()
    ]


def as_text(catalogue: Mapping[str, Effect]) -> str:
    """One paragraph for each effect."""
    return "\n\n".join(_paragraph(effect) for effect in catalogue.values())


def _paragraph(effect: Effect) -> str:
    lines = [effect.sentence, f"Physics: {effect.physics}. Source: {effect.source}."]
    lines += [_parameter(parameter) for parameter in effect.parameters]
    requires = [*effect.requires, *([f"{effect.per} (one of them)"] if effect.per else [])]
    columns = ", ".join(requires) if requires else "none"
    lines.append(f"Required columns: {columns}. Experiment that shows it alone: {effect.experiment}.")
    if effect.base:
        lines.append(f"The base model has a parameter for it: {effect.base}.")
    if effect.equivalent_causes:
        lines.append(f"Equivalent causes: {', '.join(effect.equivalent_causes)}.")
    body = [textwrap.indent(textwrap.fill(line, 96), "    ") for line in lines]
    return "\n".join([f"{effect.name} ({', '.join(effect.channels)})", *body])


def _parameter(parameter: Parameter) -> str:
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    neutral = (
        f"no effect at {parameter.neutral:g}" if parameter.neutral is not None else f"default {parameter.default:g}"
    )
    return f"{parameter.name}{unit}: {parameter.meaning}; {parameter.low:g} to {parameter.high:g}, {neutral}"
