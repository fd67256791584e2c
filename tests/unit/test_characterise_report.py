"""The report of a characterisation: complete, self-contained, and whole where parts of the data are missing."""

import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.report import write_report
from msp_lab.characterise.report.draw.errors import Errors, draw_errors
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_range.yaml_file import ConfigError
from tests.support.characterised import found_in, measured

MODEL = load_sensor_model(Path(__file__).parents[2] / "configs/sensors/mb1242.yaml")

REPORT_FIGURES = [f"figure_4_{number:02d}" for number in range(4, 22)] + [f"figure_5_{n:02d}" for n in range(1, 7)]
OWN_FIGURES = [
    "calibration",
    "mixture",
    "pit",
    "sonar_equation",
    "hot_boxes",
    "questions",
    "table_5_1_compensation",
    "section_4_3_8_external",
]


class Page(HTMLParser):
    """What a page refers to, its anchors, and its words."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.references: list[str] = []
        self.anchors: set[str] = set()
        self.tags: list[str] = []
        self.words: list[str] = []
        self.images = 0
        self.html = path.read_text(encoding="utf-8")
        self.feed(self.html)
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster") or name.startswith("on"):
                self.references.append(value)
            if name == "id":
                assert value not in self.anchors, f"anchor {value} is there twice"
                self.anchors.add(value)
        if tag == "img":
            self.images += 1
            assert dict(attrs)["alt"], "a picture without words for who cannot see it"

    def handle_data(self, data):
        self.words.append(data)


@pytest.fixture(scope="module")
def complete(tmp_path_factory):
    data = measured(most=2000)
    findings = found_in(data)
    folder = tmp_path_factory.mktemp("report")
    path = write_report(findings, data, MODEL, folder)
    return folder, Page(path), findings


def only(data: MeasuredData, *names: str) -> MeasuredData:
    return MeasuredData({name: data[name] for name in names})


def names_of(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.png"))


def nothing_found(data: MeasuredData) -> Findings:
    return Findings("other", "2026-10-05", 22.5, (), (), absent={"mixture": "too few readings"})


def test_every_figure_of_the_report_and_our_own_is_there(complete):
    folder, page, _ = complete
    names = names_of(folder)
    for figure in (*REPORT_FIGURES, *OWN_FIGURES):
        assert any(name.startswith(figure) for name in names), figure
    assert "not drawn" not in page.text
    assert page.images == len(names)
    assert set(names) <= page.anchors


def test_page_asks_for_nothing_from_outside(complete):
    _, page, _ = complete
    for reference in page.references:
        assert reference.startswith(("#", "data:image/png;base64,")), reference[:80]
    for reference in page.references:
        if reference.startswith("#"):
            assert reference[1:] in page.anchors, reference
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert not re.search(r"@import|url\(|https?://", page.html)


def test_pictures_are_png_of_one_width_and_not_blank(complete):
    folder, _, _ = complete
    for path in folder.glob("*.png"):
        with Image.open(io.BytesIO(path.read_bytes())) as image:
            assert image.format == "PNG"
            assert image.width == 1110, path.name
            pixels = np.asarray(image.convert("L"))
        inked = np.mean(pixels < 250)
        assert inked > 0.01, f"{path.name} is blank"
        # Nothing runs over an edge: letters that are cut off leave ink in the outermost pixels.
        edge = np.concatenate([pixels[:2].ravel(), pixels[-2:].ravel(), pixels[:, :2].ravel(), pixels[:, -2:].ravel()])
        assert np.mean(edge < 128) < 0.002, f"{path.name} is cut off"


def test_verdicts_stand_first_with_the_reports_numbers(complete):
    _, page, _ = complete
    text = page.text
    assert (
        text.index("What the campaign found")
        < text.index("Does it matter?")
        < text.index("Figure 4.4: range error, all")
    )
    head = text[: text.index("Every effect in numbers")]
    for words in ("within a step", "23.4°", "near 503 cm", "−1.25 (−1.37 to −1.13) cm", "cannot tell", "Inconclusive."):
        assert words in head, words
    assert "The reference is a tape measure" in head


def test_table_5_1_has_both_sides_and_says_that_the_first_row_was_not_compensated(complete):
    _, page, _ = complete
    table = page.text[page.text.index("Table 5.1: mean range error") :]
    for cell in ("2.821", "0.067", "4.931", "0.921", "15.2", "it was not compensated"):
        assert cell in table, cell


def test_same_data_make_the_same_bytes(tmp_path):
    data = measured(most=300)
    data = data.select(data["condition"] == "vibration")
    for folder in ("one", "two"):
        write_report(nothing_found(data), data, MODEL, tmp_path / folder)
    assert names_of(tmp_path / "one") == ["figure_4_19_vibration"]
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name


def test_without_a_field_of_view_the_rest_is_there_and_the_page_says_why(complete, tmp_path):
    _, _, whole = complete
    data = measured(most=300)
    # The pictures of materials, temperatures and interference do not depend on it: left out to save time.
    data = data.select(np.isin(data["condition"], ("baseline", "maximum_range", "temperature_compensation")))
    why = "needs breakaway angles at three ranges"
    findings = replace(whole, field_of_view=None, sonar=None, absent={"sonar": why})
    page = Page(write_report(findings, data, MODEL, tmp_path))
    names = names_of(tmp_path)
    missing = [figure for figure in REPORT_FIGURES if not any(name.startswith(figure) for name in names)]
    assert missing == [f"figure_4_{number:02d}" for number in range(9, 22)]
    assert [name for name in OWN_FIGURES if name not in names] == ["sonar_equation", "section_4_3_8_external"]
    for number in (9, 10, 11, 12):
        assert f"Figure 4.{number}: field of view at" in page.text
    assert page.text.count("No readings of the field of view are in the data.") == 4
    assert "Needs breakaway angles at three ranges." in page.text


def test_readings_and_ranges_alone_make_a_page(tmp_path):
    data = measured(most=300)
    data = only(
        data.select(np.isin(data["condition"], ("baseline", "material"))),
        "time_s",
        "sensor",
        "reading_cm",
        "true_range_cm",
    )
    page = Page(write_report(nothing_found(data), data, MODEL, tmp_path))
    assert names_of(tmp_path) == ["figure_4_04_range_error"]
    assert page.text.count("not drawn.") == len(REPORT_FIGURES) + len(OWN_FIGURES) - 1
    assert "Too few readings." in page.text
    assert "no column condition says which experiment a reading is of" in page.text


def test_ranges_that_change_all_the_time_are_drawn_in_bins(tmp_path):
    rng = np.random.default_rng(5)
    true_cm = rng.uniform(30, 300, 2000)
    data = MeasuredData(
        {
            "time_s": np.arange(2000) * 0.1,
            "sensor": np.full(2000, "sonar"),
            "reading_cm": np.rint(true_cm + rng.normal(0, 1, 2000)),
            "true_range_cm": true_cm,
        }
    )
    write_report(nothing_found(data), data, MODEL, tmp_path)
    assert names_of(tmp_path) == ["figure_4_04_range_error"]


@pytest.mark.parametrize("reading_cm", [765.0, np.nan])
def test_readings_that_are_all_missed(tmp_path, reading_cm):
    data = measured(most=300)
    data = data.select(np.isin(data["condition"], ("baseline", "maximum_range", "field_of_view")))
    columns = dict(data.columns) | {"reading_cm": np.full(len(data), reading_cm)}
    page = Page(write_report(nothing_found(data), MeasuredData(columns), MODEL, tmp_path))
    assert "codes for no echo" in page.text
    assert "figure_4_04_range_error" in names_of(tmp_path)


def test_no_true_range_at_all(tmp_path):
    data = MeasuredData(
        {
            "time_s": np.arange(3.0),
            "sensor": np.full(3, "a"),
            "reading_cm": np.full(3, 100.0),
            "true_range_cm": np.full(3, np.nan),
        }
    )
    page = Page(write_report(nothing_found(data), data, MODEL, tmp_path))
    assert names_of(tmp_path) == []
    assert "No row has a true range" in page.text
    assert "Nothing could be concluded" in page.text


def test_names_from_the_data_are_escaped(tmp_path):
    data = measured(most=300)
    data = data.select(data["condition"] == "material")
    columns = dict(data.columns)
    columns["target"] = np.where(data["target"] == "asphalt", "<b>&grit</b>", data["target"])
    page = Page(write_report(nothing_found(data), MeasuredData(columns), MODEL, tmp_path))
    assert "<b>&grit" not in page.html
    assert "material__b__grit__b_" in names_of(tmp_path)
    assert "No readings of asphalt" in page.text


def test_a_folder_that_cannot_be_made_is_told_in_a_line(tmp_path):
    (tmp_path / "file").write_text("")
    data = measured(most=300)
    data = data.select(data["condition"] == "baseline")
    with pytest.raises(ConfigError, match="the report cannot be written"):
        write_report(nothing_found(data), data, MODEL, tmp_path / "file" / "report")


def test_panels_share_an_axis_of_ranges_where_some_lack_one():
    few = Errors("loud", np.array([200.0] * 5), np.zeros(5), np.zeros(5, dtype=bool))
    many = Errors("quiet", np.repeat([40.0, 200.0, 260.0], 5), np.zeros(15), np.zeros(15, dtype=bool))
    for panels in ([many, few], [few, many]):
        figure = draw_errors(panels)
        assert all(axes.get_xlim() == figure.axes[0].get_xlim() for axes in figure.axes)
        low, high = figure.axes[0].get_xlim()
        assert low < 40.0
        assert high > 260.0


def test_a_stray_reading_hides_neither_the_others_nor_their_mean():
    errors = np.repeat([0.0, 1.0], [300, 300])
    errors[0] = -80.0
    figure = draw_errors([Errors("one", np.repeat([100.0, 200.0], 300), errors, np.zeros(600, dtype=bool))])
    (axes,) = figure.axes
    assert axes.get_yscale() == "linear"
    assert axes.get_ylim()[0] > -5.0
    means: Any = next(each for each in axes.containers if type(each).__name__ == "ErrorbarContainer")
    assert means.lines[0].get_ydata().tolist() == [0.0, 1.0]
