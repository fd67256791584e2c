"""Ultrasound of somebody else, which the sensor takes for its echo."""

from collections.abc import Mapping

import numpy as np
from scipy.special import expit

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.component import FirstBefore

REFERENCE_CM = 30.0
"""Distance at which ``external_level_db`` is given [cm]."""
FADE_DB = 3.0
"""Over which a level gets from rarely to mostly heard [dB], assumed."""
BANDWIDTH_KHZ = 2.0
"""Off the sensor's frequency by this much its transducer hears 3 dB less [kHz], assumed: a quality factor of 10."""


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    off_khz = scene.optional("external_frequency_khz", scene.sensor.frequency_hz / 1000.0)
    off_khz = off_khz - scene.sensor.frequency_hz / 1000.0
    level_db = (
        scene["external_level_db"]
        - 20.0 * np.log10(np.maximum(scene["external_distance_cm"], 1.0) / REFERENCE_CM)
        - 3.0 * (off_khz / BANDWIDTH_KHZ) ** 2
    )
    rate_per_m = values["rate_per_m"] * scene["external_duty"] * expit((level_db - values["threshold_db"]) / FADE_DB)
    own_cm = np.minimum(scene.optional("true_range_cm", scene.sensor.maximum_cm), scene.sensor.maximum_cm)
    listened_m = np.maximum(own_cm - scene.sensor.minimum_cm, 0.0) / 100.0
    return Contribution(component=FirstBefore(rate_per_m), share=-np.expm1(-rate_per_m * listened_m))


EXTERNAL_SOURCE = Effect(
    name="external_source",
    sentence="Another source of ultrasound is heard at any moment, and whatever comes before the echo is taken for it.",
    physics=(
        "events at a constant rate while the sensor listens, the first before the own echo counts: exponential, cut "
        "there. The rate goes with the source's duty and with its level at the sensor over the threshold"
    ),
    source="report 4.3.8, inconclusive; Poisson arrivals, independent of the own pings",
    parameters=(
        Parameter("rate_per_m", "1/m", "events per metre of range at full duty, far above the threshold", 0.0, 100.0),
        Parameter("threshold_db", "dB", "level at which half are heard", 20.0, 160.0, None, 90.0, (70.0, 90.0, 110.0)),
    ),
    requires=("external_level_db", "external_duty", "external_distance_cm"),
    channels=("component",),
    experiment="a 42 kHz transmitter on and off, at three distances",
    apply=_apply,
    optional=("true_range_cm", "external_frequency_khz"),
)
