"""udpout and udpin against plain sockets."""

import socket
import threading
from collections.abc import Iterator

import pytest

from msp_range.clock import SystemClock
from msp_range.mavlink.dialect import dialect
from msp_range.mavlink.transport import Transport
from msp_range.mavlink.transport.base import RECEIVE_BOUND_BYTES
from msp_range.mavlink.transport.udp import _MOST_DATAGRAMS, MOST_PEERS
from tests.support.mavlink_ends import Component
from tests.support.transports import (
    FRAME_BYTES,
    SendTimer,
    StepClock,
    check_passes,
    frame_numbers,
    free_port,
    numbered_frame,
    opened,
    received_by,
)
from tests.support.waiting import LIMIT_S, until

SOCKET_KIND = {"udpin": socket.SOCK_DGRAM, "udpout": socket.SOCK_DGRAM, "tcpin": socket.SOCK_STREAM}


def bound(port: int = 0) -> socket.socket:
    peer = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    peer.bind(("127.0.0.1", port))
    peer.settimeout(LIMIT_S)
    return peer


@pytest.fixture
def peer() -> Iterator[socket.socket]:
    with bound() as socket_:
        yield socket_


def datagrams(peer: socket.socket) -> bytes:
    """What is there already; on the loopback a datagram has arrived when it has been sent."""
    peer.setblocking(False)
    received = b""
    try:
        while True:
            received += peer.recv(65535)
    except BlockingIOError:
        return received


def test_udpout_carries_frames_both_ways(peer: socket.socket) -> None:
    with opened(f"udpout:127.0.0.1:{peer.getsockname()[1]}", SystemClock()) as link:
        assert link.receive() == b""
        for number in range(3):
            assert link.send(numbered_frame(number))
            datagram, source = peer.recvfrom(65535)
            assert datagram == numbered_frame(number)
            peer.sendto(datagram, source)
        assert frame_numbers(received_by(link, 3 * 52)) == [0, 1, 2]
        assert link.connected
        assert link.last_error is None
        assert link.stats.sent_frames == 3


def test_udpout_counts_refusals_and_loses_no_frame_to_an_old_one() -> None:
    clock = StepClock()
    port = free_port(socket.SOCK_DGRAM)
    with opened(f"udpout:127.0.0.1:{port}", clock) as link:
        timer = SendTimer(link)
        for number in range(100):
            timer.send(numbered_frame(number))
            assert link.receive() == b""
        timer.check()
        assert link.stats.refused == 100
        assert not link.connected
        assert link.send(numbered_frame(100))  # its refusal is still waiting to be reported when the peer arrives
        with bound(port) as peer:
            check_passes(link, 101, lambda _: datagrams(peer))
            clock.now_s += 2.0
            assert link.connected
            assert link.stats.reconnects == 0


def test_udpout_reports_an_address_that_it_may_not_send_to() -> None:
    with opened("udpout:255.255.255.255:14550", StepClock()) as link:
        assert not link.send(numbered_frame(0))
        assert link.receive() == b""
        assert not link.connected
        # The second where the computer has no route to any network.
        whys = {"Permission denied", "Network is unreachable"}
        assert link.last_error in {f"udpout:255.255.255.255:14550: {why}" for why in whys}
        assert link.stats.dropped_frames == 1


