"""Effect: an error that comes and goes with the time of day."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    turn = 2.0 * np.pi / 24.0 * (scene["time_of_day_h"] - values["hour_h"])
    return Contribution(bias_cm=values["swing_cm"] * np.cos(turn))


DAY_CYCLE = Effect(
    name="day_cycle",
    sentence="Readings are too far at one time of day and too near twelve hours later, every day.",
    finding="every day readings are {swing_cm:too far|too near} at {hour_h}, and the reverse twelve hours later",
    physics="swing cos(2 pi (hour - hour_h) / 24)",
    source="sun on a housing, its mast and the surface: each heats and cools with the day, and is in no column",
    parameters=(
        Parameter("swing_cm", "cm", "error at that hour", -20.0, 20.0),
        # With either sign half a day is all phases; beyond it a fit may go on.
        Parameter("hour_h", "h", "hour of the largest error", -12.0, 24.0, None, 3.0, (0.0, 3.0, 6.0, 9.0)),
    ),
    requires=("true_range_cm", "time_of_day_h"),
    channels=("bias",),
    experiment="a fixed target for three days, with the sensor in the shade on every second one",
    apply=_apply,
    equivalent_causes=("the same of the reference",),
)
