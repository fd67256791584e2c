"""The page and `msp-range status` as users see them: the real service on an emulated bus, Debian's Chromium."""

import json
import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import pytest
from mcap.reader import make_reader
from playwright.sync_api import Page, expect, sync_playwright
from prometheus_client.parser import text_string_to_metric_families

from msp_range.recording.reader import Recording
from tests.support.kernel_bus import KernelTestbed, kernel_bus
from tests.support.service import AIRFRAME, COMMAND, Autopilot, LinkEnd, Service, missing, running_service, sonars
from tests.support.slow import slow
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S, until

STEADY = sonars(forward_cm=[120], slanted_cm=[765], down_cm=[300])
BROWSER_STARTS_S = 120.0
"""At most, and loads a page [s]: it takes 2 s on an idle computer, and many times that with nothing in its caches."""
DEAD_AFTER = 3
"""Failed turns of a sensor, of 0.4 s each, after which the bridge calls it dead."""


class Watched:
    """A service with a page, and the far end of its link."""

    def __init__(self, service: Service, end: LinkEnd, url: str, feed: Path) -> None:
        self.service, self.end, self.url, self.feed = service, end, url, feed

    def until(self, holds: Callable[[], bool]) -> None:
        """Let the link work until something is so."""
        self.end.run_until(holds)

    def until_passes(self, check: Callable[[], object]) -> None:
        """Let the link work until all that a function asserts holds."""
        self.end.run_until_passes(check)

    def get(self, path: str, **headers: str) -> str:
        """The answer of the page's server."""
        with urlopen(Request(self.url + path, headers=headers), timeout=LIMIT_S) as answer:
            text: str = answer.read().decode()
        return text

    def status(self, *options: str) -> "subprocess.CompletedProcess[str]":
        """What `msp-range status` prints, while the link works on."""
        with ThreadPoolExecutor(1) as pool:
            run = partial(subprocess.run, capture_output=True, text=True, timeout=LIMIT_S)
            done = pool.submit(run, status_command(self.feed, *options))
            self.until(done.done)
            return done.result()

    def is_served(self) -> bool:
        try:
            return bool(self.get("metrics"))
        except OSError:
            return False


@contextmanager
def watched(testbed: KernelTestbed, folder: Path, *options: str, airframe: Path = AIRFRAME) -> Iterator[Watched]:
    port = free_port(socket.SOCK_STREAM)
    feed = Path(os.environ["XDG_RUNTIME_DIR"]) / "watched" / "status.sock"
    with LinkEnd(autopilot=Autopilot()) as end:
        arguments = ["--web", str(port), "--socket", str(feed), *options]
        with running_service(testbed, end.url, folder, *arguments, airframe=airframe) as service:
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
        chromium = playwright.chromium.launch(
            executable_path=program, args=["--no-sandbox"], timeout=1e3 * BROWSER_STARTS_S
        )
        page = chromium.new_context(**options).new_page()
        page.set_default_timeout(1e3 * BROWSER_STARTS_S)
        expect.set_options(timeout=1e3 * LIMIT_S)
        page.on("pageerror", lambda error: errors.append(str(error)))
        page.goto(url)
        yield page, errors
        chromium.close()


@contextmanager
def page_alone(listen: str, feed: Path, stderr: int, *options: str) -> Iterator[subprocess.Popen[str]]:
    """A page's process without a bridge's help, which ends with the block also where a check in it fails."""
    command = [str(COMMAND.with_name("python")), "-m", "msp_range.web", listen, "--socket", str(feed), *options]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=stderr, text=True) as server:
        try:
            yield server
        finally:
            server.kill()


def refusal(url: str, **headers: str) -> int:
    """The HTTP status with which a request is refused."""
    with pytest.raises(HTTPError) as refused:
        urlopen(Request(url, headers=headers), timeout=LIMIT_S)
    with refused.value:
        return refused.value.code


def text(page: Page, selector: str) -> str:
    """The text of an element; nothing where it is not there yet."""
    return " ".join(page.locator(selector).all_inner_texts())


