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
from msp_sim.page.page import pictures_of, write_page

COMPARISON = "comparison.html"


def write_comparison(findings: Findings, points: Sequence[PointReadings], model: SensorModel, folder: Path) -> Path:
    """Write `COMPARISON` and its pictures, and return its path; `points` are the readings, sorted.

    Raises
    ------
    ConfigError
        The folder cannot be made or written to.
    """
    pictures = pictures_of(entries(PictureData(findings, points, model, REPORT)))
    tables = [comparison_table(findings), table_5_1(findings)]
    return write_page(folder, f"{__package__}/{COMPARISON}", pictures, tables, COMPARISON, findings=findings)