def test_udpout_opens_a_new_socket_after_an_error_that_is_no_refusal(
    peer: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As when the network interface gets another address: the old socket's own address is no longer valid."""

    class Unplugged(socket.socket):
        unplugged = True

        def send(self, *_: object) -> int:
            if self.unplugged:
                raise OSError(22, "Invalid argument")
            return super().send(*_)  # type: ignore[arg-type]

    monkeypatch.setattr(socket, "socket", Unplugged)
    clock = StepClock()
    with opened(f"udpout:127.0.0.1:{peer.getsockname()[1]}", clock) as link:
        assert not link.send(numbered_frame(0))
        assert not link.connected
        assert link.last_error is not None
        Unplugged.unplugged = False
        assert not link.send(numbered_frame(1))
        clock.now_s += 0.5
        check_passes(link, 2, lambda _: datagrams(peer))
        assert link.stats.reconnects == 1


def test_udpin_answers_everyone_from_whom_it_received_lately() -> None:
    clock = StepClock()
    port = free_port(socket.SOCK_DGRAM)
    with opened(f"udpin:127.0.0.1:{port}", clock) as link, bound() as first, bound() as second:
        assert not link.send(numbered_frame(0))
        assert not link.connected
        assert link.stats.dropped_frames == 1
        first.sendto(numbered_frame(10), ("127.0.0.1", port))
        second.sendto(numbered_frame(11), ("127.0.0.1", port))
        assert frame_numbers(received_by(link, 2 * 52)) == [10, 11]
        assert link.connected
        assert link.send(numbered_frame(1))
        clock.now_s += 9.0
        assert link.send(numbered_frame(2))
        first.sendto(numbered_frame(12), ("127.0.0.1", port))
        assert frame_numbers(received_by(link, 52)) == [12]
        clock.now_s += 2.0
        assert link.send(numbered_frame(3))
        clock.now_s += 9.0
        assert not link.send(numbered_frame(4))
        assert not link.connected
        assert frame_numbers(datagrams(first)) == [1, 2, 3]
        assert frame_numbers(datagrams(second)) == [1, 2]
        assert link.stats.sent_frames == 5


def autopilot_heartbeat() -> bytes:
    return Component(7).heartbeat()


def ground_station_heartbeat() -> bytes:
    beat = dialect.MAVLink_heartbeat_message(dialect.MAV_TYPE_GCS, dialect.MAV_AUTOPILOT_INVALID, 0, 0, 4, 3)
    return Component(255, 190).frame(beat)


class Crowd:
    """Sockets of many senders to one ``udpin`` link."""

    def __init__(self, link: Transport, port: int) -> None:
        self._link = link
        self._address = ("127.0.0.1", port)
        self.sockets: list[socket.socket] = []

    def send(self, content: bytes, count: int = 1) -> list[socket.socket]:
        """Datagrams with this content from ``count`` new sockets."""
        senders = [bound() for _ in range(count)]
        self.sockets += senders
        for sender in senders:
            self.again(sender, content)
        return senders

    def again(self, sender: socket.socket, content: bytes) -> None:
        sender.sendto(content, self._address)
        self._link.receive()

    def answered(self, senders: list[socket.socket]) -> list[bool]:
        """Who of them gets what the link sends."""
        for sender in senders:
            datagrams(sender)
        self._link.send(numbered_frame(0))
        return [bool(datagrams(sender)) for sender in senders]


@pytest.fixture
def udpin() -> Iterator[tuple[StepClock, Crowd]]:
    port = free_port(socket.SOCK_DGRAM)
    clock = StepClock()
    with opened(f"udpin:127.0.0.1:{port}", clock) as link:
        crowd = Crowd(link, port)
        yield clock, crowd
        for each in crowd.sockets:
            each.close()


BROKEN = ground_station_heartbeat()[:-1] + b"\0"


@pytest.mark.parametrize("content", [b"", b"x", b"\xfd" * 300, BROKEN, ground_station_heartbeat()[:-1]])
def test_udpin_sends_nothing_to_who_does_not_speak_mavlink(udpin: tuple[StepClock, Crowd], content: bytes) -> None:
    _, crowd = udpin
    (autopilot,) = crowd.send(autopilot_heartbeat())
    strangers = crowd.send(content, 16)
    assert crowd.answered([autopilot, *strangers]) == [True] + [False] * 16


def test_udpin_passes_on_only_frames(udpin: tuple[StepClock, Crowd], peer: socket.socket) -> None:
    _, crowd = udpin
    peer.sendto(b"noise" + numbered_frame(1) + b"\xfd", crowd._address)
    assert received_by(crowd._link, FRAME_BYTES) == numbered_frame(1)


def test_udpin_has_few_peers_and_keeps_those_that_it_has(udpin: tuple[StepClock, Crowd]) -> None:
    clock, crowd = udpin
    first = crowd.send(ground_station_heartbeat(), MOST_PEERS)
    late = crowd.send(ground_station_heartbeat(), 12)
    assert crowd.answered(first + late) == [True] * MOST_PEERS + [False] * 12
    clock.now_s += 11.0
    crowd.again(late[0], ground_station_heartbeat())
    assert crowd.answered([*first, late[0]]) == [False] * MOST_PEERS + [True]


def test_udpin_drops_the_frames_of_who_is_no_peer(udpin: tuple[StepClock, Crowd], peer: socket.socket) -> None:
    _, crowd = udpin
    crowd.send(ground_station_heartbeat(), MOST_PEERS)
    peer.sendto(numbered_frame(1), crowd._address)
    assert crowd._link.receive() == b""


def test_the_autopilot_comes_in_where_there_are_peers_enough(udpin: tuple[StepClock, Crowd]) -> None:
    clock, crowd = udpin
    others = crowd.send(ground_station_heartbeat(), MOST_PEERS)
    clock.now_s += 1.0
    for each in others[1:]:
        crowd.again(each, ground_station_heartbeat())
    (autopilot,) = crowd.send(autopilot_heartbeat())
    assert crowd.answered([*others, autopilot]) == [False] + [True] * MOST_PEERS


def test_the_autopilot_that_is_received_is_never_given_up(udpin: tuple[StepClock, Crowd]) -> None:
    clock, crowd = udpin
    (autopilot,) = crowd.send(autopilot_heartbeat())
    for _ in range(30):
        clock.now_s += 1.0
        crowd.send(ground_station_heartbeat(), 8)
        crowd.send(autopilot_heartbeat(), 8)
        crowd.again(autopilot, autopilot_heartbeat())
        assert crowd.answered([autopilot]) == [True]


def test_udpin_waits_for_a_port_that_another_program_has() -> None:
    clock = StepClock()
    other = bound()
    port = other.getsockname()[1]
    with opened(f"udpin:127.0.0.1:{port}", clock) as link:
        assert link.last_error == f"udpin:127.0.0.1:{port}: Address already in use"
        assert not link.send(numbered_frame(0))
        other.close()
        assert link.receive() == b""
        assert link.last_error is not None
        clock.now_s += 0.5
        assert link.receive() == b""
        assert link.last_error is None
        with bound() as peer:
            peer.sendto(numbered_frame(1), ("127.0.0.1", port))
            assert frame_numbers(received_by(link, 52)) == [1]


@pytest.mark.parametrize("kind", ["udpin", "udpout"])
def test_one_receive_does_not_keep_the_loop_for_ever(kind: str, peer: socket.socket) -> None:
    port = free_port(socket.SOCK_DGRAM) if kind == "udpin" else peer.getsockname()[1]
    with opened(f"{kind}:127.0.0.1:{port}", StepClock()) as link:
        if kind == "udpout":
            link.send(b"x")
            target = peer.recvfrom(10)[1]
        else:
            target = ("127.0.0.1", port)
        frames = [numbered_frame(number) for number in range(240)]
        for start in range(0, 240, 4):
            peer.sendto(b"".join(frames[start : start + 4]), target)
        first = link.receive()
        assert RECEIVE_BOUND_BYTES <= len(first) < RECEIVE_BOUND_BYTES + 4 * 52
        assert first + link.receive() == b"".join(frames)
        for datagram in [b""] * _MOST_DATAGRAMS + frames[:1]:
            peer.sendto(datagram, target)
        assert link.receive() == b""
        assert link.receive() == frames[0]


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp", "tcpin"])
def test_a_name_that_takes_long_to_look_up_stops_nothing(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = threading.Event()

    def slow(*_: object) -> list[tuple[object, ...]]:
        assert answer.wait(LIMIT_S), "the link waits for the name"
        return [(socket.AF_INET, socket.SOCK_DGRAM, 0, "", ("127.0.0.1", 0))]

    monkeypatch.setattr(socket, "getaddrinfo", slow)
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1] if kind == "tcp" else free_port(SOCKET_KIND[kind])
        with opened(f"{kind}:autopilot.local:{port}", StepClock()) as link:
            assert not link.send(numbered_frame(0))
            assert link.receive() == b""
            assert link.last_error is None
            answer.set()
            if kind == "udpin":
                with bound() as client:
                    until(lambda: bool(client.sendto(numbered_frame(0), ("127.0.0.1", port))) and bool(link.receive()))
            elif kind == "tcpin":

                def let_in() -> bool:
                    link.receive()
                    with socket.socket() as client:
                        return client.connect_ex(("127.0.0.1", port)) == 0

                until(let_in)
            else:
                until(lambda: link.send(numbered_frame(1)))


def test_a_name_that_cannot_be_looked_up_is_tried_again(peer: socket.socket, monkeypatch: pytest.MonkeyPatch) -> None:
    real = socket.getaddrinfo

    def fail(*_: object) -> None:
        raise socket.gaierror(socket.EAI_AGAIN, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", fail)
    clock = StepClock()
    with opened(f"udpout:localhost:{peer.getsockname()[1]}", clock) as link:
        until(lambda: link.receive() == b"" and link.last_error is not None)
        assert link.last_error is not None
        assert "cannot look up 'localhost': Temporary failure in name resolution" in link.last_error
        monkeypatch.setattr(socket, "getaddrinfo", real)
        assert not link.send(numbered_frame(0))
        clock.now_s += 0.5
        until(lambda: link.send(numbered_frame(1)))
        assert frame_numbers(datagrams(peer)) == [1]
        assert link.last_error is None


@pytest.mark.parametrize("kind", ["udpin", "udpout", "tcp", "tcpin"])
def test_a_closed_link_stays_closed(kind: str) -> None:
    clock = StepClock()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1] if kind == "tcp" else free_port(SOCKET_KIND[kind])
        with opened(f"{kind}:127.0.0.1:{port}", clock) as link:
            link.receive()
            link.close()
            clock.now_s += 100.0
            assert not link.send(numbered_frame(0))
            assert link.receive() == b""
            assert not link.connected
