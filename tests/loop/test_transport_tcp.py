"""tcp and tcpin against plain sockets: late, vanishing, silent and several peers."""

import contextlib
import socket
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from msp_range.clock import SystemClock
from msp_range.mavlink.transport import Transport
from msp_range.mavlink.transport.stream import FRAME_DEADLINE_S
from msp_range.mavlink.transport.tcp import CONNECT_DEADLINE_S, MOST_CLIENTS, STUCK_AFTER_S
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
    read_exactly,
    received_by,
)
from tests.support.waiting import LIMIT_S, until


def serve(port: int = 0) -> socket.socket:
    server = socket.create_server(("127.0.0.1", port))
    server.settimeout(LIMIT_S)
    server.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)  # so that one that does not read is soon full
    return server


def is_connected(link: Transport) -> Callable[[], bool]:
    return lambda: link.receive() == b"" and link.connected


def test_tcp_carries_frames_both_ways() -> None:
    with serve() as server, opened(f"tcp:127.0.0.1:{server.getsockname()[1]}", SystemClock()) as link:
        until(is_connected(link))
        peer, _ = server.accept()
        with peer:
            for number in range(3):
                assert link.send(numbered_frame(number))
            received = read_exactly(peer, 3 * FRAME_BYTES)
            assert frame_numbers(received) == [0, 1, 2]
            peer.sendall(received)
            assert received_by(link, 3 * FRAME_BYTES) == received
            assert link.stats.sent_frames == 3
            assert link.last_error is None


def test_tcpin_carries_frames_both_ways_with_every_client() -> None:
    port = free_port(socket.SOCK_STREAM)
    with opened(f"tcpin:127.0.0.1:{port}", SystemClock()) as link:
        assert not link.send(numbered_frame(0))
        assert not link.connected
        with (
            socket.create_connection(("127.0.0.1", port)) as first,
            socket.create_connection(("127.0.0.1", port)) as second,
        ):
            assert link.receive() == b""
            assert link.connected
            check_passes(link, 1, partial(read_exactly, first))
            assert frame_numbers(read_exactly(second, FRAME_BYTES)) == [1]
            first.sendall(numbered_frame(2))
            second.sendall(numbered_frame(3))
            assert sorted(frame_numbers(received_by(link, 2 * FRAME_BYTES))) == [2, 3]
            assert link.stats.sent_frames == 2
        until(lambda: link.receive() == b"" and not link.connected)
        assert not link.send(numbered_frame(4))
        assert link.last_error == f"tcpin:127.0.0.1:{port}: a client has left"


def test_small_frames_go_out_at_once() -> None:
    port = free_port(socket.SOCK_STREAM)
    with (
        opened(f"tcpin:127.0.0.1:{port}", StepClock()) as server,
        opened(f"tcp:127.0.0.1:{port}", StepClock()) as client,
    ):
        until(lambda: server.receive() == client.receive() and server.connected and client.connected)
        for tcp in (client._handle, *server._clients):  # type: ignore[attr-defined]
            assert tcp.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_frames_of_two_clients_do_not_cut_each_other() -> None:
    port = free_port(socket.SOCK_STREAM)
    with (
        opened(f"tcpin:127.0.0.1:{port}", StepClock()) as link,
        socket.create_connection(("127.0.0.1", port)) as first,
        socket.create_connection(("127.0.0.1", port)) as second,
    ):
        received = b""
        first.sendall(numbered_frame(0)[:30])
        second.sendall(numbered_frame(1) + numbered_frame(2)[:1])
        received += received_by(link, FRAME_BYTES)
        first.sendall(numbered_frame(0)[30:])
        received += received_by(link, FRAME_BYTES)
        second.sendall(numbered_frame(2)[1:])
        received += received_by(link, FRAME_BYTES)
        assert frame_numbers(received) == [1, 0, 2]


