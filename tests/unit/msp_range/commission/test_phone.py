"""Who may answer on the phone's page, and for how long, by a client that is not a browser."""

import io
import json
import socket
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from types import SimpleNamespace
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin

from msp_range.clock import VirtualClock
from msp_range.commission import phone
from msp_range.commission.phone import EVERYWHERE, MOST_TRIES, WINDOW_S, PersonAtPhone, PhonePage, by_phone
from msp_range.watch.place import Listen
from msp_range.yaml_file import ConfigError
from tests.support.transports import free_port
from tests.support.waiting import LIMIT_S


class Opened:
    """A page, and its questions, which wait in a thread."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.listen = Listen("127.0.0.1", free_port(socket.SOCK_STREAM))
        self.page = PhonePage(self.listen, self.clock)
        self.pool, self.stack = ThreadPoolExecutor(1), ExitStack()

    def client(self, origin: str | None = None) -> ClientConnection:
        """A connection that ends with the test."""
        known = None if origin is None else Origin(origin)
        return self.stack.enter_context(connect(f"ws://127.0.0.1:{self.listen.port}/live", origin=known))

    def ask(self, *question: str) -> "Future[str]":
        return self.pool.submit(self.page.ask, *question)


@pytest.fixture
def opened() -> Iterator[Opened]:
    made = Opened()
    with made.page, made.stack:
        yield made
        made.clock.sleep_until(WINDOW_S + 1.0)
    made.pool.shutdown()


def said(client: ClientConnection, kind: str) -> Any:
    """The next message of a kind."""
    while True:
        message = json.loads(client.recv(LIMIT_S))
        if message["kind"] == kind:
            return message


def let_in(opened: Opened) -> tuple[ClientConnection, str]:
    client = opened.client()
    client.send(json.dumps({"code": opened.page.code}))
    return client, said(client, "open")["secret"]


def test_the_code_counts_once_and_the_secret_lets_the_same_browser_come_again(opened: Opened) -> None:
    answer = opened.ask("Ready?", "ready")
    client, secret = let_in(opened)
    again = opened.client()
    again.send(json.dumps({"code": opened.page.code}))
    assert "Another browser" in said(again, "refused")["text"]
    later = opened.client()
    later.send(json.dumps({"secret": secret}))
    question = said(later, "question")
    said(client, "question")
    with pytest.raises(ConnectionClosed):
        client.recv(LIMIT_S)
    later.send(json.dumps({"number": question["number"], "answer": "ready"}))
    assert answer.result(LIMIT_S) == "ready"


def test_wrong_codes_close_the_page(opened: Opened) -> None:
    answer = opened.ask("Ready?", "ready")
    for left in reversed(range(MOST_TRIES)):
        client = opened.client()
        client.send(json.dumps({"code": "abc"}))
        assert f"{left} tries" in said(client, "refused")["text"]
    client = opened.client()
    client.send(json.dumps({"code": opened.page.code}))
    assert "closed" in said(client, "refused")["text"]
    with pytest.raises(ConfigError, match="wrong codes"):
        answer.result(LIMIT_S)


def test_a_browser_that_knows_an_earlier_page_uses_up_no_tries(opened: Opened) -> None:
    for _ in range(MOST_TRIES + 1):
        client = opened.client()
        client.send(json.dumps({"secret": "of an earlier page"}))
        assert f"{MOST_TRIES} tries" in said(client, "refused")["text"]
    let_in(opened)


def test_nothing_is_answered_once_the_time_is_over(opened: Opened) -> None:
    answer = opened.ask("Change it?", "change it", "leave it")
    client, secret = let_in(opened)
    question = said(client, "question")
    opened.clock.sleep_until(WINDOW_S + 1.0)
    client.send(json.dumps({"number": question["number"], "answer": "change it"}))
    with pytest.raises(ConfigError, match="ten minutes"):
        answer.result(LIMIT_S)
    late = opened.client()
    late.send(json.dumps({"secret": secret}))
    assert "closed" in said(late, "refused")["text"]


def test_a_button_pressed_twice_answers_one_question(opened: Opened) -> None:
    person = PersonAtPhone(opened.page, io.StringIO())
    first = opened.pool.submit(person.agrees, "first")
    client, _ = let_in(opened)
    number = said(client, "question")["number"]
    for _ in range(2):
        client.send(json.dumps({"number": number, "answer": "change it"}))
    assert first.result(LIMIT_S)
    second = opened.pool.submit(person.agrees, "second")
    client.send(json.dumps({"number": said(client, "question")["number"], "answer": "leave it"}))
    assert not second.result(LIMIT_S)


def test_a_height_is_asked_for_until_it_is_one(opened: Opened) -> None:
    answer = opened.pool.submit(PersonAtPhone(opened.page, io.StringIO()).height_m, "How high is it?")
    client, _ = let_in(opened)
    shown = []
    for typed in ("85", "\x1b[2J", "0,85"):
        question = said(client, "question")
        shown.append(question["text"])
        client.send(json.dumps({"number": question["number"], "answer": typed}))
    assert shown[1].startswith("found '85'; expected metres")
    # What a terminal would obey is shown as text.
    assert "\x1b" not in shown[2]
    assert answer.result(LIMIT_S) == 0.85


def test_the_terminal_shows_where_the_page_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(phone, "hosts", lambda: ["192.0.2.5", "vehicle.local"])
    port, out = free_port(socket.SOCK_STREAM), io.StringIO()
    session: Any = SimpleNamespace(clock=VirtualClock())
    for host, places in ((EVERYWHERE, ("192.0.2.5", "vehicle.local")), ("127.0.0.1", ("127.0.0.1",))):
        monkeypatch.setattr(phone, "WINDOW_S", -1.0)
        with pytest.raises(ConfigError, match="ten minutes"):
            by_phone(session, None, Listen(host, port), out)
        urls = " or ".join(f"http://{place}:{port}/" for place in places)
        assert f"On the phone open {urls} and give the code" in out.getvalue()


def test_a_page_of_another_site_and_rubbish_are_refused(opened: Opened) -> None:
    with pytest.raises(InvalidStatus):
        opened.client(origin="http://example.org")
    for rubbish in ("", "[]", "7", '{"code": 7}', b"\xff"):
        opened.client().send(rubbish)
    long = opened.client()
    long.send(json.dumps({"code": "7" * 300}))
    with pytest.raises(ConnectionClosed):
        long.recv(LIMIT_S)
    with socket.create_connection(("127.0.0.1", opened.listen.port)) as two_hosts:
        two_hosts.sendall(b"GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n")
        assert b" 400 " in two_hosts.recv(100)
    client, _ = let_in(opened)
    answer = opened.ask("Ready?", "ready")
    number = said(client, "question")["number"]
    client.send(json.dumps({"number": number, "answer": "no such answer"}))
    client.send(json.dumps({"number": number, "answer": "ready"}))
    assert answer.result(LIMIT_S) == "ready"
