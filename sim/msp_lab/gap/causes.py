"""Why a number of the base model may be another one, where the readings cannot say: which column did not vary.

For each number of the calibration findings these are the effects that would change it, with the column whose variation
would show them. A gap that calibration closes is absorbed, not explained: more scatter over a throttle that never
changes is rotor noise or is not.
"""

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from msp_lab.gap.experiment import SPANS
from msp_lab.gap.findings import CalibrationFinding, PossibleCause
from msp_lab.gap.runs import known_values
from msp_sim.effects import CATALOGUE
from msp_sim.effects.base import TRUE_RANGE, WORD_COLUMNS, Channel, Effect
from msp_sim.model.model import Model

CHANNELS: Mapping[str, Channel] = {
    "offset_cm": "bias",
    "sigma_cm": "spread",
    "short": "short",
    "missed": "missed",
    "random": "random",
}
"""What a number of the base changes; the last part of its name. Other numbers (correlation, tails) have no such causes.
"""
VARIED_SHARE = 1.0 / 3.0
"""A column has varied enough to show an effect if nine of ten readings spread over this share of what can reasonably be
varied (`experiment.SPANS`); below that a change of the base's number fits as well. With 1/4 to 1/2 the recorded flights
of the tests read the same."""


def possible_causes(
    calibration: Iterable[CalibrationFinding], model: Model, contexts: Mapping[str, Any]
) -> tuple[PossibleCause, ...]:
    """Effects that calibration may have absorbed, those first whose column explains most numbers.

    Parameters
    ----------
    calibration
        Numbers of the base that were found to be others.
    model
        The given model.
    contexts
        Columns of the readings, (n,) each.
    """
    found = [cause for each in calibration for cause in _causes_of(each.name, model, contexts)]
    columns = [each.column for each in found]
    return tuple(sorted(found, key=lambda each: (not each.recorded, -columns.count(each.column))))


def _causes_of(number: str, model: Model, contexts: Mapping[str, Any]) -> Iterator[PossibleCause]:
    channel = CHANNELS.get(number.rpartition(".")[2])
    known = {each.effect.name for each in model.effects}
    for effect in CATALOGUE.values():
        if channel not in effect.channels or effect.name in known or not effect.happens_to(model.sensor):
            continue
        lacking = [each for each in _special(effect) if not _varied(each, contexts)]
        if len(lacking) == 1:
            yield PossibleCause(number, effect.name, lacking[0], lacking[0] in contexts, effect.experiment)


def _special(effect: Effect) -> list[str]:
    """Columns that show the effect; a word cannot be varied, and the range always is."""
    return [each for each in effect.requires if each not in WORD_COLUMNS and each != TRUE_RANGE]


def _varied(column: str, contexts: Mapping[str, Any]) -> bool:
    if column not in contexts:
        return False
    values = known_values(contexts[column])
    if not values.size:
        return False
    spread = float(np.ptp(np.quantile(values, [0.05, 0.95])))
    if column not in SPANS:
        return spread > 0.0
    low, high = SPANS[column]
    return spread >= VARIED_SHARE * (high - low)
