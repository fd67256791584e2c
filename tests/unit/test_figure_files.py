"""Files of figures and tables: PNG always, SVG and PDF where they are chosen, and tables as CSV next to their page."""

import csv
from contextvars import copy_context
from pathlib import Path

import pytest
from matplotlib.figure import Figure

from msp_sim.page.page import Picture, write_page
from msp_sim.page.style import choose_format, files_of, new_figure, save, style
from msp_sim.page.table import PageTable
from tests.support.programs import run

FIRST_BYTES = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}


def figure() -> Figure:
    with style():
        made = new_figure(2.0)
        made.subplots().plot([0.0, 1.0], [1.0, 2.0])
    return made


def chosen(name: str) -> dict[str, bytes]:
    def make() -> dict[str, bytes]:
        choose_format(name)
        return files_of(figure())

    return copy_context().run(make)


@pytest.mark.parametrize("name", ["png", "svg", "pdf"])
def test_a_chosen_format_comes_with_the_png_and_is_the_same_each_time(name: str) -> None:
    files = chosen(name)
    assert set(files) == {"png", name}
    assert all(content.startswith(FIRST_BYTES[each]) for each, content in files.items())
    assert chosen(name) == files


def test_a_page_has_its_figures_and_tables_as_files_next_to_it(tmp_path: Path) -> None:
    picture = Picture("lead", "", "", chosen("svg"))
    table = PageTable("of-run 1/a", "", ("effect", "size [cm]"), (("offset, of a sensor", "1.5"),))
    empty = PageTable("empty", "", ("effect",), ())
    write_page(tmp_path, "msp_sim.page/page.html", [picture], [table, empty])
    assert {each.name for each in tmp_path.iterdir()} == {"report.html", "lead.png", "lead.svg", "of-run 1_a.csv"}
    with (tmp_path / "of-run 1_a.csv").open(newline="", encoding="utf-8") as file:
        assert list(csv.reader(file)) == [["effect", "size [cm]"], ["offset, of a sensor", "1.5"]]


def test_the_name_of_a_file_chooses_too(tmp_path: Path) -> None:
    save(figure(), tmp_path / "flight.pdf")
    save(figure(), tmp_path / "flight.png")
    assert {each.name for each in tmp_path.iterdir()} == {"flight.pdf", "flight.png"}
    assert (tmp_path / "flight.pdf").read_bytes().startswith(b"%PDF")


def test_another_format_is_a_user_error() -> None:
    assert "gif" in run("msp-lab --format gif effects", code=2).output
