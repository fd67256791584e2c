"""Every real transport wakes the bridge when something arrives, so that it need not ask again and again."""

import os
import pty
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager

import pytest

from msp_range.clock import SystemClock
from msp_range.mavlink.transport import Transport
from tests.support.transports import free_port, numbered_frame, opened
from tests.support.waiting import LIMIT_S, until

CLOCK = SystemClock()
HOST = "127.0.0.1"
End = tuple[Transport, Callable[[bytes], object]]
"""A link, and what writes to it from the other end."""


@contextmanager
def udpout() -> Iterator[End]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.bind((HOST, 0))
        with opened(f"udpout:{HOST}:{peer.getsockname()[1]}", CLOCK) as link:
            link.send(numbered_frame(0))
            peer.connect(peer.recvfrom(1000)[1])
            yield link, peer.send


@contextmanager
def udpin() -> Iterator[End]:
    port = free_port(socket.SOCK_DGRAM)
    with opened(f"udpin:{HOST}:{port}", CLOCK) as link, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as peer:
        peer.connect((HOST, port))
        yield link, peer.send


@contextmanager
def tcp() -> Iterator[End]:
    with (
        socket.create_server((HOST, 0)) as server,
        opened(f"tcp:{HOST}:{server.getsockname()[1]}", CLOCK) as link,
        server.accept()[0] as peer,
    ):
        until(lambda: link.receive() == b"" and link.connected)
        yield link, peer.send


@contextmanager
def tcpin() -> Iterator[End]:
    port = free_port(socket.SOCK_STREAM)
    with opened(f"tcpin:{HOST}:{port}", CLOCK) as link, socket.create_connection((HOST, port)) as peer:
        until(lambda: link.receive() == b"" and link.connected)
        yield link, peer.send


@contextmanager
def serial() -> Iterator[End]:
    master, slave = pty.openpty()
    with opened(f"serial:{os.ttyname(slave)}:57600", CLOCK) as link:
        yield link, lambda frame: os.write(master, frame)
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize("kind", [udpout, udpin, tcp, tcpin, serial])
def test_a_frame_wakes_who_sleeps(kind: Callable[[], AbstractContextManager[End]]) -> None:
    with kind() as (link, write):
        assert link.receive() == b""
        assert not CLOCK.sleep_until(CLOCK.now() + 0.002, link.files)
        write(numbered_frame(7))
        assert CLOCK.sleep_until(CLOCK.now() + LIMIT_S, link.files)
        assert link.receive() == numbered_frame(7)
        assert not CLOCK.sleep_until(CLOCK.now() + 0.002, link.files)
        link.close()
        assert link.files == ()


def test_a_client_that_comes_wakes_a_server() -> None:
    port = free_port(socket.SOCK_STREAM)
    with opened(f"tcpin:{HOST}:{port}", CLOCK) as link, socket.create_connection((HOST, port)):
        assert CLOCK.sleep_until(CLOCK.now() + LIMIT_S, link.files)


def test_while_frames_wait_for_a_peer_it_is_asked_again_and_again() -> None:
    """They are written when the peer takes bytes again, which no arrival shows."""
    with tcp() as (link, _):
        for number in range(10_000):
            link.send(numbered_frame(number))
            if not link.files:
                break
        assert link.connected
        assert link.files == ()
