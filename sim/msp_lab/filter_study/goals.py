"""The figures by which the changepoint filter is assessed, with their goals."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from msp_lab.filter_study.scenarios import NAMES
from msp_lab.filter_study.study import CHANGEPOINT, NEAR_CM, ORACLE, OUTLIER_CM, STEP_CM, Study

ORACLE_RATIO = 1.25
"""Goal of the RMS error over that of least squares with known segments, which no filter can beat."""
OUTLIER_RATIO = 0.75
"""Goal of the RMS error over that of the best of the nine filters, on readings with outliers."""
ARRIVED = (0.78, 0.96, 0.99)
"""Goal of the share of steps that are followed after 2, 3 and 4 readings, of which 10 % are missing or outliers."""
MOVED_CM = 5.0
"""Goal of the largest movement of the output by a single outlier [cm]."""
INNOVATION_BOUNDS = (0.81, 1.21)
"""95 % interval of the mean of 199 squared normal numbers: the mean of a run of a consistent filter."""


@dataclass(frozen=True)
class Goal:
    """One figure: its name, its value as shown, the goal, and whether it is reached; None: there is no goal."""

    name: str
    shown: str
    wanted: str
    met: bool | None


def check_goals(study: Study) -> Iterator[Goal]:
    """Yield all figures in the order of the report's chapter."""
    for name in NAMES:
        compared = study.report_noise[name]
        here = compared.mean(CHANGEPOINT)
        for centred, which in ((False, "causal nine"), (True, "nine, medians ahead")):
            best, cm = compared.best(centred=centred)
            yield Goal(f"{name}: RMS, best of the {which} ({best})", f"{here:.3f} cm, {cm:.3f}", "lower", here < cm)
        ratio = here / compared.mean(ORACLE)
        yield Goal(f"{name}: RMS over the oracle's", f"{ratio:.2f}", f"at most {ORACLE_RATIO}", ratio <= ORACLE_RATIO)
    for name in NAMES:
        outliers = study.outliers[name]
        for in_time, which, wanted in ((True, "samples", True), (False, "readings", False)):
            best, cm = outliers.best(in_time=in_time)
            best = best.removesuffix(" in time")
            ratio = outliers.mean(CHANGEPOINT) / cm
            yield Goal(
                f"{name}, with outliers: RMS over that of {best}, windows of {which}",
                f"{ratio:.2f}",
                f"at most {OUTLIER_RATIO}" if wanted else "",
                ratio <= OUTLIER_RATIO if wanted else None,
            )
    for count, (share, wanted_share) in enumerate(zip(study.response.arrived[1:], ARRIVED, strict=True), start=2):
        yield Goal(
            f"step of {STEP_CM:g} cm: within {NEAR_CM:g} cm after {count} readings",
            f"{share:.1%}",
            f"{wanted_share:.0%}",
            share >= wanted_share,
        )
    moved_cm = study.response.moved_cm
    yield Goal(
        f"one reading {OUTLIER_CM:g} cm off moves the output by at most",
        f"{moved_cm:.2f} cm",
        f"under {MOVED_CM:g} cm",
        moved_cm < MOVED_CM,
    )
    low, high = INNOVATION_BOUNDS
    for name in NAMES:
        runs = study.innovations[name]
        inside = float(((runs > low) & (runs < high)).mean())
        yield Goal(
            f"{name}: squared normalised innovations, mean; runs within {low} to {high}",
            f"{np.mean(runs):.2f}; {inside:.0%}",
            f"mean within {low} to {high}",
            bool(low < np.mean(runs) < high),
        )
        covered = study.report_noise[name].covered, study.outliers[name].covered
        yield Goal(
            f"{name}: true range within 1.96 stated standard deviations; with outliers",
            "{:.0%}; {:.0%}".format(*covered),
            "",
            None,
        )
