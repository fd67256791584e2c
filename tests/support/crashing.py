"""A check for the fuzzing loop that fails in each way in which a reader can."""

import os
import random
import signal
from collections.abc import Callable
from pathlib import Path

kept: list[bytes] = []


def prepare(folder: Path) -> Callable[[bytes], None]:
    """The check: its input says how it fails."""
    return check


def check(data: bytes) -> None:
    """Raise, die, take memory, or nothing."""
    if data == b"raise":
        raise ValueError("no such thing")
    if data == b"die":
        os.kill(os.getpid(), signal.SIGSEGV)
    if data == b"take much":
        kept.append(bytes(int(3e8)))
    if data == b"grow":
        kept.append(random.Random(len(kept)).randbytes(500_000))
