"""Effect: a surface is tilted so far that its echo misses the sensor."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values

MAX_LOG_ODDS = 10.0
"""Limit of the change of the log odds, because at any tilt an edge or facet returns one echo in some hundreds. A larger
limit makes a single echo at a large tilt nearly impossible."""


def _apply(scene: Scene, values: Values) -> Contribution:
    half_angle_deg = np.degrees(scene.sensor.beam.half_angle_rad(scene.range_cm / 100.0))
    beyond_deg = np.maximum(np.abs(scene["incidence_deg"]) - half_angle_deg, 0.0)
    return Contribution(log_odds_missed=np.minimum(values["log_odds_per_deg"] * beyond_deg, MAX_LOG_ODDS))


BEYOND_FIELD_OF_VIEW = Effect(
    name="beyond_field_of_view",
    sentence="A surface tilted beyond the beam's breakaway angle reflects the sound away, and no echo comes back.",
    finding="beyond the breakaway angle, each degree makes missed echoes come {log_odds_per_deg:times}",
    physics="log odds of a missed echo grow linearly with the angle beyond the breakaway angle at that range, up to 10",
    source="report 4.3.3 (figures 4.9-4.12); the breakaway table of the sensor model; the growth is assumed",
    parameters=(
        Parameter("log_odds_per_deg", "1/deg", "growth of the log odds beyond the breakaway angle", 0.0, 50.0),
    ),
    requires=("true_range_cm", "incidence_deg"),
    channels=("missed",),
    experiment="a wall, turned step by step at a fixed range until its readings become unreliable",
    apply=_apply,
    media=("sound", "light"),
)
