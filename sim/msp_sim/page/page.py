"""One self-contained HTML page from a template: pictures are inside it, and nothing is asked of a network.

Pictures, omissions and tables enter, HTML leaves. A report has a template of its own that extends ``page.html`` of
this package, which holds the head, the looks and the macros for what is on a page (``parts.html``).
"""

import base64
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from msp_range.yaml_file import ConfigError

PAGE = "report.html"


@dataclass(frozen=True)
class Picture:
    """A picture with the words that it needs.

    Parameters
    ----------
    name
        Of its file, without the ending; also its anchor in the page.
    title
        What it shows, a few words.
    caption
        How to read it, and the numbers that it shows.
    alternative
        What it shows, in a sentence, for who cannot see it.
    png
        The picture.
    """

    name: str
    title: str
    caption: str
    alternative: str
    png: bytes

    @cached_property
    def source(self) -> str:
        """The picture as the address of an image that needs no file."""
        return "data:image/png;base64," + base64.b64encode(self.png).decode("ascii")


@dataclass(frozen=True)
class Omitted:
    """A picture that the data do not allow, and why."""

    name: str
    title: str
    why: str


@dataclass(frozen=True)
class PageTable:
    """Rows of cells under a header; a cell that is a number is set to the right.

    Parameters
    ----------
    name
        Its anchor in the page.
    title, caption
        What it shows, and what has to be said about it.
    header
        A word or two for each column, with units.
    rows
        Cells, as many a row as the header has.
    words
        How many columns from the left hold words; the others hold numbers.
    """

    name: str
    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: int = 1


def render(package: str, template: str, **values: Any) -> str:
    """A page from a template in the folder ``templates`` of a package.

    Parameters
    ----------
    package
        Whose template it is, such as ``msp_lab.characterise.report``.
    template
        Its file name. It may extend ``page.html`` and import ``parts.html``.
    values
        What the template names. A name that is missing is an error, not a blank.

    Returns
    -------
    str
        HTML; what is not marked safe in the template is escaped.
    """
    environment = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader("msp_sim.page")]),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(**values)


def write_page(folder: Path, html: str, pictures: Iterable[Picture | Omitted]) -> Path:
    """Write a page as `PAGE`, and a PNG a picture beside it; the page needs none of them.

    Parameters
    ----------
    folder
        It is made if it is not there; files of these names are replaced.
    html
        The page.
    pictures
        On it; of what was left out there is no file.

    Returns
    -------
    Path
        Of the page.

    Raises
    ------
    ConfigError
        The folder cannot be made or written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        for each in pictures:
            if isinstance(each, Picture):
                (folder / f"{each.name}.png").write_bytes(each.png)
        (folder / PAGE).write_text(html, encoding="utf-8")
    except OSError as error:
        raise ConfigError(f"{folder}: the report cannot be written: {error.strerror}") from None
    return folder / PAGE
