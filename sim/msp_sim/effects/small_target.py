"""Effect: a small target returns a weaker echo than a wall."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    wavelength_m = scene.assumed_m_s / scene.sensor.frequency_hz
    area_m2 = (np.maximum(scene["target_size_cm"], 0.1) / 100.0) ** 2
    far = np.maximum(scene.range_cm, 1.0) / 100.0 * wavelength_m / (2.0 * area_m2)
    weaker_db = 20.0 * np.log10(np.maximum(far, 1.0))
    return Contribution(log_odds_missed=values["log_odds_per_10db"] * weaker_db / 10.0)


SMALL_TARGET = Effect(
    name="small_target",
    sentence="A small target returns a weaker echo than a wall, so from far away its echo is missed.",
    finding="each 10 dB that small targets reflect less makes missed echoes come {log_odds_per_10db:times}",
    physics=(
        "beyond z = 2 A / lambda a square plate of area A gives an echo 20 log(z lambda / 2 A) dB weaker than a wall; "
        "log odds of a missed echo grow linearly with that"
    ),
    source="msp_sim.acoustics.spreading (plate_cross_section_m2, plate_spreading); the growth is an assumption",
    parameters=(Parameter("log_odds_per_10db", "1", "growth of the log odds per 10 dB", 0.0, 50.0),),
    requires=("true_range_cm", "target_size_cm"),
    channels=("missed",),
    experiment="plates of 20, 10 and 5 cm at increasing range",
    apply=_apply,
    media=("sound", "light"),
)
