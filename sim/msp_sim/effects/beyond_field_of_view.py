"""A surface tilted so far that its echo goes elsewhere."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene

MOST_LOG_ODDS = 10.0
"""However far it is tilted, an edge or a facet sends back one echo in some hundreds."""


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    half_angle_deg = np.degrees(scene.sensor.beam.half_angle_rad(scene.range_cm / 100.0))
    beyond_deg = np.maximum(np.abs(scene["incidence_deg"]) - half_angle_deg, 0.0)
    return Contribution(log_odds_missed=np.minimum(values["log_odds_per_deg"] * beyond_deg, MOST_LOG_ODDS))


BEYOND_FIELD_OF_VIEW = Effect(
    name="beyond_field_of_view",
    sentence="A surface that is tilted beyond what the beam can hear sends its echo elsewhere, and no echo comes back.",
    physics="log odds of a missed echo grow by the same for each degree beyond the range's breakaway angle, to 10",
    source="report 4.3.3 (figures 4.9-4.12); the breakaway table of the sensor model; the growth is assumed",
    parameters=(
        Parameter("log_odds_per_deg", "1/deg", "growth of the log odds beyond the breakaway angle", 0.0, 50.0),
    ),
    requires=("true_range_cm", "incidence_deg"),
    channels=("missed",),
    experiment="a wall, turned step by step at a fixed range until its readings become unreliable",
    apply=_apply,
)
