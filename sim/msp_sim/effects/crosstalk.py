"""Effect: the sensor receives the echo of another sensor's ping instead of its own."""

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values, share_of_readings
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Values) -> Contribution:
    # The neighbour pinged `lag` earlier, so its echo arrives `lag` earlier than an own echo from the same range.
    false_cm = scene["neighbour_range_cm"] - scene.assumed_m_s * 100.0 * scene["neighbour_lag_ms"] / 1000.0 / 2.0
    own_cm = np.where(np.isnan(scene.range_cm), scene.sensor.maximum_cm, scene.range_cm)
    audible = (false_cm > scene.sensor.minimum_cm) & (false_cm < own_cm)
    return Contribution(component=Normal(false_cm, values["sigma_cm"]), share=values["share"] * audible)


CROSSTALK = Effect(
    name="crosstalk",
    sentence="A sensor receives the echo of its neighbour's earlier ping, mistakes it for its own, and reads short.",
    finding="{share:of} pings close to a neighbour's give the neighbour's echo",
    physics="false echo at z_n - c lag / 2, if that is nearer than the sensor's own echo and beyond the minimum",
    source="report 4.3.7 (figures 4.20, 4.21): short readings with simultaneous pings, none with sequential ones",
    parameters=(
        share_of_readings("share of such pings that give the false echo"),
        Parameter("sigma_cm", "cm", "scatter of the false echo", 0.1, 50.0, None, 2.0, (2.0,)),
    ),
    requires=("neighbour_lag_ms", "neighbour_range_cm"),
    channels=("component",),
    experiment="two sensors side by side, pinged together and then in turn",
    apply=_apply,
    media=("sound",),
    optional=("true_range_cm",),
)
