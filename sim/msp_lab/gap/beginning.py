"""Where the fit of the base begins when a gap is many standard deviations wide.

Readings enter, values of the base leave. At the given model the likelihood is flat where a reading is so far from its
hit that it is taken for a random one; begun with the spread that the readings have, hits are hits, and a name can be
found by its slope. The fit goes on from there, and the spread shrinks again once what made it is named.
"""

import numpy as np
from numpy.typing import NDArray

from msp_lab.gap.refit import Fitted, refit
from msp_lab.gap.tangent import Prepared

WIDE = 0.4
"""Of the logarithm of the spread: readings that are this much wider than the model are begun with their own spread."""


def fit_base(prepared: Prepared) -> Fitted:
    """The base refitted, from the given model or from the readings' median and spread, whichever ends better."""
    given = refit(prepared, [])
    start = robust(prepared)
    if start is None:
        return given
    other = refit(prepared, [], start)
    return other if other.log_likelihood > given.log_likelihood else given


def robust(prepared: Prepared) -> NDArray[np.float64] | None:
    """Offset and log spread of what looks like hits; None where they are near the model's."""
    rows, reading = prepared.rows, prepared.reading_cm
    with np.errstate(invalid="ignore"):
        usual = (reading > rows.minimum_cm) & (reading < rows.maximum_cm) & np.isfinite(rows.centre_cm)
        usual &= np.abs(reading - rows.centre_cm) < 10.0 + 0.2 * rows.centre_cm
    if usual.sum() < 0.3 * reading.size:
        return None
    off_cm = (reading - rows.centre_cm)[usual]
    sigma_cm = np.broadcast_to(rows.sigma_cm, reading.shape)[usual]
    middle_cm = float(np.median(off_cm))
    # Rounding to whole centimetres is no spread.
    spread = 1.4826 * float(np.median(np.abs(off_cm - middle_cm) / np.maximum(sigma_cm, 0.3)))
    if not np.log(max(spread, 1e-3)) > WIDE and abs(middle_cm) < 2.0 * float(np.median(sigma_cm)):
        return None
    start = np.zeros(7)
    start[0], start[1] = middle_cm, max(np.log(max(spread, 1e-3)), 0.0)
    return start
