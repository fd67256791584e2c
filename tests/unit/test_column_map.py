"""Other people's names and units, and what is reported where a map does not fit."""

import gzip
from pathlib import Path

import numpy as np
import pytest

from msp_lab.readings.column_map import load_map, read_mapped
from msp_range.recording.csv_form import MeasuredData, to_number
from msp_range.recording.error import RecordingError
from msp_range.yaml_file import ConfigError

MAPS = Path(__file__).parents[2] / "configs" / "maps"


def written(folder: Path, text: str, name: str = "theirs.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def mapped(folder: Path, table: str, column_map: str) -> MeasuredData:
    return read_mapped(written(folder, table), load_map([str(written(folder, column_map, "map.yaml"))]), 765.0)


def test_units_signs_codes_and_constants(tmp_path: Path) -> None:
    data = mapped(
        tmp_path,
        "dist [in],actual,T,angle\n39.37,1.0,68,0.1\n300,2.0,32,-0.2\n-1,3.0,,0\n",
        "columns:\n"
        "  reading_cm: {column: 'dist [in]', unit: in}\n"
        "  true_range_cm: {column: actual, unit: m, offset: -1.5}\n"
        "  air_temperature_c: {column: T, unit: F}\n"
        "  incidence_deg: {column: angle, unit: rad, factor: -1}\n"
        "  condition: {value: baseline}\n"
        "codes: {no_echo: [300], no_answer: [-1]}\n",
    )
    assert data["reading_cm"] == pytest.approx([100.0, 765.0, np.nan], abs=0.01, nan_ok=True)
    assert data["true_range_cm"] == pytest.approx([98.5, 198.5, 298.5])
    assert data["air_temperature_c"] == pytest.approx([20.0, 0.0, np.nan], nan_ok=True)
    assert data["incidence_deg"] == pytest.approx([-5.7296, 11.4592, 0.0], abs=1e-4)
    assert data["condition"].tolist() == ["baseline"] * 3
    assert data["sensor"].tolist() == ["theirs"] * 3
    assert data["time_s"].tolist() == [0.0, 1.0, 2.0]


def test_decimal_commas(tmp_path: Path) -> None:
    """Words keep theirs, also where most of a column are numbers."""
    table = "dist;true;note;volts\n100,5;1,01;left, wet;4,9\n;2;dry;-5,0e-1\n"
    columns = "{reading_cm: dist, true_range_cm: {column: 'true', unit: m}, note: note, supply_v: volts}"
    data = mapped(tmp_path, table, f"delimiter: ';'\ndecimal: ','\ncolumns: {columns}\n")
    assert data["reading_cm"] == pytest.approx([100.5, np.nan], nan_ok=True)
    assert data["true_range_cm"] == pytest.approx([101.0, 200.0])
    assert data["note"].tolist() == ["left, wet", "dry"]
    assert data["supply_v"] == pytest.approx([4.9, -0.5])
    with pytest.raises(RecordingError, match=r"nothing where it is unknown\. With decimal commas"):
        mapped(tmp_path, table, f"delimiter: ';'\ncolumns: {columns}\n")


def test_tables_side_by_side_and_compressed(tmp_path: Path) -> None:
    path = tmp_path / "two.csv.gz"
    path.write_bytes(gzip.compress(b"a,d,,a,d\n1,10,,2,20\n3,11,,,\n"))
    column_map = written(
        tmp_path,
        "parts:\n"
        "  - columns: {incidence_deg: 1, reading_cm: 2, true_range_cm: {value: 10}}\n"
        "  - columns: {incidence_deg: 4, reading_cm: 5, true_range_cm: {value: 20}}\n",
        "map.yaml",
    )
    data = read_mapped(path, load_map([str(column_map)]), 765.0)
    assert data["reading_cm"].tolist() == [10.0, 11.0, 20.0]
    assert data["true_range_cm"].tolist() == [10.0, 10.0, 20.0]
    assert data["incidence_deg"].tolist() == [1.0, 3.0, 2.0]


def test_a_map_on_the_command_line_and_names_that_are_right_already(tmp_path: Path) -> None:
    path = written(tmp_path, "distance,true_range_cm,sensor\n1.2,121,left\n")
    data = read_mapped(path, load_map(["reading_cm=distance*100"]), 765.0)
    assert data["reading_cm"].tolist() == [120.0]
    assert (data["true_range_cm"].tolist(), data["sensor"].tolist()) == ([121.0], ["left"])


def test_rows_are_left_out_by_value(tmp_path: Path) -> None:
    data = mapped(
        tmp_path,
        "r,a\n10,0\n11,1\n12,2\n",
        "columns: {reading_cm: r, incidence_deg: a}\nleave_out: {incidence_deg: [0, 1]}\n",
    )
    assert data["reading_cm"].tolist() == [12.0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ["reading=dist"],
            "found the column name 'reading', which the CSV form does not have. Did you mean 'reading_cm'",
        ),
        (["reading_cm"], "expected one YAML file, or NAME=COLUMN"),
        (["reading_cm=a", "b"], "expected one YAML file, or NAME=COLUMN"),
        (["reading_cm=dist*ten"], "there is no column"),
        (["missing.yaml"], "no such file"),
    ],
)
def test_user_errors_in_options(tmp_path: Path, options: list[str], message: str) -> None:
    path = written(tmp_path, "dist,b\n1,2\n")
    with pytest.raises((ConfigError, RecordingError), match=message):
        read_mapped(
            path, load_map([str(tmp_path / each) if each.endswith("yaml") else each for each in options]), 765.0
        )


