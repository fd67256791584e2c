"""Echoes that are too weak from far away."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    beyond_m = np.maximum(scene.range_cm - values["from_cm"], 0.0) / 100.0
    return Contribution(log_odds_missed=values["log_odds_per_m"] * beyond_m)


MISSED_WITH_RANGE = Effect(
    name="missed_with_range",
    sentence="The farther the surface, the more often its echo is too weak to be heard.",
    physics="log odds of a missed echo grow by the same for each metre beyond a range",
    source="sonar equation: level falls with 20 log z and absorption; the straight line is a choice",
    parameters=(
        Parameter("log_odds_per_m", "1/m", "growth of the log odds a metre", -20.0, 20.0),
        Parameter("from_cm", "cm", "range from which on", 0.0, 1000.0, None, 100.0, (0.0, 200.0, 400.0)),
    ),
    requires=("true_range_cm",),
    channels=("missed",),
    experiment="a wall at growing range until its echo is lost",
    apply=_apply,
    base="reading_model.missed_growth_per_m",
)