def test_tcp_finds_a_server_that_comes_late_and_backs_off_until_then() -> None:
    clock = StepClock()
    port = free_port(socket.SOCK_STREAM)
    with opened(f"tcp:127.0.0.1:{port}", clock) as link:
        timer = SendTimer(link)
        until(lambda: link.receive() == b"" and link.last_error is not None)
        assert link.last_error == f"tcp:127.0.0.1:{port}: Connection refused"
        for number in range(100):
            assert not timer.send(numbered_frame(number))
        timer.check()
        assert link.stats.dropped_frames == 100
        with serve(port) as server:
            link.receive()
            assert not link.connected  # 0.5 s have not passed
            clock.now_s += 0.5
            until(is_connected(link))
            peer, _ = server.accept()
            with peer:
                check_passes(link, 200, partial(read_exactly, peer))
        assert link.last_error is None
        assert link.stats.reconnects == 0


@pytest.mark.parametrize("abruptly", [False, True])
def test_tcp_returns_to_a_server_that_vanished(abruptly: bool) -> None:
    clock = StepClock()
    server = serve()
    port = server.getsockname()[1]
    with opened(f"tcp:127.0.0.1:{port}", clock) as link:
        until(is_connected(link))
        peer, _ = server.accept()
        if abruptly:  # a reset instead of an orderly end
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        peer.close()
        server.close()
        for number in range(50):
            link.send(numbered_frame(number))
            assert link.receive() == b""
        assert not link.connected
        assert link.last_error is not None
        clock.now_s += 0.5
        until(lambda: link.receive() == b"" and "Connection refused" in (link.last_error or ""))
        with serve(port) as server:
            clock.now_s += 1.0
            until(is_connected(link))
            peer, _ = server.accept()
            with peer:
                check_passes(link, 100, partial(read_exactly, peer))
        assert link.stats.reconnects == 1


def test_tcp_does_not_take_itself_for_the_server(monkeypatch: pytest.MonkeyPatch) -> None:
    """Linux can give a socket that connects to a free port of this computer that same port, and it connects."""

    class Unlucky(socket.socket):
        def connect(self, address: tuple[str, int]) -> None:  # type: ignore[override]
            if self.getsockname()[1] != address[1]:
                self.bind(address)
            super().connect(address)

    port = free_port(socket.SOCK_STREAM)
    monkeypatch.setattr(socket, "socket", Unlucky)
    with opened(f"tcp:127.0.0.1:{port}", StepClock()) as link:
        until(lambda: link.receive() == b"" and link.last_error is not None)
        assert not link.connected
        assert link.last_error == f"tcp:127.0.0.1:{port}: Connection refused"


def test_tcp_gives_up_a_host_that_does_not_answer() -> None:
    clock = StepClock()
    with socket.create_server(("127.0.0.1", 0), backlog=0) as server:
        address = server.getsockname()
        # With the queue of connections full, Linux answers no further request.
        queue = [socket.socket() for _ in range(3)]
        for waiting in queue:
            waiting.setblocking(False)
            waiting.connect_ex(address)
        with opened(f"tcp:127.0.0.1:{address[1]}", clock) as link:
            clock.now_s += CONNECT_DEADLINE_S - 0.1
            assert not link.send(numbered_frame(0))
            assert link.receive() == b""
            assert link.last_error is None
            clock.now_s += 0.2
            assert link.receive() == b""
            assert link.last_error == f"tcp:127.0.0.1:{address[1]}: no answer within 4 s"
        for waiting in queue:
            waiting.close()


def fill(link: Transport, timer: SendTimer, clock: StepClock, first_number: int = 0) -> int:
    """Send until nothing more is taken, counting from ``first_number``; return the next number."""
    number = first_number
    sent_before = -1
    while link.stats.sent_frames > sent_before:
        sent_before = link.stats.sent_frames
        for _ in range(500):
            timer.send(numbered_frame(number))
            number += 1
            clock.now_s += 0.001
    return number


