"""Effect: echoes from far away are too weak."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    beyond_m = np.maximum(scene.range_cm - values["from_cm"], 0.0) / 100.0
    return Contribution(log_odds_missed=values["log_odds_per_m"] * beyond_m)


MISSED_WITH_RANGE = Effect(
    name="missed_with_range",
    sentence="The farther the surface, the more often its echo is too weak to be detected.",
    finding="beyond {from_cm}, each metre makes missed echoes come {log_odds_per_m:times}",
    physics="log odds of a missed echo grow linearly with range beyond a start",
    source="sonar equation: level falls with 20 log z and absorption; the straight line is an assumption",
    parameters=(
        Parameter("log_odds_per_m", "1/m", "growth of the log odds per metre", -20.0, 20.0),
        Parameter("from_cm", "cm", "range at which the growth starts", 0.0, 1000.0, None, 100.0, (0.0, 200.0, 400.0)),
    ),
    requires=("true_range_cm",),
    channels=("missed",),
    experiment="a wall at growing range until its echo is lost",
    apply=_apply,
    base="reading_model.missed_growth_per_m",
)