@pytest.mark.parametrize(
    ("column_map", "message"),
    [
        ("columns: {reading_cm: dst}", "there is no column 'dst' for reading_cm. Did you mean 'dist'"),
        ("columns: {reading_cm: twice}", "'twice' occurs 2 times; give its number"),
        ("columns: {reading_cm: 9}", "found 4 columns, expected a number 9"),
        ("columns: {true_range_cm: dist}", "the map has no column for reading_cm"),
        ("columns: {reading_cm: {column: dist, unit: rad}}", "found the unit 'rad', expected one of m, cm, mm, in, ft"),
        ("columns: {reading_cm: {column: dist, value: 3}}", "either a column or a value"),
        ("columns: {reading: dist}", "Did you mean 'reading_cm'"),
        ("columns: {reading_cm: word}", "theirs.csv:2: column 'word': found 'x', expected a number"),
        ("columns: {reading_cm: dist}\nleave_out: {throttle: [1]}", "leaves out rows by throttle"),
        ("columns: {reading_cm: dist}\ncode: {no_echo: [1]}", "Did you mean 'codes'"),
        ("columns: {reading_cm: dist}\ndecimal: ','", "found decimal and delimiter ',', expected two different ones"),
    ],
)
def test_user_errors_in_a_map_file(tmp_path: Path, column_map: str, message: str) -> None:
    with pytest.raises((ConfigError, RecordingError), match=message):
        mapped(tmp_path, "dist,word,twice,twice\n1,x,2,3\n", column_map)


@pytest.mark.slow
def test_a_packed_bomb_is_refused_at_once(tmp_path: Path) -> None:
    path = tmp_path / "bomb.csv.gz"
    # What comes after 2 MB is no text: nothing is reported of it, so it is not read.
    path.write_bytes(gzip.compress(b"dist\n" + b"1\n" * 1_000_000 + b"\xff" * 2_000_000))
    with pytest.raises(RecordingError, match=r"bomb\.csv\.gz: found more than 1 MB of unpacked text, expected less"):
        read_mapped(path, load_map(["reading_cm=dist"]), 765.0)


