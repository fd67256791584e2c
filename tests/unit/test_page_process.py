"""The web page's process as the bridge starts it."""

import io
import sys
from pathlib import Path

import pytest

from msp_range.log import Log
from msp_range.watch.page import RESTART_S, START_S, PageProcess


def test_a_page_that_cannot_be_started_is_logged_and_tried_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without memory or descriptors there is no page; the bridge goes on."""
    monkeypatch.setattr(sys, "executable", str(tmp_path / "python"))
    lines = io.StringIO()
    page = PageProcess("0", tmp_path / "status.sock", 0.0, Log("json", lines))
    for now_s in (0.0, START_S, START_S + 0.9 * RESTART_S, START_S + RESTART_S):
        page.service(now_s)
    page.close()
    assert lines.getvalue().count("web page not started") == 2
