"""The page and the pictures of a characterisation, on disk."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, questions, range_error
from msp_lab.characterise.page.answers import conclusions, summarise
from msp_lab.characterise.page.picture_data import Absent, Entry, PictureData
from msp_lab.characterise.page.points_table import make_points_table
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import Omitted, Picture, render, write_page
from msp_sim.page.style import files_of, style


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
    rows, by_sound = PictureData(data, model), findings.calibration_temperature_c is not None
    with style():
        accuracy = chain(range_error.entries(rows), longest_range.entries())
        sections = [
            ("errors", "Range errors", drawn(accuracy, findings, rows)),
            ("beam", "Field of view", drawn(field_of_view.entries(rows), findings, rows)),
            ("air", "Air temperature", drawn(air.entries() if by_sound else (), findings, rows)),
            ("mixture-fit", "Kinds of readings", drawn(mixture.entries(), findings, rows)),
        ]
        forest = drawn([("questions", "The questions in one picture", questions.forest)], findings, rows)
    fitted = None if findings.mixture is None else mixture.mixture_table(findings.mixture)
    tables = (
        effects := questions.effects_table(findings),
        compensation := air.compensation_table(findings),
        fitted,
        points := make_points_table(findings),
    )
    html = render(
        __package__ or "msp_lab.characterise.page",
        "report.html",
        findings=findings,
        model=model,
        answer=summarise(findings),
        conclusions=conclusions(findings),
        forest=forest,
        effects=effects,
        sections=[section for section in sections if section[2]],
        compensation_table=compensation,
        mixture_table=fitted,
        points=points,
        rows_in_all=len(data),
    )
    pictures = [*forest, *(each for _, _, some in sections for each in some)]
    return write_page(Path(directory), html, pictures, tables=tables)


def drawn(entries: Iterable[Entry], findings: Findings, rows: PictureData) -> list[Picture]:
    """Return the entries that the data allow, as pictures."""
    return [each for each in drawn_or_omitted(entries, findings, rows) if isinstance(each, Picture)]


def drawn_or_omitted(entries: Iterable[Entry], findings: Findings, rows: PictureData) -> list[Picture | Omitted]:
    """Return each entry as a picture, or why the data do not allow it."""
    made: list[Picture | Omitted] = []
    for name, title, make in entries:
        try:
            found = make(findings, rows)
        except Absent as absent:
            made.append(Omitted(name, title, str(absent)))
            continue
        made.append(Picture(name, title, found.caption, found.alternative, files_of(found.figure)))
    return made
