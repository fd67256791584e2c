"""Make one self-contained HTML page from a template, with the pictures inside, so that it works offline.

Pictures, notes on omitted pictures, and tables enter, HTML leaves. Each report has its own template, which extends this
package's ``page.html`` (head and style) and uses the macros of ``parts.html``.
"""

import base64
import csv
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from msp_range.yaml_file import ConfigError

PAGE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A picture with its title, caption and alternative text."""

    name: str
    """Name of its file without the suffix; also its anchor in the page."""
    title: str
    """What it shows, a few words."""
    caption: str
    """How to read it, and the numbers that it shows."""
    alternative: str
    """What it shows, in a sentence, for readers who cannot see it."""
    files: Mapping[str, bytes]
    """The picture by format: ``png``, and others that were chosen."""

    @cached_property
    def source(self) -> str:
        """The picture as a data URL."""
        return "data:image/png;base64," + base64.b64encode(self.files["png"]).decode("ascii")


@dataclass(frozen=True)
class Omitted:
    """A picture that cannot be drawn from these data, and the reason."""

    name: str
    title: str
    why: str


@dataclass(frozen=True)
class PageTable:
    """A table of text cells under a header; columns of numbers are aligned to the right."""

    name: str
    """Its anchor in the page."""
    title: str
    header: tuple[str, ...]
    """A word or two for each column, with units."""
    rows: tuple[tuple[str, ...], ...]
    """Rows of cells, each as long as the header."""
    caption: str = ""
    """Title, and a remark below the table."""
    words: int = 1
    """Number of columns from the left with words; the others have numbers."""


def render(package: str, template: str, **values: Any) -> str:
    """Make a page from a template in the folder ``templates`` of a package.

    Parameters
    ----------
    package
        Package with the template, such as ``msp_lab.characterise.page``.
    template
        Its file name. It may extend ``page.html`` and import ``parts.html``.
    values
        Values of the names in the template; a missing one is an error.

    Returns
    -------
    str
        HTML; everything not marked safe in the template is escaped.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("msp_sim.page")]),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def write_page(
    folder: Path,
    html: str,
    pictures: Iterable[Picture | Omitted],
    name: str = PAGE,
    tables: Iterable[PageTable | None] = (),
) -> Path:
    """Write a page, and next to it each picture as PNG and each table as CSV; the page works without these files.

    Parameters
    ----------
    folder
        Created if absent; files of the same names are replaced.
    html
        Content of the page.
    pictures
        Pictures on the page; omitted ones get no file.
    name
        Name of the page's file.
    tables
        Tables on the page; None: one that these data do not give.

    Returns
    -------
    Path
        Path of the page.

    Raises
    ------
    ConfigError
        The folder cannot be created or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for each in pictures:
            if isinstance(each, Picture):
                for suffix, content in each.files.items():
                    (folder / f"{each.name}.{suffix}").write_bytes(content)
        for table in tables:
            if table is not None:
                with (folder / f"{table.name.replace('/', '_')}.csv").open("w", encoding="utf-8", newline="") as file:
                    csv.writer(file).writerows([table.header, *table.rows])
        (folder / name).write_text(html, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: the report cannot be written: {error.strerror}") from None
    return folder / name
