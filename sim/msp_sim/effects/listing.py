"""The catalogue for people and for other programs."""

import textwrap
from collections.abc import Mapping
from typing import Any

from msp_sim.effects.base import Effect, Parameter

_INDENT = "    "
_WIDTH = 100


def as_data(catalogue: Mapping[str, Effect]) -> list[dict[str, Any]]:
    """Everything that is known of each effect, as plain values."""
    return [
        {
            "name": effect.name,
            "sentence": effect.sentence,
            "physics": effect.physics,
            "source": effect.source,
            "channels": list(effect.channels),
            "requires": list(effect.requires),
            "optional": list(effect.optional),
            "per": effect.per,
            "parameters": {
                each.name: {
                    "unit": each.unit,
                    "meaning": each.meaning,
                    "low": each.low,
                    "high": each.high,
                    "neutral": each.neutral,
                    "default": each.default,
                }
                for each in effect.parameters
            },
            "experiment": effect.experiment,
            "calibration": effect.base,
            "equivalent_causes": list(effect.equivalent_causes),
        }
        for effect in catalogue.values()
    ]


def as_text(catalogue: Mapping[str, Effect]) -> str:
    """A paragraph for each effect."""
    return "\n\n".join(_paragraph(effect) for effect in catalogue.values())


def _paragraph(effect: Effect) -> str:
    lines = [effect.sentence, f"Physics: {effect.physics}. Source: {effect.source}."]
    lines += [_parameter(each) for each in effect.parameters]
    needs = [*effect.requires, *([f"{effect.per} (of one)"] if effect.per else [])]
    lines.append(f"Needs: {', '.join(needs) if needs else 'nothing'}. Shown alone by: {effect.experiment}.")
    if effect.base:
        lines.append(f"The base mixture has it too: {effect.base}.")
    if effect.equivalent_causes:
        lines.append(f"Looks the same: {', '.join(effect.equivalent_causes)}.")
    body = [textwrap.fill(line, _WIDTH, initial_indent=_INDENT, subsequent_indent=_INDENT) for line in lines]
    return "\n".join([f"{effect.name} ({', '.join(effect.channels)})", *body])


def _parameter(parameter: Parameter) -> str:
    unit = "" if parameter.unit == "1" else f" [{parameter.unit}]"
    at_rest = f"none at {parameter.neutral:g}" if parameter.neutral is not None else f"{parameter.default:g} if left out"
    return f"{parameter.name}{unit}: {parameter.meaning}; {parameter.low:g} to {parameter.high:g}, {at_rest}"
