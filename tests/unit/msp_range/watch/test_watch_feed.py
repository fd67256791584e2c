"""The feed of a running bridge: what watchers get, and that none of them can hold it up."""

import json
import os
import resource
import socket
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from typing import Any

import pytest

from msp_range.watch import client
from msp_range.watch import feed as feed_module
from msp_range.watch.client import LONGEST_PACKET, connect
from msp_range.watch.feed import LONGEST_MARK, MOST_WATCHERS, Feed, FeedError
from tests.support.waiting import LIMIT_S

MESSAGE = {"time_s": 1.0, "status": "ok", "range_m": 2.5}


@pytest.fixture
def path() -> Iterator[Path]:
    with TemporaryDirectory(prefix="msp-") as folder:
        yield Path(folder) / "new" / "status.sock"


@pytest.fixture
def marks() -> list[tuple[float, str]]:
    return []


@pytest.fixture
def feed(path: Path, marks: list[tuple[float, str]]) -> Iterator[Feed]:
    made = Feed(path, lambda: {"vehicle": "quad"}, lambda time_s, text: marks.append((time_s, text)))
    yield made
    made.close()


def watching(feed: Feed, now_s: float = 0.0) -> socket.socket:
    watcher = connect([feed.path])
    assert watcher is not None
    watcher.settimeout(LIMIT_S)
    feed.service(now_s)
    return watcher


def received(watcher: socket.socket) -> dict[str, Any]:
    packet: dict[str, Any] = json.loads(watcher.recv(LONGEST_PACKET))
    return packet


def test_a_watcher_gets_the_airframe_and_then_what_is_published(feed: Feed) -> None:
    assert not feed.is_watched
    feed.publish("/range/a", 1.0, MESSAGE)
    with watching(feed) as watcher:
        assert feed.is_watched
        feed.publish("/range/a", 2.0, MESSAGE)
        assert received(watcher) == {"topic": "/airframe", "time_s": 0.0, "message": {"vehicle": "quad"}}
        assert received(watcher) == {"topic": "/range/a", "time_s": 2.0, "message": MESSAGE}


def test_a_bridge_that_has_been_stopped_is_not_waited_for(feed: Feed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client, "SILENT_S", 0.1)
    with watching(feed) as watcher:
        assert client.read_once(watcher).status == {}


def test_others_may_watch_where_the_folder_lets_them(feed: Feed) -> None:
    assert feed.path.parent.stat().st_mode & 0o777 == 0o700
    assert feed.path.stat().st_mode & 0o777 == 0o666


def test_nobody_is_waited_for(feed: Feed) -> None:
    """Each wait would be the bridge's; a thread, because an endless one would be the test's."""

    def look() -> None:
        for number in range(200):
            feed.service(float(number))

    with watching(feed):
        looking = Thread(target=look, daemon=True)
        looking.start()
        looking.join(LIMIT_S)
        assert not looking.is_alive()


def test_a_computer_with_too_many_open_files_has_its_watcher_later(feed: Feed) -> None:
    most, limit = resource.getrlimit(resource.RLIMIT_NOFILE)
    with connect([feed.path]) or pytest.fail("no socket"):
        resource.setrlimit(resource.RLIMIT_NOFILE, (0, limit))
        try:
            feed.service(0.0)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, (most, limit))
        assert not feed.is_watched
        feed.service(1.0)
        assert feed.is_watched


def test_a_number_that_is_not_known_is_null_and_packets_stay_json(feed: Feed) -> None:
    """A browser cannot read NaN."""
    with watching(feed) as watcher:
        received(watcher)
        feed.publish("/fused", 1.0, {"range_m": float("nan"), "variance_m2": float("inf")})
        assert received(watcher)["message"] == {"range_m": None, "variance_m2": None}


def test_a_watcher_that_reads_nothing_loses_packets_and_others_do_not(feed: Feed) -> None:
    with watching(feed) as lazy, watching(feed, 1.0) as keen:
        received(keen)
        for number in range(5000):
            feed.publish("/range/a", float(number), MESSAGE)
            assert received(keen)["time_s"] == number
        received(lazy)
        lazy.setblocking(False)
        times_s = []
        with suppress(BlockingIOError):
            while True:
                times_s.append(received(lazy)["time_s"])
        # What it gets is whole, and from before it was full.
        assert 0 < len(times_s) < 5000
        assert times_s == [float(number) for number in range(len(times_s))]


