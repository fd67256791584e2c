"""Write tables of figures into a document, between two comments that name their section."""

import re
from pathlib import Path

from evaluation import ROOT

FIGURES = ROOT / "docs" / "figures.md"


def replace_section(path: Path, section: str, text: str) -> None:
    """Replace what stands between ``<!-- begin SECTION -->`` and ``<!-- end SECTION -->`` in a file.

    Parameters
    ----------
    path
        A Markdown file that has both comments, each on a line of its own, once.
    section
        Name of the section.
    text
        Its new content, Markdown.

    Raises
    ------
    ValueError
        The file does not have the section exactly once.
    """
    content = text.strip("\n")
    begin, end = f"<!-- begin {section} -->\n", f"<!-- end {section} -->\n"
    old = path.read_text(encoding="utf-8")
    new, count = re.subn(
        f"{re.escape(begin)}.*?{re.escape(end)}", lambda _: f"{begin}\n{content}\n\n{end}", old, flags=re.S
    )
    if count != 1:
        raise ValueError(f"{path}: found section {section!r} {count} times; expected {begin.strip()} ... {end.strip()}")
    path.write_text(new, encoding="utf-8")
