"""Effect: a weak echo crosses the detection threshold late."""

from typing import Any

import numpy as np

from msp_range.acoustics.air import ZERO_CELSIUS_K
from msp_sim.acoustics.absorption import db_per_m
from msp_sim.acoustics.atmosphere import Atmosphere
from msp_sim.effects.base import Contribution, Effect, Parameter, Scene, Values

HALF_POWER_DEG = 18.0
"""One-way half-power angle [deg] of a piston of 13.6 mm, which fits the report's angles, at a wavelength of 8.2 mm."""


def _absorption_db_per_m(scene: Scene) -> Any:
    """Absorption by each reading's air, or by usual air where it is unknown. At 0 deg C it is a third of that at 20."""
    kept = scene.kept(("air_temperature_c", "humidity_pct"))
    if "absorption" not in kept:
        usual = Atmosphere()
        temperature_c = scene.optional("air_temperature_c", usual.temperature_c)
        absolute_k = np.clip(temperature_c, -20.0, 50.0) + ZERO_CELSIUS_K
        humidity_percent = np.clip(scene.optional("humidity_pct", usual.humidity_percent), 0.0, 100.0)
        kept["absorption"] = db_per_m(scene.sensor.frequency_hz, absolute_k, humidity_percent, usual.pressure_pa)
    return kept["absorption"]


def _apply(scene: Scene, values: Values) -> Contribution:
    range_m = np.maximum(scene.range_cm, 1.0) / 100.0
    absorption = _absorption_db_per_m(scene)
    off_axis = scene.optional("incidence_deg", 0.0) / HALF_POWER_DEG
    # Relative to a wall at 1 m on the axis: spreading as from a mirror image, two-way absorption, two-way directivity.
    weaker_db = 20.0 * np.log10(range_m) + 2.0 * absorption * (range_m - 1.0) + 6.0 * off_axis**2
    # (A^-e - 1) / e of the amplitude A, in units of 10 dB; at e = 0 it is the loss in dB / 10.
    rising = max(values["exponent"], 1e-6) * np.log(10.0) / 20.0
    return Contribution(bias_cm=values["walk_cm_per_10db"] * np.expm1(rising * weaker_db) / (10.0 * rising))


THRESHOLD_WALK = Effect(
    name="threshold_walk",
    sentence="A weak echo rises slowly and is detected late, so far and tilted surfaces read a little too far.",
    finding="echoes that are 10 dB weaker read {walk_cm_per_10db:too far|too near}",
    physics=(
        "an envelope of amplitude A that rises as A t^n crosses a fixed threshold at a time proportional to A^-e with "
        "e = 1 / n: 1 for one resonator, 0.5 for two, and 0 for an "
        "exponential rise, with a delay proportional to the loss in dB; "
        "loss for a wall: 20 log z, absorption by the air of the reading, and 6 dB (incidence / 18 deg)^2. Zero at 1 m"
    ),
    source="time walk of leading-edge discriminators; levels: msp_sim.acoustics",
    parameters=(
        Parameter(
            "walk_cm_per_10db", "cm", "additional range for each 10 dB that the echo is weaker than at 1 m", 0.0, 5.0
        ),
        Parameter("exponent", "1", "e: how the delay grows as the amplitude falls", 0.0, 1.0, None, 0.0, (0.0, 1.0)),
    ),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="a carpet and a plate at the same range, one after the other: the carpet gives the larger reading",
    apply=_apply,
    media=("sound",),
    optional=("incidence_deg", "air_temperature_c", "humidity_pct"),
)
