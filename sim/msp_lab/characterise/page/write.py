"""The page and the pictures of a characterisation, on disk."""

from collections.abc import Sequence
from itertools import chain
from pathlib import Path
from typing import Any

from msp_lab.characterise.findings import Findings
from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, questions, range_error
from msp_lab.characterise.page.answers import conclusions_table, summarise
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.tables import (
    compensation_table,
    effects_table,
    mixture_table,
    points_table,
    sources_table,
)
from msp_lab.characterise.points import PointReadings
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.recording.csv_form import MeasuredData
from msp_sim.page.page import pictures_of, write_page

SECTIONS: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    ("does-it-matter", "Does it matter?", (questions,)),
    ("errors", "Range errors", (range_error, longest_range)),
    ("beam", "Field of view", (field_of_view,)),
    ("air", "Air temperature", (air,)),
    ("mixture-fit", "Kinds of readings", (mixture,)),
)
"""Anchor and title of each section, and the modules with its pictures."""


def write_report(
    findings: Findings,
    data: MeasuredData,
    model: SensorModel,
    directory: Path | str,
    points: Sequence[PointReadings] | None = None,
) -> Path:
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
    points
        The readings as the analyses sorted them; None: they are sorted here.

    Returns
    -------
    Path
        The page, which needs none of the other files.

    Raises
    ------
    ConfigError
        The directory cannot be made or written to.
    """
    rows = PictureData(findings, data, model, of_analysis=points)
    sections = []
    for anchor, title, parts in SECTIONS:
        drawn = pictures_of(chain.from_iterable(part.entries(rows) for part in parts))
        if pictures := [each for each in drawn if each.files]:
            sections.append((anchor, title, pictures))
    tables = (conclusions_table, effects_table, compensation_table, mixture_table, points_table, sources_table)
    return write_page(
        Path(directory),
        f"{__package__}/report.html",
        [picture for *_, pictures in sections for picture in pictures],
        [table(findings) for table in tables],
        findings=findings,
        model=model,
        answer=summarise(findings),
        sections=sections,
        rows_in_all=len(data),
    )
