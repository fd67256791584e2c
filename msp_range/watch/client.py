"""The watcher's end of the socket: connect to a running bridge, and read its packets."""

import json
import socket
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from msp_range.recording.topics import Message
from msp_range.watch.newest import Newest

LONGEST_PACKET = 1 << 20
"""Bytes of a packet; the airframe of 117 sensors, the longest, takes 60 kB."""

ONCE_S = 1.0
"""Time for which packets are read to know the state once [s]: two turns of four sensors take as long."""
SILENT_S = 2.0
"""A bridge that sends nothing for so long does not answer, as one that was stopped by Ctrl-Z [s]: watchers get a status
twice a second. A preflight has 5 s."""


def connect(paths: Sequence[Path]) -> socket.socket | None:
    """A connection to the first bridge that is there; None where none is."""
    for path in paths:
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        try:
            connection.connect(str(path))
        except OSError:
            connection.close()
        else:
            return connection
    return None


def parsed(packet: bytes) -> Message:
    """The message of a packet."""
    return Message(**json.loads(packet))


def packets(connection: socket.socket) -> Iterator[Message]:
    """All packets until the bridge ends, or sends nothing within the connection's timeout."""
    with suppress(ConnectionResetError, TimeoutError):  # the first: it ended before it had read a mark
        while packet := connection.recv(LONGEST_PACKET):
            yield parsed(packet)


def read_once(connection: socket.socket) -> Newest:
    """The state when every sensor has had time for a reading, up to the status that follows."""
    newest = Newest()
    connection.settimeout(SILENT_S)
    first_s: float | None = None
    for packet in packets(connection):
        newest.update(packet)
        first_s = packet.time_s if first_s is None else first_s
        if packet.topic == "/status" and packet.time_s - first_s >= ONCE_S:
            break
    return newest
