"""The resolution of readings: the step in which a file's readings come."""

import numpy as np
from numpy.typing import NDArray

STEPS_CM = (5.0, 2.54, 1.0, 0.5, 0.254, 0.2, 0.1, 0.05, 0.01)
"""Steps that are looked for, the largest first: usual resolutions of range finders and of files. The step decides how
much rounding is taken out of a spread; a step that is not listed counts as no rounding."""

TOLERANCE = 0.005
"""Share of a step by which a multiple may be off. Readings that went through 32-bit numbers are off by up to 2e-4 of a
millimetre; of readings without a step 1 % are within this, so that 30 of them never are."""


def step_of(reading_cm: NDArray[np.float64]) -> float:
    """Return the largest usual step of which all readings are whole multiples [cm], and 0 where there is none.

    Examples
    --------
    >>> print(step_of(np.array([120.0, 121.0, np.nan])), step_of(np.array([120.0, 120.37])))
    1.0 0.01
    """
    known = reading_cm[~np.isnan(reading_cm)]
    for step_cm in STEPS_CM:
        steps = known / step_cm
        if np.abs(steps - np.rint(steps)).max(initial=0.0) < TOLERANCE:
            return step_cm
    return 0.0
