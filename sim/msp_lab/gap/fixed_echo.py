"""Where an object at a fixed range would explain most readings: from there the search for `clutter` begins.

Without it a search that follows slopes finds an echo of the landing gear at 30 cm and none of a leg at 170 cm: between
its start and the leg are no readings that would move it.
"""

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap import rules
from msp_lab.gap.candidates import CandidateEffect
from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import JointFit
from msp_sim.effects.base import TRUE_RANGE
from msp_sim.effects.clutter import CLUTTER

_Array = NDArray[np.float64]


def fixed_echo(prepared: Prepared, base: JointFit) -> tuple[CandidateEffect, ...]:
    """The candidate at the likeliest place; none where no place explains as much as a name costs.

    Parameters
    ----------
    prepared, base
        The readings, and the base alone fitted to them.
    """
    strength, location, scatter = CLUTTER.parameters
    sigma_cm = float(scatter.grid[0])
    sensor = prepared.model.sensor
    reading_cm = prepared.reading_cm
    # Where the surface is unknown, nothing is known to be in front of it.
    true_cm = np.broadcast_to(np.asarray(prepared.scene.optional(TRUE_RANGE, 0.0)), reading_cm.shape)
    is_short = reading_cm < np.minimum(true_cm, sensor.maximum_cm) - rules.ECHO_SIGMAS * prepared.rows.sigma_cm
    order = np.flatnonzero(is_short)[np.argsort(reading_cm[is_short], kind="stable")]
    short_cm, log_p = reading_cm[order], base.here.log_p[order]
    best_nats, best_cm = rules.ECHO_NATS, 0.0
    for place_cm in np.arange(sensor.minimum_cm, sensor.maximum_cm, sigma_cm):
        first, last = np.searchsorted(short_cm, [place_cm - 3.0 * sigma_cm, place_cm + 3.0 * sigma_cm])
        if last - first < 3:
            continue
        density = np.exp(-0.5 * ((short_cm[first:last] - place_cm) / sigma_cm) ** 2) / (sigma_cm * np.sqrt(2.0 * np.pi))
        share = (last - first) / max(int(np.count_nonzero(true_cm > place_cm)), 1)
        gained = float(np.log1p(share * density * np.exp(-log_p[first:last])).sum()) - (last - first)
        if gained > best_nats:
            best_nats, best_cm = gained, float(place_cm)
    if best_cm == 0.0:
        return ()
    return (CandidateEffect(CLUTTER, None, ((location.name, best_cm), (scatter.name, sigma_cm)), strength),)
