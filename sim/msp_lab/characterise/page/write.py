"""The page and the pictures of a characterisation, on disk."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, questions, range_error
from msp_lab.characterise.page.answers import conclusions, summarise
from msp_lab.characterise.page.picture_data import Absent, Entry, PictureData
from msp_lab.characterise.page.tables import compensation_table, effects_table, mixture_table, points_table
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import Omitted, Picture, render, write_page
from msp_sim.page.style import files_of, style

SECTIONS = (
    ("errors", "Range errors", (range_error, longest_range)),
    ("beam", "Field of view", (field_of_view,)),
    ("air", "Air temperature", (air,)),
    ("mixture-fit", "Kinds of readings", (mixture,)),
)
"""Anchor and title of each section, and the modules with its pictures."""


def write_report(findings: Findings, data: MeasuredData, model: SensorModel, directory: Path | str) -> Path:
    """Draw what the data allow and write the page.

    Parameters
    ----------
    findings
        What was found.
    data
        The readings that it was found in.
    model
        The sensor model with the fitted numbers, in whose terms the mixture is drawn.
    directory
        Where `report.html` and a PNG per picture go; it is made if it is not there, files of these names are replaced.

    Returns
    -------
    Path
        The page, which needs none of the other files.

    Raises
    ------
    ConfigError
        The directory cannot be made or written to.
    """
    rows = PictureData(findings, data, model)
    with style():
        sections = [
            (anchor, title, _drawn(chain.from_iterable(module.entries(rows) for module in modules), rows))
            for anchor, title, modules in SECTIONS
        ]
        forest = _drawn(questions.entries(rows), rows)
    tables = {
        "effects": effects_table(findings),
        "compensation_table": compensation_table(findings),
        "mixture_table": mixture_table(findings),
        "points": points_table(findings),
    }
    html = render(
        __package__ or "msp_lab.characterise.page",
        "report.html",
        findings=findings,
        model=model,
        answer=summarise(findings),
        conclusions=conclusions(findings),
        forest=forest,
        sections=[section for section in sections if section[2]],
        rows_in_all=len(data),
        **tables,
    )
    pictures = [*forest, *(each for _, _, some in sections for each in some)]
    return write_page(Path(directory), html, pictures, tables=tables.values())


def _drawn(entries: Iterable[Entry], rows: PictureData) -> list[Picture]:
    """The entries that the data allow, as pictures."""
    return [each for each in drawn_or_omitted(entries, rows) if isinstance(each, Picture)]


def drawn_or_omitted(entries: Iterable[Entry], rows: PictureData) -> list[Picture | Omitted]:
    """Return each entry as a picture, or why the data do not allow it."""
    made: list[Picture | Omitted] = []
    for name, title, make in entries:
        try:
            found = make(rows)
        except Absent as absent:
            made.append(Omitted(name, title, str(absent)))
        else:
            made.append(Picture(name, title, found.caption, found.alternative, files_of(found.figure)))
    return made
