"""The picture of a session: its contexts over its readings, and the nats that are expected against its length."""

import numpy as np
from matplotlib.figure import Figure

from msp_lab.design.choose import Design
from msp_lab.gap.labels import axis_label
from msp_sim.page.style import BLUE, GREY, VERMILION, new_panels, style

DOTS = 3_000
"""Readings that are drawn at most."""
SHARES = np.linspace(0.0, 2.0, 41)
"""Lengths of the session at which the nats are drawn, as shares of the planned one."""


@style()
def draw_session(design: Design) -> Figure:
    """Draw a design that has a session."""
    session = design.session
    assert session is not None
    varied = list(session.varied) or ["true_range_cm"]
    heights = [*[1.0] * len(varied), 1.8]
    figure, (*strips, own) = new_panels(1.3 * len(varied) + 2.4, len(heights), height_ratios=heights)
    contexts = session.sampled(min(DOTS, session.readings))
    place = np.linspace(1, session.readings, np.size(contexts["true_range_cm"]))
    for axes, name in zip(strips, varied, strict=True):
        axes.plot(place, contexts[name], ".", color=BLUE, markersize=2.0)
        axes.set_ylabel(axis_label(name).replace(" [", "\n["))
        axes.tick_params(labelbottom=name == varied[-1])
    strips[0].set_title(f"{session.kind}: {session.runs} runs, {session.readings} readings, {session.minutes:.0f} min")
    strips[-1].set_xlabel("reading")
    labels = [answer.answer.label for answer in design.answers]
    readings = SHARES * session.readings
    for separation in design.separations:
        words = f"{labels[separation.truth]}, not {labels[separation.alternative]}"
        nats = [separation.nats(int(count), session.runs) for count in readings]
        own.plot(readings / session.runs, nats, label=words)
    own.axhline(design.needed_nats, color=VERMILION, linestyle="--", label="needed")
    own.axvline(session.readings / session.runs, color=GREY, linestyle=":", label="planned")
    own.set_ylim(0.0, max(3.0 * design.needed_nats, 1.0))
    own.set(xlabel=f"readings in each of {session.runs} runs", ylabel="expected separation\n[nats]")
    return figure