def test_the_page_shows_what_changes(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path, "--record", str(recordings)) as bridge:
        with browser(bridge.url) as (page, errors):
            names = "[...document.querySelectorAll('.strip')].map(each => each.dataset.strip)"
            points = "document.querySelector('#side [data-sensor=down_left]')?.getAttribute('points')"
            canvas = "document.querySelector('[data-strip=down_left] canvas')?.toDataURL()"

            def shows_the_start() -> None:
                assert text(page, "#distance").startswith("2.9")  # 3 m in air of 20 C
                assert text(page, "#state") == "active"
                assert "system 1, disarmed" in text(page, "#facts")
                assert ".mcap" in text(page, "#facts")
                assert page.evaluate(names) == ["distance down", "forward", "slanted", "down_left", "down_right"]
                assert "no echo" in text(page, "[data-strip=slanted]")
                assert page.evaluate(points)
                assert page.evaluate(canvas)

            bridge.until_passes(shows_the_start)
            before, picture = page.evaluate(points), page.evaluate(canvas)
            testbed.set_readings([120, 765, 150, 150])

            def shows_the_change() -> None:
                assert text(page, "#distance").startswith("1.4")
                assert page.evaluate(points) != before
                assert page.evaluate(canvas) != picture

            bridge.until_passes(shows_the_change)

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
def test_distances_that_nobody_gets_are_not_shown_as_good(tmp_path: Path) -> None:
    """The reason is on a phone's first screen, at the top of the terminal, in its exit code and in the metrics."""
    reason, waits_ms = "Range: no autopilot, nobody gets the distances", 1e3 * LIMIT_S
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        bridge.end.autopilot = None
        with browser(bridge.url, viewport={"width": 390, "height": 844}) as (page, errors):
            expect(page.locator("#distance")).to_have_text("2.99 m", timeout=waits_ms)
            expect(page.locator("#state")).to_have_attribute("data-state", "critical", timeout=waits_ms)
            expect(page.locator("#faults li").first).to_contain_text(reason)
            place = page.locator("#faults li").first.bounding_box()
            assert place is not None
            assert place["y"] + place["height"] < 844
            expect(page.locator("#facts")).to_contain_text("nobody gets them")
            shown = bridge.status("--once")
            assert shown.returncode == 4
            assert [line.strip() for line in shown.stdout.splitlines()[:2]] == ["peers: critical", f"error: {reason}"]
            assert "msp_range_critical 1.0" in bridge.get("metrics")
            bridge.end.autopilot = Autopilot()
            bridge.until(lambda: page.locator("#state").get_attribute("data-state") == "active")
            bridge.until(lambda: reason not in text(page, "#faults"))
            assert errors == []


@pytest.mark.slow
def test_that_nothing_is_sent_is_plain_and_neither_good_nor_bad(tmp_path: Path) -> None:
    path = tmp_path / "nothing.yaml"
    text_of_file = AIRFRAME.read_text(encoding="utf-8").replace("../../configs/sensors/mb1242.yaml", "mb1242")
    path.write_text(text_of_file.replace("send:\n", "send:\n  nothing: true\n"), encoding="utf-8")
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path, airframe=path) as bridge:
        with browser(bridge.url) as (page, errors):

            def shows_it() -> None:
                assert text(page, "#state") == "sends nothing"
                assert text(page, "#distance").startswith("2.9")
                assert text(page, "#distance-more").startswith("not sent; deviation")
                assert "no distances, 0 frames dropped" in text(page, "#facts")
                assert "no distances are sent (send: nothing)" in text(page, "#verdict")

            bridge.until_passes(shows_it)
            colour = "getComputedStyle(document.querySelector('#state')).backgroundColor"
            neutral = "getComputedStyle(document.querySelector('body')).color"
            assert page.evaluate(colour) == page.evaluate(neutral)
            assert bridge.status("--once").returncode == 4
            assert "msp_range_critical 0.0" in bridge.get("metrics")
            assert errors == []
        assert not bridge.end.of("DISTANCE_SENSOR")
        assert bridge.end.of("HEARTBEAT")


@pytest.mark.slow
def test_a_dead_sensor_is_seen_dead(tmp_path: Path) -> None:
    recordings = tmp_path / "recordings"
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path, "--record", str(recordings)) as bridge:
        with browser(bridge.url) as (page, errors):
            strip = "[data-strip=down_right]"
            bridge.until(lambda: "m" in text(page, strip))
            assert "no answer" not in text(page, strip)
            testbed.silence(0x73)
            bridge.until(lambda: "no answer" in text(page, strip))
            bridge.until(lambda: any("down_right: no answer" in each.text for each in bridge.end.of("STATUSTEXT")))
            assert errors == []
        assert bridge.service.stop() == 0
    (file,) = recordings.iterdir()
    # In the bridge's own turns, which a busy computer draws out.
    topics = [each for each in Recording(file) if each.topic in ("/range/down_right", "/health")]
    (reported,) = [i for i, each in enumerate(topics) if "down_right: no answer" in each.message.get("text", "")]
    statuses = [each.message["status"] for each in topics[:reported] if each.topic == "/range/down_right"]
    assert statuses[-DEAD_AFTER - 1] == "ok"
    assert "ok" not in statuses[-DEAD_AFTER:]


@pytest.mark.slow
def test_the_page_finds_the_bridge_again(tmp_path: Path) -> None:
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        # A page of its own, so that it outlives the bridge.
        port = free_port(socket.SOCK_STREAM)
        with page_alone(str(port), bridge.feed, subprocess.DEVNULL) as server:
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
            assert server.wait(LIMIT_S) == 0


