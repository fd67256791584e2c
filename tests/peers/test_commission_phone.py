"""Commissioning in Debian's Chromium: a vehicle that is emulated, hands that do what the phone says."""

import io
import re
import socket
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from queue import SimpleQueue
from threading import Semaphore, Thread
from typing import Any

import pytest
from playwright.sync_api import Page, expect

from msp_range.commission import phone
from msp_range.commission.phone import PersonAtPhone, PhonePage, by_phone
from msp_range.commission.session import Session
from msp_range.watch.place import Listen
from msp_range.yaml_file import ConfigError
from tests.loop.test_commission import COPTER, GOOD, LOW, REVERSED, ROTATED, SWAPPED, WRONG_SIGN, Vehicle
from tests.peers.test_page import BROWSER_STARTS_S, browser
from tests.peers.test_page_screen import PHONE, bottom, check_access
from tests.support.hand_held import Person
from tests.support.known import known
from tests.support.slow import slow, slow_but
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S, until

MOUNTINGS = {
    "swapped addresses": (GOOD, SWAPPED, "addresses"),
    "reversed pitch": (GOOD, REVERSED, "lift"),
    "wrong height": (GOOD, LOW, "bench"),
    "wrong sign of y": (GOOD, WRONG_SIGN, "lift"),
    "one sensor rotated": (ROTATED, GOOD, "lift"),
}


class Phone:
    """A command at the vehicle with its page, and who holds phone and vehicle.

    Parameters
    ----------
    session
        The command's.
    person
        Moves the vehicle.

    Attributes
    ----------
    asked
        What the page has asked so far, buttons included.
    """

    def __init__(self, session: Session, person: Person, monkeypatch: pytest.MonkeyPatch) -> None:
        self.asked: list[str] = []
        self.look: Callable[[Page], object] | None = None
        """Looks at the page at each question and instruction; the vehicle waits meanwhile."""
        self._tape: list[float | None] = []
        self._shown: SimpleQueue[str] = SimpleQueue()
        self._seen = Semaphore(0)

        class Hands(PersonAtPhone):
            def instruct(_self, text: str) -> None:
                super().instruct(text)
                if self.look is not None:
                    self._shown.put(text)
                    self._seen.acquire(timeout=LIMIT_S)
                person.instruct(text)

            def height_m(_self, text: str) -> float | None:
                self._tape.append(person.height_m(text))
                return super().height_m(text)

        monkeypatch.setattr(phone, "PersonAtPhone", Hands)
        self.listen = Listen("127.0.0.1", free_port(socket.SOCK_STREAM))
        self.out = io.StringIO()
        self._session = session

    def run(self, step: str | None) -> dict[str, Any]:
        """The command; its report."""
        return by_phone(self._session, step, self.listen, self.out)

    @property
    def url(self) -> str:
        return f"http://{self.listen.host}:{self.listen.port}/"

    def code(self) -> str:
        """What the terminal shows."""
        until(lambda: "code" in self.out.getvalue(), LIMIT_S, seen=self.out.getvalue)
        return known(re.search(r"code (\d{6})", self.out.getvalue()))[1]

    def do(self, step: str | None = None) -> tuple[dict[str, Any], str]:
        """The command with somebody who agrees to everything on the phone; its report, and what the page lists."""
        self.out = io.StringIO()
        done: Future[dict[str, Any]] = Future()

        def run() -> None:
            try:
                done.set_result(self.run(step))
            except BaseException as error:
                done.set_exception(error)

        # A command whose browser has failed would wait for ten minutes.
        Thread(target=run, daemon=True).start()
        self.code()
        with browser(self.url, viewport=PHONE) as (page, errors):
            self._answer_all(page, done)
            log = page.locator("#log").inner_text()
            assert errors == []
        return done.result(LIMIT_S), log

    def _answer_all(self, page: Page, done: "Future[dict[str, Any]]") -> None:
        """Give the code, and answer as a person does who agrees to everything, until it ends."""
        asks, now = page.locator("#ask"), page.locator("#now")
        self._look_at(page)
        page.fill("#code", self.code())
        page.click("#enter button")
        while True:
            until(lambda: asks.is_visible() or not self._shown.empty() or done.done(), BROWSER_STARTS_S)
            if not self._shown.empty():
                expect(now).to_have_text(self._shown.get())
                self._look_at(page)
                self._seen.release()
            elif asks.is_visible():
                self._answer(page)
            else:
                self._look_at(page)
                return

    def _answer(self, page: Page) -> None:
        self.asked.append(page.locator("#now").inner_text())
        self._look_at(page)
        # The next question may have the same words.
        number = page.locator("#ask").get_attribute("data-number")
        if page.locator("#ask input").count():
            page.fill("#ask input", f"{self._tape[-1] or ''}")
            page.click("#ask button:text('Send')")
        else:
            page.click("#ask button >> nth=0")
        until(lambda: not page.locator(f"#ask:visible[data-number='{number}']").count(), BROWSER_STARTS_S)

    def _look_at(self, page: Page) -> None:
        if self.look is not None:
            self.look(page)


