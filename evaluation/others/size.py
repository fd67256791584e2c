"""How large an effect on one sensor has to be for a number of standard errors in these flights.

Null flights enter, with the truth and with the other sensors as reference; a value of the effect leaves. Readings are
drawn at the truth and scored at the reference, as the workflow has to: its error and how that is correlated in time
count, and the base's numbers are free.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap.prepared import Prepared
from msp_lab.gap.refit import fit_base, refit
from msp_lab.gap.runs import spacing_s
from msp_sim.model.derived import sample_in_order
from msp_sim.model.history import History
from msp_sim.model.model import Model, make_term

DRAWS = 2
"""Tables that are drawn for each size; with more the size is known better."""


STEPS, CLOSE = 5, 0.07
"""At most so many steps are made to a size, until it has the standard errors to within this share."""
HIT_CM = 15.0
"""Readings nearer than this to the reference are hits [cm]."""


@dataclass(frozen=True)
class Mechanism:
    """An effect that may be hidden."""

    name: str
    number: str
    """Effect, and the parameter whose size is sought."""
    largest: float
    """Largest value: beyond it no sensor flies."""
    shape: Mapping[str, float]
    """Its other parameters."""
    sign: float = 1.0
    """Of its value."""

    def parameters(self, size: float) -> dict[str, float]:
        """All parameters at a size."""
        return {self.number: float(f"{self.sign * size:.4g}"), **self.shape}


MECHANISMS = (
    Mechanism("range_scale", "scale_pct", 10.0, {}),
    Mechanism("latency", "delay_ms", 600.0, {}),
    Mechanism("multipath", "share", 0.3, {}),
    Mechanism("stale", "share", 0.6, {}),
    Mechanism("bend", "slope_pct", 15.0, {"from_cm": 250.0}, -1.0),
    Mechanism("clutter", "share", 0.3, {"location_cm": 70.0}),
    Mechanism("heavy_tails", "share", 0.4, {"wider": 5.0}),
    Mechanism("spread_with_range", "growth_per_m", 2.0, {}),
    Mechanism("lost_high_byte", "share", 0.3, {}),
    Mechanism("cycle_slip", "share", 0.4, {"cycles": 16.0}),
)
"""What one sensor of four may have alone, and these flights can show. Rotor noise is not among them: nine of ten
readings are taken at nearly the throttle of the hover, and it is a wider spread for all of them."""


@dataclass(frozen=True)
class NullFlights:
    """Readings of one sensor in flights without an effect, row by row."""

    truth: Mapping[str, NDArray[Any]]
    """Contexts with the true range, for drawing."""
    reference: Mapping[str, NDArray[Any]]
    """The same rows with the other sensors' range."""


def size_for(
    mechanism: Mechanism, standard_errors: float, model: Model, flights: NullFlights, seed: int
) -> float | None:
    """The size at which an effect has so many standard errors; None where it is beyond what is possible.

    Parameters
    ----------
    mechanism, standard_errors
        What is sought.
    model
        Without the effect.
    flights
        Flights without it.
    seed
        Of the draws.
    """
    size = 0.1 * mechanism.largest
    for _ in range(STEPS):
        # About proportional to the size.
        found = _standard_errors(mechanism, size, model, flights, seed)
        if abs(found - standard_errors) < CLOSE * standard_errors:
            break
        size *= float(np.clip(standard_errors / max(found, 1e-9), 0.2, 5.0))
        if size > mechanism.largest:
            return None
    return size


def _standard_errors(mechanism: Mechanism, size: float, model: Model, flights: NullFlights, seed: int) -> float:
    term = replace(make_term(mechanism.name, None, mechanism.parameters(size)), is_added=True)
    changed = Model(model.sensor, (*model.effects, term))
    run = flights.truth["run"]
    before, _ = History.of(flights.truth, len(run), 0.0, 1.0).before(np.ones(len(run), dtype=bool))
    gains = []
    for draw in range(DRAWS):
        reading_cm = sample_in_order(changed, flights.truth, seed + draw)
        true_cm = flights.reference["true_range_cm"].copy()
        # As the intake does, each run's mean difference from the given model is taken off.
        off_cm = reading_cm - model.rows(flights.reference).centre_cm
        for each in np.unique(run):
            own = run == each
            true_cm[own] += off_cm[own & (np.abs(off_cm) < HIT_CM)].mean()
        previous_cm = np.where(before >= 0, reading_cm[before], np.nan)
        contexts = {**flights.reference, "true_range_cm": true_cm, "previous_reading_cm": previous_cm}
        prepared = Prepared.of(model, contexts, reading_cm, spacing_s(contexts))
        base = fit_base(prepared)
        extended = refit(prepared, [term], base.base)
        # Without the effect from there too: a fit that ended too soon would count as evidence.
        again = refit(prepared, [], extended.base)
        gains.append(extended.log_likelihood - max(base.log_likelihood, again.log_likelihood))
    return float(np.sqrt(max(2.0 * float(np.mean(gains)), 0.0)))
