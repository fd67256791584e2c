"""The text of a sensor model file, as characterise and the gap workflow write it: parts with comments over them."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import yaml

WIDTH = 118
"""Characters of a line, behind the ``# `` of a comment: 120 with it, as in all of the project's files."""
_SECTIONS = (
    ("name", "maker", "driver", "medium", "minimum_cm", "maximum_cm"),
    ("resolution_cm",),
    ("calibration_temperature_c",),
    ("oblique_reading", "compensates_air"),
    ("timing", "frequency_hz"),
    ("breakaway",),
    ("predicted_breakaway",),
    ("heard_on_axis_cm",),
    ("calibration", "calibration_scale_std_pct"),
    ("reading_model",),
    ("effects", "in_flight"),
    ("evidence",),
)
"""Fields that stand below one comment, which is about the first of them."""


def rounded(value: Any) -> Any:
    """Numbers to six significant digits: what a person reads, and more than any of them is known to."""
    if isinstance(value, Mapping):
        return {name: rounded(each) for name, each in value.items()}
    if isinstance(value, list | tuple):
        return [rounded(each) for each in value]
    return float(f"{value:.6g}") if isinstance(value, float) else value


def model_text(content: Mapping[str, Any], heading: Sequence[str], comments: Mapping[str, Sequence[str]]) -> str:
    """The file's text: heading, and the fields of a sensor model with comments over the part that a field begins."""
    named = {name for names in _SECTIONS for name in names}
    assert named == set(content), f"no section for {set(content) ^ named}"
    lines = [*_comment(heading), ""]
    for names in _SECTIONS:
        lines += [*_comment(comments.get(names[0], ())), *(_yaml(name, content[name]) for name in names), ""]
    return "\n".join(lines)


def _comment(texts: Iterable[str]) -> list[str]:
    return [
        f"# {line}"
        for text in texts
        for line in textwrap.wrap(text, WIDTH, break_long_words=False, break_on_hyphens=False)
    ]


def _yaml(name: str, value: Any) -> str:
    # A number or a word alone, or none of several, stands behind its name.
    flow = False if not isinstance(value, dict | list) or not value else None
    text: str = yaml.safe_dump({name: value}, sort_keys=False, allow_unicode=True, default_flow_style=flow, width=WIDTH)
    return text.rstrip()