@pytest.mark.parametrize("name", slow_but(["swapped addresses", "wrong height"], MOUNTINGS))
def test_a_wrong_mounting_is_corrected_from_a_phone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    mounted, in_file, step = MOUNTINGS[name]
    vehicle = Vehicle(tmp_path, mounted, in_file, seed=1)
    _, log = Phone(vehicle.session, vehicle.person, monkeypatch).do(step)
    assert "Are the propellers off?" in log
    assert "change" in log
    assert (tmp_path / "airframe.yaml.1").read_text() == in_file
    for found, true in zip(vehicle.airframe.sensors, vehicle.held.mounted.sensors, strict=True):
        assert found.address == true.address
        assert found.position_m == pytest.approx(true.position_m, abs=0.021)
        assert sum(a * b for a, b in zip(found.boresight, true.boresight, strict=True)) > 0.985


@pytest.mark.parametrize("is_dark", [False, *slow(True)])
def test_every_step_fits_on_the_phone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_dark: bool) -> None:
    vehicle = Vehicle(tmp_path, GOOD, SWAPPED, seed=9)
    vehicle.computer()
    vehicle.held.parameters = COPTER | {"RNGFND1_TYPE": 0.0}
    held = Phone(vehicle.session, vehicle.person, monkeypatch)
    looked = []

    def look(page: Page) -> None:
        page.emulate_media(color_scheme="dark" if is_dark else "light")
        check_access(page)
        # What is to be done, and all answers, are on the first screen.
        for selector in ("#now", "#ask", "#enter"):
            assert not page.locator(selector).is_visible() or bottom(page, selector) <= PHONE["height"]
        looked.append(page.locator("#now").inner_text())

    held.look = look
    report, log = held.do()
    assert [*report["steps"]] == ["wires", "addresses", "bench", "parameters", "lift", "hover"]
    assert looked[-1] == "hover has not passed: see below."
    assert any(each.startswith("Rock it slowly") for each in looked)
    # The page and the terminal break lines each at its own width.
    (exchanged,) = [each for each in held.asked if "exchanged" in each]
    assert exchanged.splitlines()[0].endswith("front_right 0x70 -> 0x71")
    for line in (exchanged.splitlines()[0], "the sensor at 0x70 answered, which the file calls front_right"):
        assert line in log
        assert line not in held.out.getvalue()
    findings = held.out.getvalue().partition("---")[2].splitlines()
    assert max(map(len, findings)) <= 80
    assert "sensor at 0x70 answered, which the file calls front_right" in " ".join(" ".join(findings).split())


def test_a_phone_that_slept_goes_on_and_another_browser_is_refused(tmp_path: Path) -> None:
    vehicle = Vehicle(tmp_path, GOOD, GOOD, seed=1)
    listen = Listen("127.0.0.1", free_port(socket.SOCK_STREAM))
    with PhonePage(listen, vehicle.held.clock) as served, ThreadPoolExecutor(1) as pool:
        asked = pool.submit(served.ask, "Ready?", "ready")
        with browser(f"http://{listen.host}:{listen.port}/?code={served.code}") as (page, _):
            page.wait_for_selector("#ask button")
            assert "code" not in page.url
            page.reload()
            page.wait_for_selector("#ask button")
            other = second_browser(page)
            other.goto(f"http://{listen.host}:{listen.port}/?code={served.code}")
            expect(other.locator("#now")).to_contain_text("Another browser")
            page.click("#ask button")
            assert asked.result(LIMIT_S) == "ready"


def second_browser(page: Page) -> Page:
    """A second browser, which shares nothing with the first."""
    other = page.context.browser
    assert other is not None
    return other.new_context().new_page()


def test_propellers_that_are_on_end_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    vehicle = Vehicle(tmp_path, GOOD, SWAPPED, seed=1)
    held = Phone(vehicle.session, vehicle.person, monkeypatch)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(held.run, "addresses")
        with browser(f"{held.url}?code={held.code()}") as (page, _):
            page.click("#ask button:text('no')")
            expect(page.locator("#now")).to_contain_text("propellers off, then")
        with pytest.raises(ConfigError, match="take the propellers off"):
            done.result(LIMIT_S)
    assert vehicle.path.read_text() == SWAPPED
