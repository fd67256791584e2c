"""The picture of a session: its contexts over its readings, and the nats that are expected against its length."""

import numpy as np
from matplotlib.figure import Figure

from msp_lab.design.choose import Design
from msp_lab.gap.labels import axis_label
from msp_sim.page.style import BLUE, GREY, VERMILION, new_figure, style

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
    figure = new_figure(1.3 * len(varied) + 2.4)
    axes = figure.subplots(len(varied) + 1, 1, gridspec_kw={"height_ratios": [*[1.0] * len(varied), 1.8]})
    contexts = session.sampled(min(DOTS, session.readings))
    place = np.linspace(1, session.readings, np.size(contexts["true_range_cm"]))
    for own, name in zip(axes, varied, strict=False):
        own.tick_params(labelbottom=name == varied[-1])
        own.plot(place, contexts[name], ".", color=BLUE, markersize=2.0)
        own.set_ylabel(axis_label(name).replace(" [", "\n["))
    axes[len(varied) - 1].set_xlabel("reading")
    axes[0].set_title(f"{session.kind}: {session.runs} runs, {session.readings} readings, {session.minutes:.0f} min")
    own = axes[-1]
    labels = [answer.answer.label for answer in design.answers]
    for separation in design.separations:
        nats = [separation.nats(int(share * session.readings), session.runs) for share in SHARES]
        own.plot(
            SHARES * session.readings / session.runs,
            nats,
            label=f"{labels[separation.truth]}, not {labels[separation.alternative]}",
        )
    needed = design.needed_nats
    own.axhline(needed, color=VERMILION, linestyle="--", label="needed")
    own.axvline(session.readings / session.runs, color=GREY, linestyle=":", label="planned")
    own.set_ylim(0.0, max(3.0 * needed, 1.0))
    own.set_xlabel(f"readings in each of {session.runs} runs")
    own.set_ylabel("expected separation\n[nats]")
    return figure
