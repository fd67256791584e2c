"""Commissioning in Debian's Chromium: a vehicle that is emulated, hands that do what the phone says."""

import io
import re
import socket
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from playwright.sync_api import Page, expect

from msp_range.commission import phone
from msp_range.commission.phone import PersonAtPhone, PhonePage, by_phone
from msp_range.watch.place import Listen
from msp_range.yaml_file import ConfigError
from tests.loop.test_commission import GOOD, LOW, REVERSED, ROTATED, SWAPPED, WRONG_SIGN, Vehicle
from tests.peers.test_page import BROWSER_STARTS_S, browser
from tests.support.known import known
from tests.support.slow import slow_but
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
    """A command at the vehicle with its page, and who holds phone and vehicle."""

    def __init__(self, vehicle: Vehicle, monkeypatch: pytest.MonkeyPatch) -> None:
        person = vehicle.person
        self.tape: list[float | None] = []

        class Hands(PersonAtPhone):
            def instruct(self, text: str) -> None:
                super().instruct(text)
                person.instruct(text)

            def height_m(_self, text: str) -> float | None:
                self.tape.append(person.height_m(text))
                return super().height_m(text)

        monkeypatch.setattr(phone, "PersonAtPhone", Hands)
        self.listen = Listen("127.0.0.1", free_port(socket.SOCK_STREAM))
        self.out = io.StringIO()
        self._vehicle = vehicle

    def run(self, step: str) -> int:
        """The command; its exit code."""
        return by_phone(self._vehicle.session, step, self.listen, self.out)

    @property
    def url(self) -> str:
        return f"http://{self.listen.host}:{self.listen.port}/"

    def code(self) -> str:
        """What the terminal shows."""
        until(lambda: "code" in self.out.getvalue(), LIMIT_S, seen=self.out.getvalue)
        return known(re.search(r"code (\d{6})", self.out.getvalue()))[1]

    def answer_all(self, page: Page) -> None:
        """Give the code, and answer as a person does who agrees to everything, until it ends."""
        page.fill("#code", self.code())
        page.click("#enter button")
        asks, now = page.locator("#ask"), page.locator("#now")
        while True:
            until(lambda: asks.is_visible() or "passed" in now.inner_text(), BROWSER_STARTS_S)
            if not asks.is_visible():
                return
            asked = now.inner_text()
            if page.locator("#ask input").count():
                page.fill("#ask input", f"{self.tape[-1] or ''}")
                page.click("#ask button:text('Send')")
            else:
                page.click("#ask button >> nth=0")
            expect(now).not_to_have_text(asked)


@pytest.mark.parametrize("name", slow_but(["swapped addresses", "wrong height"], MOUNTINGS))
def test_a_wrong_mounting_is_corrected_from_a_phone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    mounted, in_file, step = MOUNTINGS[name]
    vehicle = Vehicle(tmp_path, mounted, in_file, seed=1)
    held = Phone(vehicle, monkeypatch)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(held.run, step)
        held.code()
        with browser(held.url, viewport={"width": 390, "height": 844}) as (page, errors):
            held.answer_all(page)
            log = page.locator("#log").inner_text()
            assert errors == []
        done.result(LIMIT_S)
    assert "Are the propellers off?" in log
    assert "change" in log
    assert (tmp_path / "airframe.yaml.1").read_text() == in_file
    for found, true in zip(vehicle.airframe.sensors, vehicle.held.mounted.sensors, strict=True):
        assert found.address == true.address
        assert found.position_m == pytest.approx(true.position_m, abs=0.021)
        assert sum(a * b for a, b in zip(found.boresight, true.boresight, strict=True)) > 0.985


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
    held = Phone(vehicle, monkeypatch)
    with ThreadPoolExecutor(1) as pool:
        done = pool.submit(held.run, "addresses")
        with browser(f"{held.url}?code={held.code()}") as (page, _):
            page.click("#ask button:text('no')")
            expect(page.locator("#now")).to_contain_text("propellers off, then")
        with pytest.raises(ConfigError, match="take the propellers off"):
            done.result(LIMIT_S)
    assert vehicle.path.read_text() == SWAPPED
