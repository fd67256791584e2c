"""The echo of another sensor's ping, heard in place of one's own."""

from collections.abc import Mapping

import numpy as np

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.component import Normal


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    # The neighbour's ping is lag older than one's own: its echo comes lag earlier than from a range as far.
    false_cm = scene["neighbour_range_cm"] - scene.assumed_m_s * 100.0 * scene["neighbour_lag_ms"] / 1000.0 / 2.0
    own_cm = np.where(np.isnan(scene.range_cm), scene.sensor.maximum_cm, scene.range_cm)
    heard = (false_cm > scene.sensor.minimum_cm) & (false_cm < own_cm)
    return Contribution(component=Normal(false_cm, values["sigma_cm"]), share=np.where(heard, values["share"], 0.0))


CROSSTALK = Effect(
    name="crosstalk",
    sentence="A sensor hears the echo of its neighbour's earlier ping and takes it for its own, so it reads short.",
    physics="false echo at z_n - c lag / 2; it counts where it is nearer than the own echo and beyond the minimum",
    source="report 4.3.7 (figures 4.20, 4.21): short with simultaneous pings, gone with sequential ones",
    parameters=(
        Parameter("share", "1", "share of such pings that read the false echo", 0.0, 1.0),
        Parameter("sigma_cm", "cm", "scatter of the false echo", 0.1, 50.0, None, 2.0, (2.0,)),
    ),
    requires=("neighbour_lag_ms", "neighbour_range_cm"),
    channels=("component",),
    experiment="two sensors side by side, pinged together and then in turn",
    apply=_apply,
    optional=("true_range_cm",),
)
