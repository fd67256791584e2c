"""The page and `msp-range status` as users see them: the real service on an emulated bus, Debian's Chromium."""

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from mcap.reader import make_reader
from playwright.sync_api import Page, sync_playwright
from prometheus_client.parser import text_string_to_metric_families

from msp_sim.device.device import Fault
from tests.support.kernel_bus import KernelTestbed, Sonar, Transfer, kernel_bus
from tests.support.service import COMMAND, Autopilot, LinkEnd, Service, missing, running_service, sonars
from tests.support.slow import slow
from tests.support.transports import free_port, until

STEADY = sonars(forward_cm=[120], slanted_cm=[765], down_cm=[300])
DEAD_WITHIN_S = 2.0
"""A sensor that dies is seen dead so soon [s]; the bridge itself needs three turns of 0.4 s to decide."""


class Watched:
    """A service with a page, and the far end of its link."""

    def __init__(self, service: Service, end: LinkEnd, url: str, feed: Path) -> None:
        self.service, self.end, self.url, self.feed = service, end, url, feed

    def until(self, done: Callable[[], bool], limit_s: float = 20.0) -> None:
        """Let the link work until something is so."""
        self.end.run_until(done, limit_s)

    def get(self, path: str, **headers: str) -> str:
        """The answer of the page's server."""
        with urlopen(Request(self.url + path, headers=headers), timeout=5.0) as answer:
            text: str = answer.read().decode()
        return text

    def is_served(self) -> bool:
        try:
            return bool(self.get("metrics"))
        except OSError:
            return False


@contextmanager
def watched(testbed: KernelTestbed, folder: Path, *options: str) -> Iterator[Watched]:
    port = free_port(socket.SOCK_STREAM)
    feed = Path(os.environ["XDG_RUNTIME_DIR"]) / "watched" / "status.sock"
    with LinkEnd(autopilot=Autopilot()) as end:
        arguments = ["--web", str(port), "--socket", str(feed), *options]
        with running_service(testbed, end.url, folder, *arguments) as service:
            made = Watched(service, end, f"http://127.0.0.1:{port}/", feed)
            made.until(made.is_served)
            yield made


@pytest.fixture(scope="module")
def steady(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Watched]:
    """One service for all that only look."""
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path_factory.mktemp("steady")) as bridge:
        yield bridge


@contextmanager
def browser(url: str, **options: Any) -> Iterator[tuple[Page, list[str]]]:
    """A page in Chromium, and the errors of its script."""
    program = shutil.which("chromium")
    if program is None:
        missing("Chromium is not installed: apt install chromium")
    errors: list[str] = []
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        page = chromium.new_context(**options).new_page()
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(url)
        yield page, errors
        chromium.close()


def page_command(listen: str, feed: Path) -> list[str]:
    """A page's process without a bridge's help."""
    return [str(COMMAND.with_name("python")), "-m", "msp_range.web", listen, "--socket", str(feed)]


def refusal(url: str, **headers: str) -> int:
    """The HTTP status with which a request is refused."""
    with pytest.raises(HTTPError) as refused:
        urlopen(Request(url, headers=headers), timeout=5.0)
    with refused.value:
        return refused.value.code


def text(page: Page, selector: str) -> str:
    return page.inner_text(selector)