def test_a_server_that_pauses_gets_whole_frames_and_then_the_newest() -> None:
    clock = StepClock()
    with serve() as server, opened(f"tcp:127.0.0.1:{server.getsockname()[1]}", clock) as link:
        until(is_connected(link))
        peer, _ = server.accept()
        peer.setblocking(False)
        with peer:
            timer = SendTimer(link)
            number = fill(link, timer, clock)
            timer.check()
            clock.now_s += 1.0
            resumed = number
            in_kernels = link.stats.sent_frames
            received = bytearray()

            def all_has_arrived() -> bool:
                nonlocal number
                if number < resumed + 20:
                    number += link.send(numbered_frame(number))
                assert link.receive() == b""
                with contextlib.suppress(BlockingIOError):
                    received.extend(peer.recv(65536))
                return received.endswith(numbered_frame(resumed + 19))

            until(all_has_arrived)
            numbers = frame_numbers(bytes(received))
            assert numbers == sorted(set(numbers))
            # All that waited was too old by then, but for a frame that had been begun.
            assert numbers[-20:] == list(range(resumed, resumed + 20))
            assert len(numbers) - 20 in (in_kernels, in_kernels + 1)
            assert link.stats.sent_frames == len(numbers)


def test_a_server_that_takes_nothing_is_left_and_found_again() -> None:
    clock = StepClock()
    with serve() as server, opened(f"tcp:127.0.0.1:{server.getsockname()[1]}", clock) as link:
        until(is_connected(link))
        peer, _ = server.accept()
        with peer:
            timer = SendTimer(link)
            number = fill(link, timer, clock)
            clock.now_s += STUCK_AFTER_S
            link.send(numbered_frame(number))
            link.receive()
            timer.check()
            assert not link.connected
            assert link.last_error is not None
            assert "has accepted nothing for 5 s" in link.last_error
        clock.now_s += 0.5
        until(is_connected(link))
        peer, _ = server.accept()
        with peer:
            check_passes(link, number + 1, partial(read_exactly, peer))


def test_a_client_that_never_reads_costs_the_others_nothing() -> None:
    clock = StepClock()
    port = free_port(socket.SOCK_STREAM)
    with (
        opened(f"tcpin:127.0.0.1:{port}", clock) as link,
        socket.socket() as silent,
        socket.create_connection(("127.0.0.1", port)) as reader,
    ):
        silent.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        silent.connect(("127.0.0.1", port))
        link.receive()
        timer = SendTimer(link)
        received = b""
        number = 0
        while link.last_error is None and number < 20000:
            assert timer.send(numbered_frame(number))
            received += read_exactly(reader, FRAME_BYTES)
            clock.now_s += 0.005
            number += 1
        timer.check()
        assert frame_numbers(received) == list(range(number))
        assert link.last_error is not None
        assert "has accepted nothing for 5 s" in link.last_error
        assert link.connected
        # Up to then 200 frames a second were dropped, but for those still within their deadline.
        assert link.stats.dropped_frames > (STUCK_AFTER_S - FRAME_DEADLINE_S) / 0.005


class Clients:
    """Clients of one ``tcpin`` link."""

    def __init__(self, link: Transport, port: int) -> None:
        self._link = link
        self._port = port
        self.sockets: list[socket.socket] = []

    def connect(self, count: int = 1) -> list[socket.socket]:
        new = [socket.create_connection(("127.0.0.1", self._port)) for _ in range(count)]
        self.sockets += new
        self._link.receive()
        return new

    def send(self, client: socket.socket, content: bytes) -> None:
        client.sendall(content)
        self._link.receive()

    def answered(self, clients: list[socket.socket]) -> list[bool]:
        """Who of them gets what the link sends; the others have been cut off."""
        self._link.send(numbered_frame(0))
        return [_gets_a_frame(client) for client in clients]


def _gets_a_frame(client: socket.socket) -> bool:
    client.settimeout(LIMIT_S)
    try:
        return bool(client.recv(FRAME_BYTES))
    except ConnectionError:
        return False


