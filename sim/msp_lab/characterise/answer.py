"""What a characterisation comes to, in a few sentences: the first that page and terminal show."""

from msp_lab.characterise.findings import Findings, Form
from msp_lab.characterise.page.text import minus, plus
from msp_lab.characterise.questions import TOPICS

_CALIBRATION: dict[Form, str] = {
    "none": "a calibration would not improve them",
    "offset and scale": "a straight line corrects them",
    "piecewise linear": "a calibration of straight pieces corrects them",
}


def summarise(findings: Findings) -> str:
    """Return what these readings are worth, in a few sentences: error, spread, missed echoes, and what matters.

    Examples
    --------
    >>> summarise(Findings("HC-SR04", "2026-10-05", 20.0, (), ()))
    'These data do not say how accurate the HC-SR04 is.'
    """
    calibration, base = findings.calibration, findings.baseline
    if calibration is None:
        parts = [f"These data do not say how accurate the {findings.sensor} is."]
    else:
        bias_cm = (calibration if base is None else base).bias.value
        form = _CALIBRATION[calibration.form] if calibration.held_out else "there are too few ranges for a calibration"
        parts = [
            f"Hits of the {findings.sensor} are off by {plus(bias_cm, 2)} cm on average and scatter by "
            f"{calibration.spread.value:.2g} cm; {form}."
        ]
    if base is not None:
        parts.append(
            f"With nothing varied {100.0 * base.missed.value:.2g} % of the echoes are missed and "
            f"{100.0 * base.outliers.value:.2g} % of the readings are of something else."
        )
    names = dict.fromkeys(each.name for each in findings.questions)
    verdicts = {name: {each.verdict for each in findings.questions if each.name == name} for name in names}
    matters = [TOPICS[name].matters for name in names if "matters" in verdicts[name]]
    open_ = [
        TOPICS[name].matters for name in names if "matters" not in verdicts[name] and "cannot tell" in verdicts[name]
    ]
    parts += [f"What changes the readings: {', '.join(matters)}."] if matters else []
    parts += [f"What may, which these data cannot decide: {', '.join(open_)}."] if open_ else []
    return minus(" ".join(parts))
