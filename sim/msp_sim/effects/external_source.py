"""Effect: ultrasound from another source is mistaken for the echo."""

import numpy as np
from scipy.special import expit

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values
from msp_sim.effects.component import FirstBefore

REFERENCE_CM = 30.0
"""Distance at which ``external_level_db`` is given [cm]."""
FADE_DB = 3.0
"""Width of the transition from rarely to mostly detected [dB]; assumed. A larger one makes the threshold less sharp."""
BANDWIDTH_KHZ = 2.0
"""Frequency offset at which the transducer is 3 dB less sensitive [kHz]; assumed (quality factor of 10). A larger one
lets sources at other frequencies disturb more."""


def _apply(scene: Scene, values: Values) -> Contribution:
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
    sentence="Ultrasound of another source arrives at random times and is mistaken for the echo if it comes first.",
    finding="other ultrasound gives {rate_per_m:number} false echoes for each metre of range",
    physics=(
        "events at a constant rate while the sensor listens; the first one before the own echo counts (exponential, "
        "truncated at the echo). The rate depends on the source's duty and on its level above the threshold"
    ),
    source="report 4.3.8, inconclusive; Poisson arrivals, independent of the sensor's pings",
    parameters=(
        Parameter("rate_per_m", "1/m", "events per metre of range at full duty, far above the threshold", 0.0, 100.0),
        Parameter(
            "threshold_db",
            "dB",
            "level at which half of them are detected",
            20.0,
            160.0,
            None,
            90.0,
            (70.0, 90.0, 110.0),
        ),
    ),
    requires=("external_level_db", "external_duty", "external_distance_cm"),
    channels=("component",),
    experiment="a 42 kHz transmitter on and off, at three distances",
    apply=_apply,
    media=("sound",),
    optional=("true_range_cm", "external_frequency_khz"),
)
