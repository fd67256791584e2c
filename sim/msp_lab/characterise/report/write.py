"""The page and the pictures of a characterisation, on disk."""

from collections.abc import Iterable
from pathlib import Path

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.report import beyond, chapter4, chapter5
from msp_lab.characterise.report.chapter4 import Entry
from msp_lab.characterise.report.questions import effects_table, points_table
from msp_lab.characterise.report.rows import Absent, Rows
from msp_lab.characterise.report.verdicts import conclusions
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import Omitted, Picture, render, write_page
from msp_sim.page.style import png, style


def write_report(findings: Findings, data: MeasuredData, model: SensorModel, directory: Path | str) -> Path:
    """Draw all that the data allow and write the page.

    Parameters
    ----------
    findings
        What was found.
    data
        The readings that it was found in.
    model
        The sensor model with the fitted numbers, in whose terms the mixture is drawn.
    directory
        Where `report.html` and a PNG a picture go; it is made if it is not there, files of these names are replaced.

    Returns
    -------
    Path
        Of the page, which needs none of the other files.

    Raises
    ------
    ConfigError
        The directory cannot be made or written to.
    """
    rows = Rows(data, model)
    with style():
        found = _draw(chapter4.entries(rows), findings, rows)
        noise = _draw(chapter5.entries(), findings, rows)
        more = _draw(beyond.entries(), findings, rows)
        (forest,) = _draw([("questions", "The questions in one picture", beyond.questions)], findings, rows)
    html = render(
        __package__ or "msp_lab.characterise.report",
        "report.html",
        findings=findings,
        model=model,
        conclusions=conclusions(findings),
        forest=forest,
        effects=effects_table(findings),
        chapter4=found,
        chapter5=noise,
        more=more,
        table_5_1=chapter5.table_5_1(findings),
        mixture_table=None if findings.mixture is None else chapter5.mixture_table(findings.mixture),
        points=points_table(findings),
        rows_in_all=len(data),
        report_sensor=chapter4.REPORT_SENSOR,
    )
    return write_page(Path(directory), html, (*found, *noise, *more, forest))


def _draw(entries: Iterable[Entry], findings: Findings, rows: Rows) -> list[Picture | Omitted]:
    """Each entry as a picture, or why it is not there."""
    made: list[Picture | Omitted] = []
    for name, title, make in entries:
        try:
            drawn = make(findings, rows)
        except Absent as absent:
            made.append(Omitted(name, title, str(absent)))
            continue
        made.append(Picture(name, title, drawn.caption, drawn.alternative, png(drawn.figure)))
    return made
