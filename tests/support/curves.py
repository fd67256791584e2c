"""Models with an unknown effect."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from msp_sim.effects.curve import Knots
from msp_sim.model.model import Model, make_curve_term


def with_curve(
    model: Model, channel: Any, variables: Sequence[str], knots: Sequence[Knots], values: Sequence[float]
) -> Model:
    """A model with one more effect: a curve, given by its values at the knots."""
    return replace(model, effects=(*model.effects, make_curve_term(channel, variables, knots, values)))
