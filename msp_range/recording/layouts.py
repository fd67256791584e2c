"""Layouts of other programs for a recording: Foxglove's (JSON) and PlotJuggler's (XML).

With the layout that is made for a recording they show each sensor's readings, what the filters made of them and the
fused distance without a click. The forms are those of foxglove-sdk's ``foxglove.layouts`` 0.30 and of PlotJuggler
3.16's ``xmlLoadState`` (plot_docker.cpp, plotwidget.cpp), which drops a curve that the recording does not have.
"""

import json
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple
from xml.etree.ElementTree import Element, SubElement, indent, tostring

from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.topics import FUSED_TOPIC, HEALTH_TOPIC, RANGE_PREFIX

_CURVES = {"corrected_m": "#1f77b4", "filtered_m": "#2ca02c", "range_m": "#9467bd"}
"""Colours of corrected readings, filtered ones and the fused distance, which the colour-blind distinguish too."""


class Plot(NamedTuple):
    """One picture: its title, topic, and the keys of the messages that are its curves."""

    title: str
    topic: str
    keys: Sequence[str]


def plots_of(recording: Recording) -> list[Plot]:
    """The fused distance, then each sensor, with the curves that the recording has.

    Raises
    ------
    RecordingError
        It has none.
    """
    seen: dict[str, set[str]] = {}
    for topic, _, message in recording:
        if topic == FUSED_TOPIC or topic.startswith(RANGE_PREFIX):
            seen.setdefault(topic, set()).update(message)
    plots = [Plot("distance down", FUSED_TOPIC, ["range_m"])] if "range_m" in seen.get(FUSED_TOPIC, ()) else []
    for topic in sorted(seen.keys() - {FUSED_TOPIC}):
        if keys := [key for key in ("corrected_m", "filtered_m") if key in seen[topic]]:
            plots.append(Plot(topic.removeprefix(RANGE_PREFIX), topic, keys))
    if not plots:
        raise RecordingError(f"{recording.path}: has no ranges to show")
    return plots


def foxglove(plots: Sequence[Plot]) -> str:
    """A layout for Foxglove: the plots below each other, then states of the readings, and reports to the pilot."""
    panels = [_plot_panel(plot) for plot in plots]
    states = [
        {"value": f"{plot.topic}.{key}", "label": f"{plot.title} {key}"}
        for plot in plots
        if plot.topic.startswith(RANGE_PREFIX)
        for key in ("status", "rejected")
    ]
    panels.append(_panel("StateTransitions", "what became of the readings", {"paths": states, "isSynced": True}))
    panels.append(_panel("RawMessages", None, {"topicPath": HEALTH_TOPIC}))
    items = [{"proportion": 1, "content": panel} for panel in panels]
    return json.dumps({"version": 1, "content": {"type": "split", "direction": "column", "items": items}}, indent=1)


def plotjuggler(plots: Sequence[Plot]) -> str:
    """A layout for PlotJuggler: the plots below each other, readings as dots."""
    root = Element("root")
    main = SubElement(root, "tabbed_widget", {"parent": "main_window", "name": "Main Window"})
    tab = SubElement(main, "Tab", tab_name="ranges", containers="1")
    sizes = ";".join([f"{1 / len(plots):.6g}"] * len(plots))
    container = SubElement(tab, "Container")
    splitter = SubElement(container, "DockSplitter", orientation="-", count=str(len(plots)), sizes=sizes)
    for shown in plots:
        area = SubElement(splitter, "DockArea", name=shown.title)
        plot = SubElement(area, "plot", mode="TimeSeries", style="LinesAndDots")
        for key in shown.keys:
            SubElement(plot, "curve", name=f"{shown.topic}/{key}", color=_CURVES[key])
    SubElement(main, "currentTabIndex", index="0")
    SubElement(root, "use_relative_time_offset", enabled="1")
    indent(root)
    return tostring(root, encoding="unicode", xml_declaration=True)


FORMS: dict[str, Callable[[Sequence[Plot]], str]] = {".json": foxglove, ".xml": plotjuggler}
"""Suffix of the file -> what makes it."""


def _plot_panel(plot: Plot) -> dict[str, Any]:
    paths = [
        # A line through readings would hide what lies between them; the filter's own is one.
        {
            "value": f"{plot.topic}.{key}",
            "label": key,
            "color": _CURVES[key],
            "showLine": key != "corrected_m",
            "timestampMethod": "receiveTime",
        }
        for key in plot.keys
    ]
    return _panel("Plot", plot.title, {"paths": paths, "isSynced": True, "yAxisLabel": "m", "showLegend": True})


def _panel(kind: str, title: str | None, config: dict[str, Any]) -> dict[str, Any]:
    titled = {} if title is None else {"title": title}
    return {"type": "panel", "panelType": kind, "config": config, **titled, "version": 1}
