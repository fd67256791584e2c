"""The effects of a model summarised for a flight: shares and spread of the readings, by which the bridge watches the
sensor.

The bridge knows no throttle, no neighbours and no material below it, and no code of the effects. So the readings are
drawn here for contexts like those of the flight, and counted as the bridge counts them.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from msp_range.reading_model.sensor_model import MEAN_EFFECTS, SATURATED_CM, WIDEST_IN_FLIGHT_CM, InFlight
from msp_sim.model.model import Model
from msp_sim.model.streams import RandomStreams

FEWEST_DRAWN = 20_000
"""Least number of readings that are drawn: with it a share of 1 % is known to 0.1 %. More take longer."""
FARTHEST = 0.8
"""Surfaces beyond this share of the maximum are left out, as in `msp_range.health.sensor_watch`."""
OFF_SIGMAS = 4.0
"""A reading this many standard deviations nearer than the surface counts as short, as in
`msp_range.health.sensor_watch`."""


def in_flight(model: Model, contexts: Mapping[str, Any], draws: np.random.Generator) -> InFlight | None:
    """Shares and spread of a model's readings.

    None where all its effects are in `MEAN_EFFECTS`, no surface is in range, or hits scatter too much to be watched.

    Parameters
    ----------
    model
        The model with its effects.
    contexts
        Columns of some flights, as for `Model.sample`.
    draws
        Random generator.
    """
    if MEAN_EFFECTS.issuperset(effect.effect.name for effect in model.effects):
        return None
    rows = model.rows(contexts)
    near = np.flatnonzero(rows.centre_cm < FARTHEST * model.sensor.maximum_cm)
    if not near.size:
        return None
    rows = rows.take(near)
    streams = RandomStreams(draws)
    reading_cm = np.array([rows.sample(streams) for _ in range(-(-FEWEST_DRAWN // near.size))])
    off_cm = reading_cm - rows.centre_cm
    is_hit = np.abs(off_cm) < OFF_SIGMAS * rows.sigma_cm
    if not is_hit.any():
        return None
    is_missed = ~is_hit & np.isin(reading_cm, (model.sensor.maximum_cm, SATURATED_CM))
    variance_cm2 = np.mean(off_cm[is_hit] ** 2) - model.sensor.resolution_cm**2 / 12.0 - np.mean(rows.reference_cm2)
    sigma_cm = float(np.sqrt(max(variance_cm2, model.sensor.reading_model.sigma_cm**2)))
    if sigma_cm > WIDEST_IN_FLIGHT_CM:
        return None
    is_short = ~is_missed & (off_cm < -OFF_SIGMAS * sigma_cm)
    return InFlight(short=float(np.mean(is_short)), missed=float(np.mean(is_missed)), sigma_cm=sigma_cm)