def test_the_page_of_a_service_that_cannot_start_says_why(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As systemd knows it; the page needs neither the bridge nor a standard input."""
    systemctl = tmp_path / "systemctl"
    answer = "Id=msp-range.service\nActiveState=failed\nExecMainStatus=3\nStatusText=airframe.yaml:3: found colour"
    systemctl.write_text(f"#!/bin/sh\necho '{answer}'\n")
    systemctl.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    port = free_port(socket.SOCK_STREAM)
    with page_alone(str(port), tmp_path / "none", subprocess.PIPE, "--unit", "msp-range.service") as server:
        assert server.stderr is not None
        server.stderr.readline()
        with browser(f"http://127.0.0.1:{port}/") as (page, errors):
            expect(page.locator("#state")).to_have_text("the bridge does not run")
            expect(page.locator("#faults")).to_contain_text("No distances: airframe.yaml:3: found colour")
            expect(page.locator("#faults small")).to_contain_text("sudo systemctl restart msp-range.service")
            systemctl.write_text(f"#!/bin/sh\necho '{answer}' | sed s/failed/inactive/\n")
            expect(page.locator("#faults")).to_contain_text("No distances: msp-range.service is stopped")
            assert errors == []


@pytest.mark.slow
def test_a_browser_that_stalls_delays_no_reading(tmp_path: Path) -> None:
    """A stopped page's process stands for anything that does not read any more."""
    with kernel_bus(STEADY) as testbed, watched(testbed, tmp_path) as bridge:
        (page,) = children(bridge.service.process.pid)

        def fifty_take_s() -> float:
            begun_s, before = time.monotonic(), len(bridge.end.distances)
            bridge.until(lambda: len(bridge.end.distances) >= before + 50)
            return time.monotonic() - begun_s

        idle_s = fifty_take_s()
        os.kill(page, signal.SIGSTOP)
        stalled_s = fifty_take_s()
        os.kill(page, signal.SIGCONT)
        bridge.until(bridge.is_served)
    # A bridge that waited for it would send none of them; the computer may be busier than just before.
    assert stalled_s < idle_s + 10.0


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
    with page_alone(f"0.0.0.0:{port}", tmp_path / "none", subprocess.PIPE) as server:
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
        assert server.wait(LIMIT_S) == 0


def test_metrics_are_read_by_prometheus_own_parser(steady: Watched) -> None:
    def shows_all() -> None:
        families = {each.name: each for each in text_string_to_metric_families(steady.get("metrics"))}
        readings = {each.labels["sensor"]: each.value for each in families["msp_range_readings"].samples}
        assert set(readings) == {"forward", "slanted", "down_left", "down_right"}
        assert all(readings.values())
        assert [each.value for each in families["msp_range_distance_m"].samples] == pytest.approx([2.99], abs=0.05)
        assert families["msp_range_autopilot_present"].samples[0].value == 1.0

    steady.until_passes(shows_all)


def test_a_terminal_shows_the_same(steady: Watched) -> None:
    def shows_all() -> None:
        shown = steady.status()
        assert shown.returncode == 0
        assert max(map(len, shown.stdout.splitlines())) <= 80
        assert "distance down 2.9" in shown.stdout
        assert "autopilot: " in shown.stdout
        assert all(name in shown.stdout for name in ("forward", "slanted", "down_left", "down_right"))

    def has_all() -> None:
        found = json.loads(steady.status("--json").stdout)
        assert found["readings"]["down_left"]["raw"] == 300
        assert found["status"]["link"]["sent"]["DISTANCE_SENSOR"] > 0

    steady.until_passes(shows_all)
    steady.until_passes(has_all)


def test_where_no_bridge_runs_a_terminal_says_so(tmp_path: Path) -> None:
    gone = subprocess.run(status_command(tmp_path / "status.sock"), capture_output=True, text=True, timeout=LIMIT_S)
    assert gone.returncode == 1
    assert gone.stderr.startswith("no bridge runs: nobody listens at ")


def status_command(feed: Path, *options: str) -> list[str]:
    """What shows a bridge in a terminal."""
    return [str(COMMAND), "status", "--socket", str(feed), *options]


@pytest.mark.parametrize("wrong", ["host", *slow("0", "80808", "1.2.3.4:", "::1:http")])
def test_a_wrong_address_is_refused_before_the_flight(wrong: str, tmp_path: Path) -> None:
    done = subprocess.run(
        [COMMAND, "run", tmp_path / "none.yaml", "--web", wrong], capture_output=True, text=True, timeout=LIMIT_S
    )
    assert done.returncode == 3
    assert done.stderr.startswith(f"--web {wrong}: expected [HOST:]PORT")


def children(pid: int) -> list[int]:
    """Processes that a process has started."""
    found = []
    for each in Path(f"/proc/{pid}/task").glob("*/children"):
        found += [int(number) for number in each.read_text().split()]
    return found
