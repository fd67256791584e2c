"""Draw pictures and put them into one self-contained HTML page that works offline.

Pictures, tables and values are made by functions that the caller gives, and written to files. Each report has its own
template, which extends this package's ``page.html`` (head and style) and uses the macros of ``parts.html``.
"""

import base64
import csv
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined
from matplotlib.figure import Figure

from msp_range.yaml_file import ConfigError
from msp_sim.page.style import files_of, style
from msp_sim.page.table import PageTable

PAGE = "report.html"


class Absent(Exception):
    """The data do not allow a picture; the message gives the reason and what is needed."""


Drawn = tuple[Figure, str]
"""A figure and its caption: how to read it, and the numbers that it shows."""

Entry = tuple[str, str, Callable[[], Drawn]]
"""Name of the file, title, and what draws the picture, or raises `Absent`."""


@dataclass(frozen=True)
class Picture:
    """A picture of a page, or the reason why there is none."""

    name: str
    """Name of its file without the suffix; also its anchor in the page."""
    title: str
    """What it shows, a few words; the lead of a page has none."""
    caption: str
    """How to read it, and the numbers that it shows; why it is absent where there are no files."""
    files: Mapping[str, bytes]
    """The picture by format: ``png``, and others that were chosen."""

    @property
    def source(self) -> str:
        """The picture as a data URL."""
        return "data:image/png;base64," + base64.b64encode(self.files["png"]).decode("ascii")


def pictures_of(entries: Iterable[Entry]) -> list[Picture]:
    """Draw each entry; one that the data do not allow has no files, and the reason as its caption."""
    made = []
    with style():
        for name, title, draw in entries:
            try:
                figure, caption = draw()
            except Absent as absent:
                made.append(Picture(name, title, str(absent), {}))
            else:
                made.append(Picture(name, title, caption, files_of(figure)))
    return made


def write_page(
    folder: Path,
    template: str,
    pictures: Sequence[Picture],
    tables: Sequence[PageTable] = (),
    page: str = PAGE,
    **values: Any,
) -> Path:
    """Write a page, and next to it each picture as a file and each table as CSV; the page works without these files.

    Parameters
    ----------
    folder
        Created if absent; files of the same names are replaced.
    template
        Package and file name, such as ``msp_lab.gap/gap.html``. It may extend ``page.html`` and import ``parts.html``.
    pictures
        Pictures on the page; absent ones get no file.
    tables
        Tables on the page; those without rows get no file.
    page
        Name of the page's file.
    values
        Values of the other names in the template, which also gets ``pictures`` and ``tables``, each by name; a missing
        one is an error. Values that the template does not mark as safe are escaped.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    ConfigError
        The folder cannot be created or written to.
    """
    package, _, file_name = template.partition("/")
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("msp_sim.page")]),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    pictures_by_name = {picture.name: picture for picture in pictures}
    tables_by_name = {table.name: table for table in tables}
    html = environment.get_template(file_name).render(pictures=pictures_by_name, tables=tables_by_name, **values)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for picture in pictures:
            for suffix, content in picture.files.items():
                (folder / f"{picture.name}.{suffix}").write_bytes(content)
        for table in tables:
            if table.rows:
                with (folder / f"{table.name.replace('/', '_')}.csv").open("w", encoding="utf-8", newline="") as file:
                    csv.writer(file).writerows([table.header, *table.rows])
        (folder / page).write_text(html, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: the report cannot be written: {error.strerror}") from None
    return folder / page
