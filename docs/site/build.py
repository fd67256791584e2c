"""Build the site of the documents: ``python docs/site/build.py [OUT [DOCS]]``, by default build/site; ``make docs``.

The documents are copied to OUT/tree/docs, next to links to the rest of the repository, so that their relative links are
those that GitHub shows; the README becomes a page among them. The reference is written there from the code
(`reference.py`), and Sphinx makes OUT/html of it. A broken link, a page that is in no list of docs/index.md, or any
other warning ends with exit code 1.
"""

import shutil
import sys
from pathlib import Path

from reference import pages
from sphinx.cmd.build import build_main

ROOT = Path(__file__).parents[2]
LINKED = ("configs", "msp_range", "sim", "tests", "evaluation", "systemd")
"""What documents link to outside docs/."""


def main(out: Path, docs: Path) -> int:
    """Build a folder of documents into another; Sphinx's exit code."""
    tree = out / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    shutil.copytree(docs, tree / "docs", ignore=shutil.ignore_patterns("site", "__pycache__", "*.py"))
    for name in LINKED:
        (tree / name).symlink_to(ROOT / name)
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    (tree / "docs/readme.md").write_text(readme.replace("](docs/", "]("), encoding="utf-8")
    reference = tree / "docs/reference"
    reference.mkdir()
    for name, text in pages().items():
        (reference / f"{name}.md").write_text(text, encoding="utf-8")
    settings = str(Path(__file__).parent)
    where = [str(tree / "docs"), str(out / "html")]
    return build_main(["-q", "-E", "-W", "--keep-going", "-c", settings, "-d", str(out / "doctrees"), *where])


if __name__ == "__main__":
    given = [Path(each).resolve() for each in sys.argv[1:]]
    target, documents = (*given, *(ROOT / "build/site", ROOT / "docs")[len(given) :])
    code = main(target, documents)
    if code == 0:
        print(f"{target}/html/index.html")
    sys.exit(code)
