"""The page of a characterisation: complete, self-contained, and whole where parts of the data are missing."""

import io
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from msp_lab.characterise.findings import Findings, HeldOut
from msp_lab.characterise.page.air import range_errors
from msp_lab.characterise.page.answers import conclusions_table
from msp_lab.characterise.page.errors import Errors, draw_errors
from msp_lab.characterise.page.field_of_view import sweep
from msp_lab.characterise.page.mixture import density
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.write import write_report
from msp_lab.characterise.points import sort_into_points
from msp_lab.comparison.report import check_sensor
from msp_lab.comparison.write import write_comparison
from msp_range.acoustics.air import sonic_temperature_c
from msp_range.reading_model.sensor_model import load_sensor_model
from msp_range.recording.csv_form import MeasuredData
from msp_range.yaml_file import ConfigError
from msp_sim.page.style import draw_pit_bars, new_axes
from tests.support.characterised import found_in, measured
from tests.support.known import known
from tests.support.plain_bench import point, table

MODEL = load_sensor_model(Path(__file__).parents[2] / "configs/sensors/mb1242.yaml")

REPORT_FIGURES = [f"figure_4_{number:02d}" for number in range(4, 22)] + [f"figure_5_{n:02d}" for n in range(1, 7)]
REPORT_FIGURES += ["table_5_1_compensation", "section_4_3_8_external"]
PICTURES = [
    "calibration",
    "compensated",
    "compensation",
    "crosstalk_sequential",
    "crosstalk_simultaneous",
    "density_hit",
    "density_missed",
    "density_random",
    "density_short",
    "external_interference",
    "field_of_view_100cm",
    "field_of_view_150cm",
    "field_of_view_200cm",
    "field_of_view_50cm",
    "hot_boxes",
    "longest_range_histogram",
    "longest_range_histogram_masked",
    "longest_range_in_order",
    "longest_range_in_order_masked",
    "material_asphalt",
    "material_concrete",
    "material_plywood",
    "mixture",
    "pit",
    "questions",
    "range_error",
    "sonar_equation",
    "temperature_cold",
    "temperature_hot",
    "temperature_room",
    "uncompensated",
    "vibration",
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

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "srcset", "data", "action", "poster") or name.startswith("on"):
                self.references.append(known(value))
            if name == "id":
                assert value not in self.anchors, f"anchor {value} is there twice"
                self.anchors.add(known(value))
        if tag == "img":
            self.images += 1
            assert dict(attrs)["alt"], "a picture without words for who cannot see it"

    def handle_data(self, data: str) -> None:
        self.words.append(data)


class Complete(NamedTuple):
    """A characterisation of all conditions: the folder of its pictures, its page and its findings."""

    folder: Path
    page: Page
    findings: Findings


@pytest.fixture(scope="module")
def findings() -> Findings:
    return found_in(measured(most=2000))


@pytest.fixture(scope="module")
def complete(findings: Findings, tmp_path_factory: pytest.TempPathFactory) -> Complete:
    folder = tmp_path_factory.mktemp("report")
    path = write_report(pictured(findings, measured(most=2000)), folder)
    return Complete(folder, Page(path), findings)


@pytest.fixture(scope="module")
def compared(complete: Complete, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Page]:
    """The comparison with the report, of all findings, with the figures of two conditions."""
    data = measured(most=2000)
    data = data.select(np.isin(data["condition"], ("baseline", "temperature_compensation")))
    folder = tmp_path_factory.mktemp("comparison")
    return folder, Page(write_comparison(complete.findings, sort_into_points(data, MODEL), MODEL, folder))


def pictured(findings: Findings, data: MeasuredData) -> PictureData:
    return PictureData(findings, sort_into_points(data, MODEL), MODEL)


def only(data: MeasuredData, *names: str) -> MeasuredData:
    return MeasuredData({name: data[name] for name in names})