def test_more_rows_than_are_held_at_a_time(tmp_path: Path) -> None:
    """Blocks of both tables side by side, the second of which is shorter."""
    rows = [f"{i},{i % 700},{i if i < 3000 else ''}" for i in range(5000)]
    path = tmp_path / "theirs.csv"
    path.write_text("t,a,b\n" + "\n".join(rows) + "\n")
    (tmp_path / "map.yaml").write_text(
        "parts:\n  - columns: {reading_cm: a, time_s: t}\n  - columns: {reading_cm: b, throttle: {value: 0.5}}\n"
    )
    data = read_mapped(path, load_map([str(tmp_path / "map.yaml")]), 765.0)
    assert data["reading_cm"].tolist() == [i % 700 for i in range(5000)] + list(range(3000))
    assert data["time_s"].tolist()[:5000] == list(range(5000))
    assert np.isnan(data["throttle"][:5000]).all()
    assert (data["throttle"][5000:] == 0.5).all()


def test_a_file_that_is_no_table(tmp_path: Path) -> None:
    path = tmp_path / "broken.csv.gz"
    path.write_bytes(b"\x1f\x8bnot really")
    with pytest.raises(RecordingError, match="broken"):
        read_mapped(path, load_map(["reading_cm=a"]), 765.0)


@pytest.mark.parametrize("path", sorted(MAPS.glob("*.yaml")), ids=lambda path: path.stem)
def test_the_maps_that_are_shipped_are_maps(path: Path) -> None:
    assert load_map([str(path)])


def test_columns_of_ones_own_are_numbers_or_words(tmp_path: Path) -> None:
    rows = "\n".join(
        f"{100 + i},{4.5 + i / 1e4:.4f},{'a1' if i < 1500 else ''},{i if i < 2000 else 'none'}" for i in range(2100)
    )
    data = mapped(
        tmp_path,
        f"r,v,where,mixed\n{rows}\n",
        "columns: {reading_cm: r, supply_mv: {column: v, factor: 1000}, anchor: where, state: mixed}\n",
    )
    assert data["supply_mv"][:2].tolist() == [4500.0, 4500.1]
    assert (data["anchor"][0], data["anchor"][-1]) == ("a1", "")
    # Words that begin after two thousand numbers: it was words all along.
    assert (data["state"][0], data["state"][-1]) == ("0", "none")


def test_parts_with_words_and_with_numbers_keep_both(tmp_path: Path) -> None:
    parts = "[{columns: {reading_cm: a, mark: b}}, {columns: {reading_cm: c, mark: d}}]"
    data = mapped(tmp_path, "a,b,c,d\n100,wet,200,1\n101,dry,201,02\n", f"parts: {parts}\n")
    assert data["mark"].tolist() == ["wet", "dry", "1", "02"]
    data = mapped(tmp_path, "a,b,c,d\n100,3,200,1\n101,,201,02\n", f"parts: {parts}\n")
    assert data["mark"] == pytest.approx([3.0, np.nan, 1.0, 2.0], nan_ok=True)


def test_a_constant_is_parsed_once_for_many_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once for a block of rows; where it is no number it is named with a line."""
    parsed: list[str] = []

    def counted(cell: str) -> float:
        parsed.append(cell)
        return to_number(cell)

    monkeypatch.setattr("msp_range.recording.csv_form.to_number", counted)
    table = "a\n" + "100\n" * 3000
    columns = "reading_cm: a, air_temperature_c: {value: 68, unit: F}, target: {value: wood}, mark: {value: '7'}"
    data = mapped(tmp_path, table, f"columns: {{{columns}}}\n")
    assert np.all(data["air_temperature_c"] == 20.0)
    assert 0 < parsed.count("68.0") < 10
    assert set(data["target"].tolist()) == {"wood"}
    assert np.all(data["mark"] == 7.0)
    assert len(data) == 3000
    with pytest.raises(RecordingError, match=r"theirs.csv:2: column 'air_temperature_c': found 'warm'"):
        mapped(tmp_path, table, "columns: {reading_cm: a, air_temperature_c: {value: warm}}\n")


def test_without_a_time_column_nothing_drifts_over_the_rows_numbers(tmp_path: Path) -> None:
    data = mapped(tmp_path, "r\n10\n11\n", "columns: {reading_cm: r}\n")
    assert np.isnan(data["time_in_run_s"]).all()
    assert "time_in_run_s" not in mapped(tmp_path, "r,t\n10,0\n11,1\n", "columns: {reading_cm: r, time_s: t}\n")
