"""The page that sets findings next to the report: its conclusions as a table, and its figures by number."""

from collections.abc import Sequence
from pathlib import Path

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.points import PointReadings
from msp_lab.comparison.compare import comparison_table
from msp_lab.comparison.figures import entries, table_5_1
from msp_lab.comparison.report import REPORT
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import pictures_of, write_page

COMPARISON = "comparison.html"


def write_comparison(
    findings: Findings,
    data: MeasuredData,
    model: SensorModel,
    folder: Path,
    points: Sequence[PointReadings] | None = None,
) -> Path:
    """Write `COMPARISON` and its pictures, and return its path; `points` are as for `write_report`.

    Raises
    ------
    ConfigError
        The folder cannot be made or written to.
    """
    pictures = pictures_of(entries(PictureData(findings, data, model, REPORT, points)))
    tables = [comparison_table(findings), table_5_1(findings)]
    return write_page(folder, f"{__package__}/{COMPARISON}", pictures, tables, COMPARISON, findings=findings)
