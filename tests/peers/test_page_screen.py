"""The page on a phone: what is on its first screen, and what axe-core finds, with a bridge in virtual time."""

import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import combinations, count
from pathlib import Path
from typing import Any

import pytest
from axe_playwright_python.sync_playwright import Axe
from playwright.sync_api import Page, expect

from msp_range.config import Airframe, load_airframe
from msp_range.log import Log
from msp_range.watch.place import Outputs
from msp_range.watch.watch import Watch
from tests.peers.test_page import browser, page_alone, text
from tests.support.bench import START_S, Bench, airframe
from tests.support.shipped import CONFIGS
from tests.support.slow import slow
from tests.support.transports import free_port
from tests.support.waiting import until

PHONE = {"width": 390, "height": 844}
RULES = {"rules": {"color-contrast-enhanced": {"enabled": True}, "target-size": {"enabled": True}}}
"""axe-core's own, and those of WCAG that it leaves out: a contrast of 7:1, and the size of what is touched."""
COLOURS = ("ink", "soft", "used", "filtered", "rejected", "nothing", "good", "bad")
CONTRAST = """names => {
  const style = getComputedStyle(document.documentElement);
  const light = name => {
    const parts = style.getPropertyValue(`--${name}`).match(/[0-9a-f]{2}/g).map(each => parseInt(each, 16) / 255)
      .map(each => each <= 0.04045 ? each / 12.92 : ((each + 0.055) / 1.055) ** 2.4);
    return 0.2126 * parts[0] + 0.7152 * parts[1] + 0.0722 * parts[2] + 0.05;
  };
  return names.map(name => Math.min(...["card", "back"].map(
    on => Math.max(light(name), light(on)) / Math.min(light(name), light(on)))));
}"""
"""Least contrast of each colour on what it is drawn on, by WCAG 2: axe-core does not look into pictures."""
SMALLEST = """() => [...document.querySelectorAll("p, li, dd, small, #axis span, svg text")]
  .filter(each => each.checkVisibility() && [...each.childNodes].some(
    node => node.nodeType === Node.TEXT_NODE && /[0-9]/.test(node.data)))
  .map(each => [parseFloat(getComputedStyle(each).fontSize), each.textContent])"""
"""Size [px] of each text with a number."""
BOXES = "[...document.querySelectorAll('#above text')].map(each => [each.textContent, each.getBoundingClientRect()])"


class Shown:
    """A bench's bridge that the page shows.

    Parameters
    ----------
    bench
        Its bridge.
    watch
        What the page's process gets of it.
    page
        The browser's page.
    """

    def __init__(self, bench: Bench, watch: Watch, page: Page) -> None:
        self._bench, self.watch, self.page = bench, watch, page

    def fly(self, until_s: float, with_autopilot: bool = True) -> None:
        """Fly until that time since the start, not faster than the page shows it."""
        for time_s in count(self._bench.now() + 0.5, 0.5):
            self._bench.fly(time_s, with_autopilot=with_autopilot)
            self.watch.service(self._bench.clock.now())
            shown = "timeS => window.drawn.timeS >= timeS"
            self.page.wait_for_function(shown, arg=START_S + time_s - 0.3)
            if time_s >= until_s:
                return


@contextmanager
def shown(folder: Path, vehicle: Airframe, scheme: str = "light", **bench: Any) -> Iterator[Shown]:
    """The page of a bridge that has not flown yet, on a phone."""
    feed, port = folder / "feed" / "status.sock", free_port(socket.SOCK_STREAM)
    with page_alone(str(port), feed, subprocess.PIPE) as server:
        assert server.stderr is not None
        server.stderr.readline()
        with browser(f"http://127.0.0.1:{port}/", viewport=PHONE, color_scheme=scheme) as (page, errors):
            made = Bench(vehicle, **bench)
            watch = Watch(made.bridge, made.wire, Outputs(None, feed, None), made.clock.now(), Log("text"))
            until(lambda: text(page, "#vehicle") == vehicle.vehicle, work=lambda: watch.service(made.clock.now()))
            yield Shown(made, watch, page)
            watch.close()
            assert errors == []


