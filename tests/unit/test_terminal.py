"""Names that rich, a terminal or a picture would read as something else are shown as they are."""

import io
from pathlib import Path

import pytest
import yaml
from rich.table import Table

from msp_range.clock import VirtualClock
from msp_range.config import load_airframe
from msp_range.recording.flight_recorder import FlightRecorder
from msp_range.replay import ReplayOutcome, show
from msp_range.terminal import PlainConsole
from msp_sim.page.style import files_of, new_figure, style
from tests.support.programs import run
from tests.support.shipped import CONFIGS

ODD = "[red]quad[/] [/red] :warning: \\[x]"


def airframe_file(tmp_path: Path, vehicle: str) -> Path:
    content = yaml.safe_load((CONFIGS / "quad_pallet.yaml").read_text()) | {"vehicle": vehicle}
    for sensor in content["sensors"]:
        sensor["model"] = str(CONFIGS / sensor["model"])
    path = tmp_path / "a.yaml"
    path.write_text(yaml.safe_dump(content))
    return path


def test_markup_in_what_is_printed_and_in_tables_is_text() -> None:
    out = io.StringIO()
    console = PlainConsole(file=out, width=200, force_terminal=True, color_system=None)
    table = Table(title=ODD)
    table.add_column(ODD)
    table.add_row(ODD)
    console.print(table)
    console.print(ODD, style="bold")
    console.print("a\x1b[31mb\x07")
    assert out.getvalue().count(ODD) == 4
    assert "a\\x1b[31mb\\x07" in out.getvalue()


def test_check_shows_a_vehicle_of_any_name(tmp_path: Path) -> None:
    assert ODD in run("msp-range check", airframe_file(tmp_path, ODD)).output
    # What a terminal would obey is no name.
    result = run("msp-range check", airframe_file(tmp_path, "\x1b[31mred"), code=3)
    assert "found the control character '\\x1b'" in result.output


def test_a_file_of_any_name_is_reported_and_replayed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / f"\x1b[31m{ODD.replace('/', '')}.csv"
    result = run("msp-range replay", path, code=3)
    assert "\\x1b[31m[red]quad" in result.output
    assert "\x1b" not in result.output
    show(ReplayOutcome({}, 0, {}, 1.0, 0.0), Path(path.name))
    assert "\\x1b[31m[red]quad" in "".join(capsys.readouterr().out.split("\n"))


def test_a_recording_is_named_after_any_vehicle(tmp_path: Path) -> None:
    airframe = load_airframe(airframe_file(tmp_path, "../../[red] a/b"))
    FlightRecorder(tmp_path / "flights", airframe.vehicle, VirtualClock()).close()
    (path,) = (tmp_path / "flights").iterdir()
    assert path.name.startswith("red_a_b-")


def test_a_picture_shows_a_name_that_looks_like_a_formula() -> None:
    with style():
        figure = new_figure()
        axes = figure.subplots()
        axes.set_title("$\\frac$ and $x^$")
        axes.set_yscale("log")
        axes.plot([1, 2], [1e-3, 1e3], label="$\\nonsense{$")
        axes.set_xticks([1, 2], ["$a_$", "b"])
        axes.legend()
        assert files_of(figure)["png"].startswith(b"\x89PNG")