def test_the_page_shows_what_changes(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path, "--record", str(recordings)) as bridge:
        with browser(bridge.url) as (page, errors):
            bridge.until(lambda: text(page, "#distance").startswith("2.9"))  # 3 m in air of 20 C
            assert text(page, "#state") == "active"
            assert "system 1, disarmed" in text(page, "#facts")
            assert ".mcap" in text(page, "#facts")
            strips = page.locator(".strip")
            assert [strips.nth(i).get_attribute("data-strip") for i in range(strips.count())] == [
                "distance down",
                "forward",
                "slanted",
                "down_left",
                "down_right",
            ]
            assert "no echo" in text(page, "[data-strip=slanted]")
            before = page.locator("#side [data-sensor=down_left]").get_attribute("points")
            canvas = "document.querySelector('[data-strip=down_left] canvas').toDataURL()"
            picture = page.evaluate(canvas)

            testbed.set_readings([120, 765, 150, 150])
            bridge.until(lambda: text(page, "#distance").startswith("1.4"))
            assert page.locator("#side [data-sensor=down_left]").get_attribute("points") != before
            assert page.evaluate(canvas) != picture

            page.fill("#mark", "over the box")
            page.keyboard.press("Enter")
            bridge.until(lambda: "over the box" in text(page, "#texts"))
            assert errors == []
        assert bridge.service.stop() == 0
    (file,) = recordings.iterdir()
    with file.open("rb") as stream:
        marks = [json.loads(message.data) for _, _, message in make_reader(stream).iter_messages(["/mark"])]
    assert marks == [{"text": "over the box"}]


@pytest.mark.slow
def test_a_dead_sensor_is_seen_dead(tmp_path: Path) -> None:
    dies_s = 4.0
    dying = [*STEADY[:3], Sonar(0x73, [300], [Fault("silent", dies_s, 1000.0)])]
    with kernel_bus(dying) as testbed, watched(testbed, tmp_path) as bridge, browser(bridge.url) as (page, errors):
        strip = "[data-strip=down_right]"
        bridge.until(lambda: page.locator(strip).count() == 1)
        assert "no answer" not in text(page, strip)
        bridge.until(lambda: bool(failed_pings(testbed, 0x73)))
        bridge.until(lambda: "no answer" in text(page, strip))
        first_s = time.monotonic()
        failed_s = failed_pings(testbed, 0x73)[0].time_s
        assert errors == []
    assert first_s - failed_s < DEAD_WITHIN_S


