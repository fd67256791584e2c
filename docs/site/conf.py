"""Settings of Sphinx for the site of the documents; `docs/site/build.py` runs it."""

import re
from pathlib import Path
from typing import Any

from docutils.nodes import SkipNode
from docutils.utils.math.latex2mathml import tex2mathml

from msp_range import __version__

project = "msp-range"
version = release = __version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
# A function stands under its package's title, from which it is imported, and not by the file that it is in.
add_module_names = False
root_doc = "index"
html_theme = "furo"
html_title = f"msp-range {__version__}"
html_copy_source = html_show_sourcelink = html_show_copyright = html_show_sphinx = False
# The summaries under the results are fetched with the pages, which browsers refuse for file://.
html_show_search_summary = False
html_math_renderer = "mathml"
highlight_language = "text"
myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
# A link to a folder or a file of the repository becomes a download; the numbers of ordered lists may be any.
suppress_warnings = ["myst.header"]

GENERATED = "<!-- generated reference -->"
"""Where docs/index.md gets the list of the pages that are made from the code."""
_LINK = re.compile(r"^- \[[^]]+\]\(([^)]+)\.md\)", re.M)


def contents(app: Any, page: str, source: list[str]) -> None:
    """Make the site's contents from the lists of links in docs/index.md, a part of each of its sections."""
    source[0] = source[0].replace("](../README.md", "](readme.md")
    if page != root_doc:
        return
    reference = sorted((Path(app.srcdir) / "reference").glob("*.md"))
    lines = [f"- [{each.read_text(encoding='utf-8').splitlines()[0][2:]}](reference/{each.name})" for each in reference]
    text = source[0].replace(GENERATED, "\n".join(lines))
    head, *sections = re.split(r"^## ", text, flags=re.M)
    parts = [head, "```{toctree}\n:hidden:\n\nreadme\n```\n\n"]
    for section in sections:
        title = section.splitlines()[0]
        pages = "\n".join(_LINK.findall(section))
        parts.append(f"## {section}\n```{{toctree}}\n:hidden:\n:caption: {title}\n\n{pages}\n```\n\n")
    source[0] = "".join(parts)


def visit_math(writer: Any, node: Any) -> None:
    """A formula in a line of text, as MathML: every browser draws it, without a script from the network."""
    writer.body.append(tex2mathml(node.astext()))
    raise SkipNode


def visit_math_block(writer: Any, node: Any) -> None:
    """A formula on a line of its own."""
    writer.body.append(f'<div class="math">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise SkipNode


def setup(app: Any) -> None:
    """What Sphinx calls."""
    app.connect("source-read", contents)
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_math_block, None))