@pytest.fixture
def tcpin() -> Iterator[tuple[StepClock, Clients]]:
    port = free_port(socket.SOCK_STREAM)
    clock = StepClock()
    with opened(f"tcpin:127.0.0.1:{port}", clock) as link:
        clients = Clients(link, port)
        yield clock, clients
        for client in clients.sockets:
            client.close()


def test_tcpin_accepts_a_bounded_number_of_clients(tcpin: tuple[StepClock, Clients]) -> None:
    _, clients = tcpin
    clients.connect(MOST_CLIENTS + 2)
    clients._link.send(numbered_frame(0))
    assert clients._link.stats.sent_frames == MOST_CLIENTS


@pytest.mark.parametrize("content", [b"", b"x" * 20, b"\xfd" * 20])
def test_tcpin_drops_a_client_that_sends_no_mavlink(tcpin: tuple[StepClock, Clients], content: bytes) -> None:
    """Eight silent connections kept the autopilot out for ever."""
    clock, clients = tcpin
    (idle,) = clients.connect()
    (talker,) = clients.connect()
    for number in range(12):
        clients.send(idle, content)
        clients.send(talker, numbered_frame(number))
        if number < 9:
            assert clients.answered([idle, talker]) == [True, True]
        clock.now_s += 1.0
    assert clients.answered([idle, talker]) == [False, True]
    assert clients._link.last_error is not None
    assert "a client has sent no MAVLink for 10 s" in clients._link.last_error


def test_tcpin_never_gives_up_the_autopilot_for_a_newcomer(tcpin: tuple[StepClock, Clients]) -> None:
    clock, clients = tcpin
    silent = clients.connect(MOST_CLIENTS)
    (autopilot,) = clients.connect()
    beat = Component(7).heartbeat()
    clients.send(autopilot, beat)
    assert clients.answered([silent[0], autopilot, silent[-1]]) == [False, True, True]
    clock.now_s += 1.0
    clients.connect(2 * MOST_CLIENTS)
    clients._link.receive()
    assert clients.answered([autopilot, silent[-1]]) == [True, False]


def test_false_autopilots_that_came_first_do_not_keep_the_real_one_out(tcpin: tuple[StepClock, Clients]) -> None:
    """Eight connections with an autopilot's heartbeat were all that there are, for ever."""
    clock, clients = tcpin
    false = clients.connect(MOST_CLIENTS)
    for each in false:
        clients.send(each, Component(9).heartbeat())
    clock.now_s += 1.0
    (real,) = clients.connect()
    beat = Component(7).heartbeat()
    real.sendall(beat)
    assert received_by(clients._link, len(beat)) == beat
    for _ in range(20):
        for each in false:
            with contextlib.suppress(OSError):
                clients.send(each, Component(9).heartbeat())
        clock.now_s += 0.5
        clients.send(real, beat)
    assert clients.answered([real, false[0]]) == [True, True]
    clock.now_s += 0.1
    clients.send(real, beat)
    clients.connect(3)
    assert clients.answered([real, false[0]]) == [True, True], "the first and the one that sends most recently stay"


def test_tcpin_waits_for_a_port_that_another_program_has() -> None:
    clock = StepClock()
    other = serve()
    port = other.getsockname()[1]
    with opened(f"tcpin:127.0.0.1:{port}", clock) as link:
        assert link.last_error == f"tcpin:127.0.0.1:{port}: Address already in use"
        assert link.receive() == b""
        assert not link.send(numbered_frame(0))
        other.close()
        clock.now_s += 0.5
        link.receive()
        assert link.last_error is None
        with socket.create_connection(("127.0.0.1", port)) as client:
            link.receive()
            check_passes(link, 1, partial(read_exactly, client))


def test_tcpin_listens_again_at_once_after_a_restart() -> None:
    port = free_port(socket.SOCK_STREAM)
    for number in range(2):  # connections of the first round linger in the kernel
        with opened(f"tcpin:127.0.0.1:{port}", StepClock()) as link:
            assert link.last_error is None
            client = socket.create_connection(("127.0.0.1", port))
            link.receive()
            check_passes(link, number, partial(read_exactly, client))
        client.close()
