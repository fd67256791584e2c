"""Who may see the page of a running bridge, and where it listens."""

import asyncio
import os
import socket
import sys
from pathlib import Path

import pytest

from msp_range.watch.place import Listen, own_socket, parse_listen, sockets
from msp_range.web.access import refusal, token_for
from msp_range.web.server import Page
from msp_range.yaml_file import ConfigError
from tests.support.transports import free_port

HERE = "127.0.0.1:8642"


def status(token: str | None, target: str | None, host: str | None, origin: str | None = None) -> int | None:
    refused = refusal(token, target, host, origin)
    return None if refused is None else refused[0].value


@pytest.mark.parametrize(
    ("host", "origin", "expected"),
    [
        (HERE, None, None),
        ("localhost:8642", "http://localhost:8642", None),
        ("[::1]:8642", None, None),
        (HERE, "null", 403),  # a page from a file, or in a sandbox
        (HERE, "http://127.0.0.1:8643", 403),  # another program's page on this computer
        (HERE, "http://evil.example", 403),
        ("evil.example:8642", None, 403),  # a name of the internet that resolves to this computer
        ("evil.example:8642", "http://evil.example:8642", 403),
        ("127.0.0.1.evil.example", None, 403),
        ("", None, 403),
        (None, None, 403),
    ],
)
def test_a_page_for_this_computer_is_seen_by_its_own_name_only(
    host: str | None, origin: str | None, expected: int | None
) -> None:
    assert status(None, "/live", host, origin) == expected


@pytest.mark.parametrize(
    "head",
    [
        "GET / HTTP/1.1\r\nHost: [",
        "GET / HTTP/1.1\r\nHost: [::1",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nHost: localhost",
        "GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nOrigin: http://[",
        "GET //[ HTTP/1.1\r\nHost: 127.0.0.1",
    ],
)
@pytest.mark.parametrize("token", [None, "secret"])
def test_a_request_without_a_clear_address_is_refused(
    head: str, token: str | None, tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It was an error of the server with a traceback, and came before the token was asked for."""
    ends, bridge = os.pipe()

    async def answer(port: int) -> bytes:
        page = Page(tmp_path / "none", token)
        ready = asyncio.Event()
        serving = asyncio.create_task(page.serve(Listen("127.0.0.1", port), lambda _: ready.set()))
        await ready.wait()
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(f"{head}\r\n\r\n".encode())
        received = await asyncio.wait_for(reader.read(), 5.0)
        writer.close()
        serving.cancel()
        await asyncio.gather(serving, return_exceptions=True)
        return received

    with open(ends) as stdin, open(bridge, "w"):
        monkeypatch.setattr(sys, "stdin", stdin)
        status_line = asyncio.run(answer(free_port(socket.SOCK_STREAM))).split(b"\r\n")[0]
    assert status_line.split()[1] in (b"400", b"401", b"403")
    assert [record for record in caplog.records if record.exc_info] == []


@pytest.mark.parametrize(
    ("target", "expected"),
    [
        ("/?token=secret", None),
        ("/live?token=secret", None),
        ("/live?x=1&token=secret", None),
        ("/live", 401),
        ("/live?token=", 401),
        ("/live?token=secre", 401),
        ("/live?token=secrett", 401),
        ("/live?token=SECRET", 401),
        ("/live?token=%E2%82%AC", 401),
        ("/live?token=wrong&token=secret", 401),
        ("/secret", 401),
        (None, None),  # style and scripts
    ],
)
def test_a_page_for_other_computers_is_seen_with_the_token_only(target: str | None, expected: int | None) -> None:
    assert status("secret", target, "192.168.1.7:8642") == expected
    assert status("secret", target, "192.168.1.7:8642", "http://192.168.1.7:8642") == expected
    assert status("secret", target, "192.168.1.7:8642", "http://evil.example") == 403
    assert status("secret", target, None) == 403


def test_the_token_is_made_once_and_for_its_owner_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder = tmp_path / "new"
    monkeypatch.setenv("STATE_DIRECTORY", str(folder))
    for host in ("127.0.0.1", "localhost", "::1"):
        assert token_for(Listen(host, 8642)) is None
    assert not folder.exists()
    token = token_for(Listen("0.0.0.0", 8642))
    assert token is not None
    assert len(token) == 22  # 128 bits in base 64
    assert (folder / "web-token").stat().st_mode & 0o777 == 0o600
    assert token_for(Listen("::", 8642)) == token
    (folder / "web-token").write_text("\n")  # cut by a power failure
    assert token_for(Listen("0.0.0.0", 8642)) not in (None, "", token)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1", ("127.0.0.1", 1)),
        ("0.0.0.0:65535", ("0.0.0.0", 65535)),
        ("[::]:80", ("::", 80)),
        (":80", ("127.0.0.1", 80)),
    ],
)
def test_where_the_page_listens(text: str, expected: tuple[str, int]) -> None:
    assert parse_listen(text) == expected


@pytest.mark.parametrize("text", ["", "0", "65536", "-1", "x", "host:", "8080:host", "1.5", "²"])
def test_a_wrong_place_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match=r"expected \[HOST:\]PORT, such as 8080"):
        parse_listen(text)


def test_the_socket_is_looked_for_where_it_is_made(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert own_socket() == tmp_path / "msp-range" / "status.sock"
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert own_socket() in sockets()
    monkeypatch.setenv("RUNTIME_DIRECTORY", "/run/msp-range")
    assert own_socket() in sockets()