def names_of(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.png"))


def nothing_found(data: MeasuredData) -> Findings:
    return Findings("other", "2026-10-05", 22.5, (), (), absent={"mixture": "too few readings"})


@pytest.mark.slow
def test_every_picture_is_there(complete: Complete) -> None:
    folder, page, _ = complete
    assert names_of(folder) == PICTURES
    assert page.images == len(PICTURES)
    assert set(PICTURES) <= page.anchors


@pytest.mark.slow
def test_the_page_knows_nothing_of_a_report_that_its_reader_does_not_have(complete: Complete) -> None:
    _, page, _ = complete
    assert not re.search(r"[Ff]igure \d|Table \d|[Cc]hapter|[Ee]rrat|\beq \d|the report|\b4\.3\.\d", page.text)


@pytest.mark.slow
def test_page_asks_for_nothing_from_outside(complete: Complete) -> None:
    _, page, _ = complete
    for reference in page.references:
        assert reference.startswith(("#", "data:image/png;base64,")), reference[:80]
    for reference in page.references:
        if reference.startswith("#"):
            assert reference[1:] in page.anchors, reference
    assert not {"script", "link", "iframe", "object", "embed"} & set(page.tags)
    assert not re.search(r"@import|url\(|https?://", page.html)


@pytest.mark.slow
def test_the_words_for_who_cannot_see_a_picture_are_not_its_heading_again(complete: Complete) -> None:
    pairs = re.findall(r'<h3>(.*?)</h3>\s*<img src="[^"]*" alt="(.*?)">', complete.page.html)
    assert len(pairs) > 20
    assert all(heading != alternative for heading, alternative in pairs)


@pytest.mark.slow
def test_pictures_are_png_of_one_width_and_not_blank(complete: Complete) -> None:
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


@pytest.mark.parametrize(
    ("tried", "verdict"), [((HeldOut("none", 0.1, None),), "none shown to help"), ((), "cannot tell")]
)
def test_no_calibration_is_no_proof_that_none_is_needed(
    findings: Findings, tried: tuple[HeldOut, ...], verdict: str
) -> None:
    calibration = replace(known(findings.calibration), form="none", knots=(), held_out=tried)
    found = conclusions_table(replace(findings, calibration=calibration))
    assert [str(mark) for subject, mark, _ in found.rows if subject == "Calibration"] == [verdict]


@pytest.mark.slow
def test_the_answer_stands_first_and_then_the_verdicts(complete: Complete) -> None:
    _, page, findings = complete
    (hot,) = (each for each in findings.questions if each.level == "46 C")
    bias = known(hot.effects[0].estimate)
    text = page.text
    assert text.index("Hits of the MB1242 are off by ") < text.index("What was found") < text.index("Methods")
    head = text[: text.index("Every effect in numbers")]
    assert "What changes the readings: the air at the sensor, the other sensor's ping." in head
    assert "What may, which these data cannot decide: the external source." in head
    number = f"{bias.value:.2f} ({bias.low:.2f} to {bias.high:.2f}) cm".replace("-", "−")
    for words in ("23.4°", number, "cannot tell", "a filter with it may be overconfident"):
        assert words in head, words


@pytest.mark.slow
def test_every_figure_of_the_report_is_there_or_says_why_not(complete: Complete, tmp_path: Path) -> None:
    data = measured(most=2000)
    data = data.select(data["condition"] != "vibration")
    page = Page(write_comparison(complete.findings, sort_into_points(data, MODEL), MODEL, tmp_path))
    names = names_of(tmp_path)
    missing = [figure for figure in REPORT_FIGURES if not any(name.startswith(figure) for name in names)]
    assert missing == ["figure_4_19"]
    why = "No readings of vibration are in the data (column condition)."
    assert f"Figure 4.19: range error, vibration: not drawn. {why}" in page.text
    assert page.images == len(names)
    assert set(names) <= page.anchors


@pytest.mark.slow
def test_the_comparison_has_both_numbers_and_says_where_they_agree(compared: tuple[Path, Page]) -> None:
    _, page = compared
    head = page.text[page.text.index("Where both agree") : page.text.index("The report's figures from these readings")]
    for words in ("agrees 23.4° or more (no larger angle was tried) 23.4°", "near 503 cm", "4.3.8: inconclusive"):
        assert words in head, words
    assert "The report: at 60 Hz" not in page.text


@pytest.mark.slow
def test_table_5_1_has_both_sides_and_says_that_the_first_row_was_not_compensated(compared: tuple[Path, Page]) -> None:
    _, page = compared
    table = page.text[page.text.index("Table 5.1: mean range error") :]
    for cell in ("2.821", "0.067", "4.931", "0.921", "15.2", "it was not compensated"):
        assert cell in table, cell


def test_another_sensor_is_not_compared_with_the_report() -> None:
    other = MODEL.model_copy(update={"name": "HC-SR04"})
    with pytest.raises(ConfigError, match="the report is about the MB1242, not the HC-SR04"):
        check_sensor(other)
    check_sensor(MODEL)


def test_same_data_make_the_same_bytes(tmp_path: Path) -> None:
    data = measured(most=300)
    data = data.select(data["condition"] == "vibration")
    for folder in ("one", "two"):
        write_report(pictured(nothing_found(data), data), tmp_path / folder)
    assert names_of(tmp_path / "one") == ["vibration"]
    for path in (tmp_path / "one").iterdir():
        assert path.read_bytes() == (tmp_path / "two" / path.name).read_bytes(), path.name


@pytest.mark.slow
def test_without_a_field_of_view_the_rest_is_there_and_the_page_says_why(complete: Complete, tmp_path: Path) -> None:
    _, _, whole = complete
    data = measured(most=300)
    # Other conditions and the mixture do not depend on it: left out to save time.
    data = data.select(np.isin(data["condition"], ("baseline", "temperature_compensation")))
    why = "needs breakaway angles at three ranges"
    findings = replace(whole, field_of_view=None, sonar=None, questions=(), absent={"sonar": why})
    findings = replace(findings, mixture=None, maximum_range=None, hot_boxes=())
    page = Page(write_report(pictured(findings, data), tmp_path))
    assert names_of(tmp_path) == ["calibration", "compensated", "compensation", "range_error", "uncompensated"]
    assert why in page.text
    assert "not drawn" not in page.text


def test_readings_and_ranges_alone_make_a_page(tmp_path: Path) -> None:
    data = measured(most=300)
    data = only(
        data.select(np.isin(data["condition"], ("baseline", "material"))),
        "time_s",
        "sensor",
        "reading_cm",
        "true_range_cm",
    )
    page = Page(write_report(pictured(nothing_found(data), data), tmp_path))
    assert names_of(tmp_path) == ["range_error"]
    assert "too few readings" in page.text
    assert "Does it matter?" not in page.text


def test_ranges_that_change_all_the_time_are_drawn_in_bins(tmp_path: Path) -> None:
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
    write_report(pictured(nothing_found(data), data), tmp_path)
    assert names_of(tmp_path) == ["range_error"]


@pytest.mark.parametrize("reading_cm", [765.0, np.nan])
def test_readings_that_are_all_missed(tmp_path: Path, reading_cm: float) -> None:
    data = measured(most=300)
    data = data.select(np.isin(data["condition"], ("baseline", "maximum_range", "field_of_view")))
    columns = dict(data.columns) | {"reading_cm": np.full(len(data), reading_cm)}
    page = Page(write_report(pictured(nothing_found(data), MeasuredData(columns)), tmp_path))
    assert "none was answered" in page.text or "missed: 1" in page.text
    assert "range_error" in names_of(tmp_path)


def test_no_true_range_at_all(tmp_path: Path) -> None:
    data = MeasuredData(
        {
            "time_s": np.arange(3.0),
            "sensor": np.full(3, "a"),
            "reading_cm": np.full(3, 100.0),
            "true_range_cm": np.full(3, np.nan),
        }
    )
    page = Page(write_report(pictured(nothing_found(data), data), tmp_path))
    assert names_of(tmp_path) == []
    assert "Nothing could be concluded" in page.text


def test_names_from_the_data_are_escaped(tmp_path: Path) -> None:
    data = measured(most=300)
    data = data.select(data["condition"] == "material")
    columns = dict(data.columns)
    columns["target"] = np.where(data["target"] == "asphalt", "<b>&grit</b>", data["target"])
    page = Page(write_report(pictured(nothing_found(data), MeasuredData(columns)), tmp_path))
    assert "<b>&grit" not in page.html
    assert "material__b__grit__b_" in names_of(tmp_path)


def test_a_folder_that_cannot_be_made_is_reported_in_a_line(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    data = measured(most=300)
    data = data.select(data["condition"] == "baseline")
    with pytest.raises(ConfigError, match="the report cannot be written"):
        write_report(pictured(nothing_found(data), data), tmp_path / "file" / "report")


def test_panels_share_an_axis_of_ranges_where_some_lack_one() -> None:
    few = Errors("loud", np.array([200.0] * 5), np.zeros(5), np.zeros(5, dtype=bool))
    many = Errors("quiet", np.repeat([40.0, 200.0, 260.0], 5), np.zeros(15), np.zeros(15, dtype=bool))
    for panels in ([many, few], [few, many]):
        figure = draw_errors(panels)
        assert all(axes.get_xlim() == figure.axes[0].get_xlim() for axes in figure.axes)
        low, high = figure.axes[0].get_xlim()
        assert low < 40.0
        assert high > 260.0


def means_in(axes: Any) -> list[float]:
    """The values that are drawn with an interval."""
    drawn = [each for each in axes.containers if type(each).__name__ == "ErrorbarContainer"]
    return [mean for each in drawn for mean in each.lines[0].get_ydata().tolist()]


def test_a_stray_reading_hides_neither_the_others_nor_their_mean() -> None:
    errors = np.repeat([0.0, 1.0], [300, 300])
    errors[0] = -80.0
    figure = draw_errors([Errors("one", np.repeat([100.0, 200.0], 300), errors, np.zeros(600, dtype=bool))])
    (axes,) = figure.axes
    assert axes.get_ylim()[0] > -5.0
    assert means_in(axes) == [0.0, 1.0]


def test_half_of_the_readings_far_off_have_a_mean_near_the_median_too() -> None:
    """A median between two clusters has no readings near it, and nothing would be drawn."""
    errors = np.tile(np.repeat([0.0, -80.0], 50), 2)
    (axes,) = draw_errors([Errors("one", np.repeat([100.0, 200.0], 100), errors, np.zeros(200, dtype=bool))]).axes
    means = means_in(axes)
    assert len(means) == 2
    assert set(means) <= {0.0, -80.0}


def test_an_axis_of_about_five_centimetres_is_to_scale() -> None:
    ranges = np.repeat([100.0, 200.0], 400)
    errors = np.random.default_rng(1).normal(0.0, 1.25, 800)
    (row, *_) = draw_errors([Errors("one", ranges, errors, np.zeros(800, dtype=bool))]).axes
    assert 4.0 < row.get_ylim()[1] < 5.0
    assert row.get_yscale() == "linear"
    assert len(row.get_yticks()) > 4


def test_two_sensors_at_the_same_angles_are_drawn() -> None:
    """Their angles are the same places, and no bar is of no width."""
    rng = np.random.default_rng(3)
    data = table(
        *(
            point(rng, 100, n=20, sensor=sensor, condition="field_of_view", incidence_deg=1.8 * step)
            for sensor in ("left", "right")
            for step in range(-5, 6)
        ),
        *(point(rng, z, n=40, sensor="left") for z in (60, 120, 180, 240)),
    )
    figure, caption = sweep(pictured(found_in(data), data), 100.0)
    assert caption.startswith("440 readings at 11 angles")
    for axes in figure.axes:
        bars: Any = [bar for container in axes.containers for bar in container]
        assert max(bar.get_width() for bar in bars) > 1.0


@pytest.mark.parametrize("stray_cm", [-3.6, -80.0])
def test_readings_that_are_drawn_at_the_edge_are_counted(stray_cm: float) -> None:
    errors = np.repeat([0.0, 1.0], [300, 300])
    errors[0] = stray_cm
    figure = draw_errors([Errors("one", np.repeat([100.0, 200.0], 300), errors, np.zeros(600, dtype=bool))])
    (axes,) = figure.axes
    (above,) = axes.child_axes
    (edge,) = [line for line in axes.lines if line.get_label() == "readings farther off"]
    assert edge.get_ydata() == pytest.approx([axes.get_ylim()[0]])
    assert [text.get_text() for text in above.get_xticklabels()] == ["1/300\n0", "0\n0"]
    assert [text.get_text() for text in axes.texts] == ["off the axis\nmissed"]


def test_on_a_compressed_axis_what_is_beyond_5_cm_is_counted_and_nothing_nearer_is_off_it() -> None:
    errors = np.zeros(1000)
    errors[:40] = 60.0
    errors[40] = -4.5
    figure = draw_errors([Errors("one", np.repeat([100.0, 200.0], 500), errors, np.zeros(1000, dtype=bool))])
    (axes,) = figure.axes
    assert axes.get_yscale() == "symlog"
    assert axes.get_ylim()[0] <= -5.0
    (above,) = axes.child_axes
    assert [text.get_text() for text in above.get_xticklabels()] == ["40/500\n0", "0\n0"]
    assert [text.get_text() for text in axes.texts] == ["over ±5 cm\nmissed"]


def test_the_band_of_a_pit_histogram_is_that_of_its_counts() -> None:
    """With few readings a bin its ends are whole readings."""
    _, axes = new_axes(3.0)
    draw_pit_bars(axes, np.full(20, 4))
    (band,) = [each for each in axes.patches if each.get_label() == "random variation (95 %)"]
    low, high = np.array(band.get_extents().transformed(axes.transData.inverted()).intervaly)
    # Of 80 in 20 bins: 1 to 8 have 2.5 % at most below and above.
    assert (low, high) == pytest.approx((0.25, 2.0))


def test_the_picture_of_compensated_ranges_is_of_the_air_s_humidity_too() -> None:
    """In saturated air of 30 deg C sound is 0.7 % faster than in dry air: 2 cm of 3 m."""
    rng = np.random.default_rng(3)
    sonic_k = sonic_temperature_c(30.0, 100.0) + 273.15
    shift = math.sqrt((22.5 + 273.15) / sonic_k) - 1.0
    air: dict[str, Any] = {"condition": "temperature_compensation", "air_temperature_c": 30.0, "humidity_pct": 100.0}
    data = table(*(point(rng, z, error_cm=z * shift, sigma_cm=0.3, **air) for z in (250, 300, 350)))
    _, caption = range_errors(pictured(nothing_found(data), data), after=True)
    (median_cm,) = re.findall(r"median error (\S+) cm", caption)
    assert abs(float(median_cm.replace("−", "-"))) < 0.5


def test_of_a_kind_without_a_reading_the_picture_says_whose_rate_is_drawn() -> None:
    data = measured(most=300)
    weights = MODEL.reading_model.weights
    none_short = weights.model_copy(update={"short": 0.0, "hit": weights.hit + weights.short})
    mixture = MODEL.reading_model.model_copy(update={"weights": none_short})
    model = MODEL.model_copy(update={"reading_model": mixture})
    figure, _ = density(PictureData(found_in(data), sort_into_points(data, model), model), "short")
    (axes,) = figure.axes
    assert any("its rate is the starting model's" in text.get_text() for text in axes.texts)