def test_no_user_of_the_computer_keeps_the_others_out(feed: Feed, monkeypatch: pytest.MonkeyPatch) -> None:
    """Eight connections of one program were all that there are."""
    users: dict[socket.socket, int] = {}
    real_user_of = feed_module._user_of

    def user_of(watcher: socket.socket) -> int:
        assert real_user_of(watcher) == os.getuid()
        return users.setdefault(watcher, user)

    monkeypatch.setattr(feed_module, "_user_of", user_of)
    with ExitStack() as stack:

        def comes() -> socket.socket:
            watcher: socket.socket = stack.enter_context(watching(feed))
            return watcher

        def is_served(watcher: socket.socket) -> bool:
            try:
                return bool(watcher.recv(LONGEST_PACKET))
            except ConnectionError:
                return False

        user = 1000
        greedy = [comes() for _ in range(MOST_WATCHERS)]
        assert all(map(is_served, greedy))
        assert not is_served(comes())
        user_of_first = list(map(feed_module._user_of, feed._watchers))
        assert user_of_first == [1000] * MOST_WATCHERS
        greedy[1].send(b'{"mark": "unread"}')
        user = 0
        own = [comes() for _ in range(3)]
        assert all(map(is_served, own))
        feed.publish("/range/a", 1.0, MESSAGE)
        assert all(map(is_served, [*own, *greedy[3:]]))
        assert not any(map(is_served, greedy[:3]))
        own.append(comes())
        user = 1
        comes()
        assert sorted(Counter(map(feed_module._user_of, feed._watchers)).values()) == [1, 3, 4]
        user = 0
        assert not is_served(comes())
        user = 1000
        assert not is_served(comes()), "nobody takes a place to have as many as the other had"


def test_a_watcher_that_goes_is_forgotten(feed: Feed) -> None:
    watching(feed).close()
    feed.publish("/range/a", 1.0, MESSAGE)
    assert not feed.is_watched
    watching(feed, 1.0).close()
    feed.service(2.0)
    assert not feed.is_watched


def test_the_number_of_watchers_is_limited(feed: Feed) -> None:
    watchers = [watching(feed, float(number)) for number in range(MOST_WATCHERS)]
    with watching(feed, 100.0) as refused:
        assert refused.recv(LONGEST_PACKET) == b""
    for each in watchers:
        assert received(each)["topic"] == "/airframe"
        each.close()


def test_marks_are_passed_on_in_plain_text_and_at_a_limited_rate(feed: Feed, marks: list[tuple[float, str]]) -> None:
    with watching(feed), watching(feed) as watcher:
        for number, text in enumerate(["over the box", "too soon", "\x1b[31mred " + 200 * "x"]):
            watcher.send(json.dumps({"mark": text}).encode())
            feed.service(1.0 + 0.3 * number)
    assert marks[0] == (1.0, "over the box")
    assert len(marks) == 2
    assert marks[1][0] == 1.6
    assert "\x1b" not in marks[1][1]
    assert len(marks[1][1]) == LONGEST_MARK


@pytest.mark.parametrize(
    "packet",
    [b"{", b"[]", b'{"mark": 5}', b'{"mark": ""}', b'{"other": "x"}', b"[" * 4000, b"\xff\xfe", b'"mark"'],
)
def test_anything_else_from_a_watcher_is_ignored(feed: Feed, marks: list[tuple[float, str]], packet: bytes) -> None:
    with watching(feed) as watcher:
        watcher.send(packet)
        feed.service(1.0)
        assert feed.is_watched
    assert marks == []


def test_a_socket_that_was_left_behind_is_replaced_and_one_in_use_is_not(path: Path) -> None:
    path.parent.mkdir()
    with socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET) as killed:
        killed.bind(str(path))
    first = Feed(path, dict, lambda time_s, text: None)
    with pytest.raises(FeedError, match="another bridge is watched there"):
        Feed(path, dict, lambda time_s, text: None)
    first.service(0.0)  # The other bridge came, and went.
    with watching(first) as watcher:
        assert received(watcher)["topic"] == "/airframe"
    first.close()
    assert not path.exists()
    assert connect([path]) is None


def test_a_path_that_cannot_be_used_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(FeedError, match="nobody can watch this bridge"):
        Feed(Path("/proc/none/status.sock"), dict, lambda time_s, text: None)
    with pytest.raises(FeedError, match="too long"):
        Feed(tmp_path / (200 * "x") / "status.sock", dict, lambda time_s, text: None)


def test_in_a_folder_of_somebody_else_there_is_no_feed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Who owns the folder could put a socket of his own there."""
    folder = tmp_path / "taken"
    folder.mkdir()
    if os.geteuid() == 0:
        os.chown(folder, 4242, -1)
    else:
        monkeypatch.setattr(os, "geteuid", lambda: os.getuid() + 1)
    with pytest.raises(FeedError, match="belongs to another user"):
        Feed(folder / "status.sock", dict, lambda time_s, text: None)