@pytest.mark.slow
def test_the_page_finds_the_bridge_again(tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        # A page of its own, so that it outlives the bridge.
        port = free_port(socket.SOCK_STREAM)
        with subprocess.Popen(page_command(str(port), bridge.feed), stderr=subprocess.DEVNULL) as server:
            alone = Watched(bridge.service, bridge.end, f"http://127.0.0.1:{port}/", bridge.feed)
            bridge.until(alone.is_served)
            with browser(alone.url) as (page, errors):
                bridge.until(lambda: text(page, "#state") == "active")
                bridge.service.process.kill()
                bridge.until(lambda: text(page, "#state") == "the bridge does not run")
                with running_service(testbed, bridge.end.url, tmp_path, "--socket", str(bridge.feed)):
                    bridge.until(lambda: text(page, "#state") == "active")
                assert errors == []
            server.send_signal(signal.SIGTERM)
            assert server.wait(10.0) == 0


@pytest.mark.slow
def test_a_browser_that_stalls_delays_no_reading(tmp_path: Path) -> None:
    """A stopped page's process stands for anything that does not read any more."""
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        (page,) = children(bridge.service.process.pid)
        os.kill(page, signal.SIGSTOP)
        before = len(bridge.end.distances)
        bridge.end.run_for(5.0)
        arrived = [each.time_s for each in bridge.end.arrived if each.distance is not None][before:]
        os.kill(page, signal.SIGCONT)
        bridge.until(bridge.is_served)
        assert len(arrived) > 5.0 * 10.0 * 0.7  # all of them on an idle computer
        assert max(late - early for early, late in pairwise(arrived)) < 1.0


@pytest.mark.slow
def test_a_page_that_is_killed_is_started_again_and_ends_with_the_bridge(tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        (page,) = children(bridge.service.process.pid)
        os.kill(page, signal.SIGKILL)
        bridge.until(lambda: not bridge.is_served())
        bridge.until(bridge.is_served)
        assert any(each["event"] == "web page ended" for each in bridge.service.log())
        bridge.service.process.kill()
        bridge.service.process.wait()
        until(lambda: not bridge.is_served())


def test_who_may_not_see_the_page(steady: Watched) -> None:
    for headers in ({"Host": "evil.example"}, {"Origin": "http://evil.example"}):
        assert refusal(steady.url, **headers) == 403
    assert refusal(steady.url + "airframe.yaml") == 404
    assert "<!doctype html>" in steady.get("", Origin=steady.url.rstrip("/"))


def test_a_page_for_other_computers_needs_the_token(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", str(tmp_path))
    port = free_port(socket.SOCK_STREAM)
    command = page_command(f"0.0.0.0:{port}", tmp_path / "none")
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as server:
        assert server.stderr is not None
        line = server.stderr.readline()
        token = (tmp_path / "web-token").read_text()
        assert line.rstrip().endswith(f"url=http://0.0.0.0:{port}/?token={token}")
        assert (tmp_path / "web-token").stat().st_mode & 0o777 == 0o600
        for query in ("", "?token=", "?token=wrong"):
            for path in ("", "live", "metrics", "page.html"):
                assert refusal(f"http://127.0.0.1:{port}/{path}{query}") == 401
        with browser(f"http://127.0.0.1:{port}/?token={token}") as (page, errors):
            until(lambda: page.is_enabled("#add-mark"))  # it is connected
            assert errors == []
        server.send_signal(signal.SIGTERM)
        assert server.wait(10.0) == 0


def test_metrics_are_read_by_prometheus_own_parser(steady: Watched) -> None:
    steady.until(lambda: "msp_range_distance_m " in steady.get("metrics"))
    families = {each.name: each for each in text_string_to_metric_families(steady.get("metrics"))}
    readings = {each.labels["sensor"]: each.value for each in families["msp_range_readings"].samples}
    assert set(readings) == {"forward", "slanted", "down_left", "down_right"}
    assert all(readings.values())
    assert families["msp_range_distance_m"].samples[0].value == pytest.approx(2.99, abs=0.05)
    assert families["msp_range_autopilot_present"].samples[0].value == 1.0


def test_a_terminal_shows_the_same(steady: Watched) -> None:
    steady.until(lambda: len(steady.end.distances) > 8)
    shown = status(steady.feed)
    assert shown.returncode == 0
    assert max(map(len, shown.stdout.splitlines())) <= 80
    assert "distance down 2.9" in shown.stdout
    assert "autopilot: " in shown.stdout
    assert all(name in shown.stdout for name in ("forward", "slanted", "down_left", "down_right"))
    found = json.loads(status(steady.feed, "--json").stdout)
    assert found["readings"]["down_left"]["raw"] == 300
    assert found["status"]["link"]["sent"]["DISTANCE_SENSOR"] > 0


def test_where_no_bridge_runs_a_terminal_says_so(tmp_path: Path) -> None:
    gone = status(tmp_path / "status.sock")
    assert gone.returncode == 1
    assert gone.stderr.startswith("no bridge runs: nobody listens at ")


def status(feed: Path, *options: str) -> "subprocess.CompletedProcess[str]":
    """What `msp-range status` prints."""
    command = [str(COMMAND), "status", "--socket", str(feed), *options]
    return subprocess.run(command, capture_output=True, text=True, timeout=20.0)


@pytest.mark.parametrize("wrong", ["host", *slow("0", "80808", "1.2.3.4:", "::1:http")])
def test_a_wrong_address_is_refused_before_the_flight(wrong: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [COMMAND, "run", tmp_path / "none.yaml", "--web", wrong], capture_output=True, text=True, timeout=20.0
    )
    assert done.returncode == 3
    assert done.stderr.startswith(f"--web {wrong}: expected [HOST:]PORT")


def failed_pings(testbed: KernelTestbed, address: int) -> list[Transfer]:
    """Pings that a sensor did not acknowledge."""
    return [each for each in testbed.journal() if (each.address, each.verb) == (address, "write") and each.errno]


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    found = []
    for each in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [int(number) for number in each.read_text().split()]
    return found