def pallet(**changed: Any) -> Airframe:
    """The four sensors of the example, without a thermometer."""
    found = load_airframe(CONFIGS / "quad_pallet.yaml")
    return found.model_copy(update={"temperature": airframe().temperature, **changed})


def bottom(page: Page, selector: str) -> float:
    """Lower edge of an element on the page [px]."""
    box = page.locator(selector).bounding_box()
    assert box is not None, selector
    return box["y"] + box["height"]


def check_access(page: Page) -> None:
    """What axe-core finds; what is touched is high enough for gloves; nothing is wider than the screen."""
    touched = page.evaluate("[...document.querySelectorAll('button, input, summary')].map(each => each.offsetHeight)")
    assert [height for height in touched if 0 < height < 56] == []
    violations = Axe().run(page, options=RULES).response["violations"]
    assert [(each["id"], [node["html"] for node in each["nodes"]]) for each in violations] == []
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]


@pytest.mark.parametrize("scheme", ["light", *slow("dark")])
def test_a_healthy_flight_is_one_screen(scheme: str, tmp_path: Path) -> None:
    with shown(tmp_path, pallet(), scheme, reading_cm=300) as it:
        it.fly(7.0)
        page = it.page
        expect(page.locator("#state")).to_have_text("active")
        expect(page.locator("#distance")).to_have_text("3.00 m")
        expect(page.locator("#faults")).to_have_text("Distances go out, the autopilot is received.")
        assert bottom(page, "#axis") < PHONE["height"]
        assert "-0.0" not in text(page, "main")
        contrasts = dict(zip(COLOURS, page.evaluate(CONTRAST, COLOURS), strict=True))
        assert {name: each for name, each in contrasts.items() if each < 7.0} == {}
        assert [each for each in page.evaluate(SMALLEST) if each[0] < 20.0] == []
        check_access(page)


def test_a_fault_its_cause_and_what_to_do_are_on_the_first_screen(tmp_path: Path) -> None:
    with shown(tmp_path, pallet(), reading_cm=300, absent=("front_left", "rear_right")) as it:
        it.fly(5.0)
        page = it.page
        expect(page.locator("#state")).to_have_text("critical")
        expect(page.locator("#faults li")).to_have_count(1)
        expect(page.locator("#faults")).to_contain_text("Range front_left: no answer")
        expect(page.locator("#faults small")).to_contain_text("check its power")
        assert bottom(page, "#faults") < bottom(page, "#axis") < PHONE["height"]
        page.locator("#more summary").click()
        expect(page.locator("#more-faults")).to_contain_text("Range rear_right: no answer")
        check_access(page)


@pytest.mark.slow
def test_that_nothing_is_sent_and_that_no_bridge_runs_is_plain(tmp_path: Path) -> None:
    with shown(tmp_path, airframe(send="nothing"), reading_cm=300) as it:
        it.fly(7.0)
        page = it.page
        expect(page.locator("#state")).to_have_text("sends nothing")
        expect(page.locator("#distance-more")).to_contain_text("not sent")
        check_access(page)
        it.watch.close()
        expect(page.locator("#state")).to_have_text("the bridge does not run")
        page.reload()
        expect(page.locator("#vehicle")).to_have_text("bench")
        expect(page.locator("#state")).to_have_text("the bridge does not run")
        expect(page.locator("#distance")).to_have_text("none")
        check_access(page)


@pytest.mark.parametrize("name", [None, *slow("proximity", "canted_pallet")])
def test_names_of_sensors_cover_nothing_in_the_drawing(name: str | None, tmp_path: Path) -> None:
    """Of four sensors at one place, too."""
    made = airframe() if name is None else load_airframe(CONFIGS / f"{name}.yaml")
    with shown(tmp_path, made, reading_cm=300) as it:
        it.fly(3.0)
        boxes = it.page.evaluate(BOXES)
        assert {each for each, _ in boxes} >= {sensor.name for sensor in made.sensors}
        for (one, a), (other, b) in combinations(boxes, 2):
            left, top = max(a["left"], b["left"]), max(a["top"], b["top"])
            covers = left < min(a["right"], b["right"]) and top < min(a["bottom"], b["bottom"])
            assert not covers, (one, other)
