"""Effect: a surface is tilted so far that its echo misses the sensor."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values


def _apply(scene: Scene, values: Values) -> Contribution:
    beam = scene.sensor.beam
    narrower = beam.half_angle_rad(scene.range_cm / 100.0) / beam.half_angle_rad(1.0)
    half_angle_deg = values["breakaway"] * np.degrees(beam.half_angle_rad(1.0)) * narrower ** values["narrowing"]
    beyond_deg = np.maximum(np.abs(scene["incidence_deg"]) - half_angle_deg, 0.0)
    return Contribution(log_odds_missed=values["log_odds"] * np.minimum(beyond_deg / values["over_deg"], 1.0))


BEYOND_FIELD_OF_VIEW = Effect(
    name="beyond_field_of_view",
    sentence="A surface tilted beyond the beam's breakaway angle reflects the sound away, and no echo comes back.",
    finding="tilt beyond {breakaway:number} of the breakaway angle makes missed echoes come {log_odds:times}",
    physics=(
        "log odds of a missed echo grow linearly with the angle beyond the breakaway angle at that range, up to what a "
        "rough surface scatters; with log_odds 10 a single echo there is nearly impossible. A gain that rises with "
        "range keeps the angle the same at all ranges"
    ),
    source="report 4.3.3 (figures 4.9-4.12); the breakaway table of the sensor model; the growth is assumed",
    parameters=(
        Parameter("log_odds", "1", "change of the log odds well beyond the breakaway angle", 0.0, 20.0),
        Parameter(
            "breakaway",
            "1",
            "the breakaway angle over that of the sensor model",
            0.2,
            3.0,
            None,
            1.0,
            (0.3, 0.5, 0.75, 1.0, 1.25),
        ),
        Parameter(
            "narrowing",
            "1",
            "1: the angle falls with range as in the sensor model; 0: it is that at 1 m at all ranges",
            0.0,
            1.0,
            None,
            1.0,
            (0.0, 1.0),
        ),
        Parameter("over_deg", "deg", "angle over which the log odds grow", 0.1, 45.0, None, 1.0, (1.0, 8.0)),
    ),
    requires=("true_range_cm", "incidence_deg"),
    channels=("missed",),
    experiment="a wall, turned step by step at a fixed range until its readings become unreliable",
    apply=_apply,
    media=("sound", "light"),
)
