"""Layouts for other programs: made from a recording, in the form of those programs."""

import json
from pathlib import Path
from xml.etree import ElementTree

import pytest
from foxglove import layouts

from msp_range.recording.error import RecordingError
from msp_range.recording.layouts import foxglove, plotjuggler, plots_of
from msp_range.recording.reader import Recording
from tests.unit.test_recording_export import reading, recorded

USED, FILTERED, FUSED = "#1f77b4", "#2ca02c", "#9467bd"
"""Colours of corrected readings, filtered ones and the fused distance."""


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return recorded(
        tmp_path / "flight.mcap",
        [
            ("/range/left", 0.05, reading(0.0, "ok", 400) | {"corrected_m": 3.9}),
            ("/range/right", 0.15, reading(0.1, "ok", 400) | {"corrected_m": 3.9, "filtered_m": 3.9}),
            ("/range/dead", 0.25, reading(0.2, "no_answer", None)),
            ("/fused", 0.25, {"range_m": 4.0}),
            ("/health", 0.25, {"text": "x", "severity": "info"}),
        ],
    )


def series(value: str, colour: str) -> layouts.PlotSeries:
    return layouts.PlotSeries(
        value=value,
        label=value.rpartition(".")[2],
        color=colour,
        show_line=not value.endswith("corrected_m"),
        timestamp_method="receiveTime",
    )


def plot(title: str, *curves: layouts.PlotSeries) -> layouts.PlotPanel:
    config = layouts.PlotConfig(paths=list(curves), is_synced=True, y_axis_label="m", show_legend=True)
    return layouts.PlotPanel(title=title, config=config)


def test_the_layout_is_what_foxgloves_own_types_write(recording: Recording) -> None:
    states = [
        layouts.StateTransitionsSeries(value=f"/range/{name}.{key}", label=f"{name} {key}")
        for name in ("left", "right")
        for key in ("status", "rejected")
    ]
    panels = [
        plot("distance down", series("/fused.range_m", FUSED)),
        plot("left", series("/range/left.corrected_m", USED)),
        plot("right", series("/range/right.corrected_m", USED), series("/range/right.filtered_m", FILTERED)),
        layouts.StateTransitionsPanel(
            title="what became of the readings", config=layouts.StateTransitionsConfig(paths=states, is_synced=True)
        ),
        layouts.RawMessagesPanel(config=layouts.RawMessagesConfig(topic_path="/health")),
    ]
    items = [layouts.SplitItem(content=each) for each in panels]
    expected = layouts.Layout(content=layouts.SplitContainer(direction="column", items=items))
    assert json.loads(foxglove(plots_of(recording))) == json.loads(expected.to_json())


def test_plotjuggler_gets_only_curves_that_the_recording_has(recording: Recording) -> None:
    """It asks about each missing one when it opens the layout."""
    root = ElementTree.fromstring(plotjuggler(plots_of(recording)))
    (splitter,) = root.findall("./tabbed_widget[@name='Main Window']/Tab/Container/DockSplitter")
    areas = splitter.findall("DockArea")
    assert [each.get("name") for each in areas] == ["distance down", "left", "right"]
    assert [each.get("name") for each in splitter.iter("curve")] == [
        "/fused/range_m",
        "/range/left/corrected_m",
        "/range/right/corrected_m",
        "/range/right/filtered_m",
    ]
    # It reads a size for each part without looking how many there are.
    assert splitter.get("count") == str(len(areas)) == str(len(splitter.attrib["sizes"].split(";")))


def test_a_recording_without_ranges_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="has no ranges to show"):
        plots_of(recorded(tmp_path / "empty.mcap", [("/health", 0.0, {"text": "x", "severity": "info"})]))
