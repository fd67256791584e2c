"""The page and the pictures of a characterisation, on disk."""

from itertools import chain
from pathlib import Path
from typing import Any

from msp_lab.characterise.page import air, field_of_view, longest_range, mixture, questions, range_error
from msp_lab.characterise.page.answers import conclusions_table, summarise
from msp_lab.characterise.page.picture_data import PictureData
from msp_lab.characterise.page.tables import TABLES
from msp_sim.page.page import pictures_of, write_page

SECTIONS: tuple[tuple[str, str, tuple[Any, ...]], ...] = (
    ("does-it-matter", "Does it matter?", (questions,)),
    ("errors", "Range errors", (range_error, longest_range)),
    ("beam", "Field of view", (field_of_view,)),
    ("air", "Air temperature", (air,)),
    ("mixture-fit", "Kinds of readings", (mixture,)),
)
"""Anchor and title of each section, and the modules with its pictures."""


def write_report(rows: PictureData, folder: Path) -> Path:
    """Draw what the data allow, write the page with a PNG and a CSV file for each picture and table, and return it.

    The page needs none of the other files; files of these names are replaced. ConfigError if the folder cannot be made
    or written to.
    """
    sections = []
    for anchor, title, parts in SECTIONS:
        drawn = pictures_of(chain.from_iterable(part.entries(rows) for part in parts))
        if pictures := [picture for picture in drawn if picture.files]:
            sections.append((anchor, title, pictures))
    return write_page(
        folder,
        f"{__package__}/report.html",
        [picture for *_, pictures in sections for picture in pictures],
        [table(rows.findings) for table in (conclusions_table, *TABLES)],
        findings=rows.findings,
        model=rows.model,
        answer=summarise(rows.findings),
        sections=sections,
    )
