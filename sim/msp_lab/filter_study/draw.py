"""The report's figures 5.7-5.15: the estimates of each filter in one run, all of it above and two seconds below."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from msp_lab.filter_study.candidates import changepoint
from msp_lab.filter_study.nine import AS_REPORTED, Family, apply
from msp_lab.filter_study.scenarios import (
    GAUSSIAN,
    INTERVAL_S,
    NAMES,
    Array,
    ScenarioRuns,
    report_readings,
    truth,
)
from msp_sim.page.style import GREY, INK, SERIES, new_panels, save, style

FAMILIES: tuple[Family, ...] = ("moving average", "median", "kalman")
FIRST_FIGURE = 7
"""Number of the first figure in chapter 5: three families in the fixed scenario, the steps and the random ranges."""
CLOSE_S = 2.0
"""Length of the part that is shown enlarged [s]."""


@style()
def draw_figures(folder: Path, seed: int) -> list[Path]:
    """Draw the nine figures of one run each, and return their paths."""
    paths = []
    for scenario_index, name in enumerate(NAMES):
        rng = np.random.default_rng([seed, scenario_index])
        runs = report_readings(truth(name, 1, rng), rng)
        newest_cm, _ = changepoint(runs.reading_cm, GAUSSIAN)
        for number, family in enumerate(FAMILIES, start=FIRST_FIGURE + len(FAMILIES) * scenario_index):
            of_family = {name: variant for name, variant in AS_REPORTED.items() if variant.family == family}
            estimates = {name: apply(variant, runs.reading_cm)[0] for name, variant in of_family.items()}
            paths.append(folder / f"figure_5_{number}.png")
            save(_figure(runs, estimates, newest_cm[0], f"Figure 5.{number}: {family}, {name}"), paths[-1])
    return paths


def _figure(runs: ScenarioRuns, estimates: Mapping[str, Array], newest_cm: Array, title: str) -> Figure:
    figure, panels = new_panels(6.0, 2)
    time_s = np.arange(runs.true_cm.shape[1]) * INTERVAL_S
    for axes in panels:
        axes.plot(time_s, runs.reading_cm[0], ".", color=GREY, markersize=3, label="readings")
        axes.plot(time_s, runs.true_cm[0], color=INK, label="true range")
        for (name, cm), (colour, _) in zip(estimates.items(), SERIES, strict=False):
            axes.plot(time_s, cm, color=colour, label=name)
        axes.plot(time_s, newest_cm, "--", color=INK, label="changepoint")
        axes.set_ylabel("range [cm]")
    begin_s = _interesting_s(runs)
    shown_cm = runs.reading_cm[0][(time_s >= begin_s) & (time_s <= begin_s + CLOSE_S)]
    whole, close = panels
    whole.set_title(title)
    close.set(xlim=(begin_s, begin_s + CLOSE_S), ylim=(shown_cm.min() - 5.0, shown_cm.max() + 5.0), xlabel="time [s]")
    return figure


def _interesting_s(runs: ScenarioRuns) -> float:
    """Half a second before the largest change of the true range from shortly before the middle on; the middle if it
    never changes [s]."""
    changes = np.abs(np.diff(runs.true_cm[0]))
    middle = changes.size // 2
    sample = middle if changes.max() == 0 else int(changes[middle - 40 :].argmax()) + middle - 40
    return float(max(sample * INTERVAL_S - 0.5, 0.0))
