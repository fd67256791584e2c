"""The site of the documents as readers see it: built by its command, in Debian's Chromium, without a network."""

import subprocess
import sys
from pathlib import Path

import pytest

import msp_lab
import msp_range
import msp_sim
from tests.peers.test_page import browser
from tests.support.shipped import ROOT

DOCS = ROOT / "docs"


def build(out: Path, docs: Path = DOCS) -> "subprocess.CompletedProcess[str]":
    command = [sys.executable, str(ROOT / "docs/site/build.py"), str(out), str(docs)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300.0)


@pytest.mark.slow
def test_the_site_is_whole_and_its_search_needs_no_network(tmp_path: Path) -> None:
    done = build(tmp_path)
    assert done.returncode == 0, done.stderr
    html = tmp_path / "html"
    page = (html / "reference/cli-msp-range.html").read_text(encoding="utf-8")
    assert "msp-range commission" in page
    assert "--no-record" in page
    python = (html / "reference/python.html").read_text(encoding="utf-8")
    assert all(f">{name}</span>" in python for name in [*msp_range.__all__, *msp_sim.__all__, *msp_lab.__all__])
    assert "the extended model.yaml" in python
    with browser((html / "search.html").as_uri() + "?q=breakaway") as (shown, errors):
        shown.context.set_offline(True)
        hit = shown.locator("#search-results li a", has_text="Sensor model file").first
        hit.click()
        shown.wait_for_url("**/reference/file-sensor.html*")
        shown.get_by_text("half_angle_deg").first.wait_for()
        assert errors == []
    for each in html.rglob("*.html"):
        text = each.read_text(encoding="utf-8")
        assert '<script src="http' not in text
        assert '<link rel="stylesheet" type="text/css" href="http' not in text


@pytest.mark.slow
def test_broken_links_and_an_unlisted_page_fail(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    docs.mkdir()
    broken = ("nowhere.md", "filters.md#no-such-section", "../configs/none.yaml")
    (docs / "filters.md").write_text("# Filters\n\n" + "\n".join(f"[x]({each})" for each in broken), encoding="utf-8")
    (docs / "index.md").write_text("# Index\n\n## Pages\n\n- [Filters](filters.md)\n", encoding="utf-8")
    (docs / "unlisted.md").write_text("# New\n", encoding="utf-8")
    done = build(tmp_path / "out", docs)
    assert done.returncode != 0
    for each in ("nowhere", "no-such-section", "configs/none.yaml", "unlisted.md"):
        assert each in done.stderr
