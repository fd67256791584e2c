"""The page that sets findings next to the report: its conclusions as a table, and its figures by number."""

from pathlib import Path

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.write import drawn_or_omitted
from msp_lab.comparison.compare import compare_with_report
from msp_lab.comparison.figures import entries, table_5_1
from msp_lab.comparison.report import REPORT
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import render, write_page
from msp_sim.page.style import style

COMPARISON = "comparison.html"


def write_comparison(findings: Findings, data: MeasuredData, model: SensorModel, folder: Path) -> Path:
    """Write `COMPARISON` and its pictures, and return its path.

    Raises
    ------
    ConfigError
        The folder cannot be made or written to.
    """
    with style():
        figures = drawn_or_omitted(entries(), PictureData(findings, data, model, REPORT))
    table = table_5_1(findings)
    html = render(
        __package__ or "msp_lab.comparison",
        COMPARISON,
        findings=findings,
        lines=list(compare_with_report(findings)),
        figures=figures,
        table_5_1=table,
    )
    return write_page(folder, html, figures, COMPARISON, [table])
