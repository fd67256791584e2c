"""MAVLink 2 signing: frames go out signed, and only frames signed with the same key come in.

A signature is the first 48 bits of SHA-256 over key, frame, link id and a timestamp in units of 10 us since 2015, which
must rise from frame to frame, over restarts too (https://mavlink.io/en/guide/message_signing.html). A computer without
a battery for its clock starts in the past: so a time that is ahead of every frame sent is kept in a file.
"""

import hashlib
import hmac
import os
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from msp_range.clock import Clock
from msp_range.input_file import making, read_text
from msp_range.mavlink.frames import SIGNATURE_BYTES, Frame
from msp_range.state_folder import state_folder
from msp_range.yaml_file import ConfigError

TIME_NAME = "signing-time"
KEY_BYTES = 32
MOST_FILE_BYTES = 1_000_000
"""A file of a key or a time that is larger is refused unread: both take less than a hundred bytes."""
EPOCH_S = 1_420_070_400.0
"""2015-01-01 UTC, where timestamps begin [s since 1970]."""
UNITS_PER_S = 100_000
LATEST = 2**47
"""Timestamps from here on, which are of August 2059 and later, are not followed, whether they are received, kept in the
file or this computer's date: whoever follows one near the end of the six bytes has none left for the next frame. Half
of the range remains for them; a smaller limit would end signing sooner."""
PX4_SIGNS_NOT = "PX4 1.17 has no MAVLink signing: take link.signing_key out of the airframe file"
"""What to do where PX4 does not sign: in its 1.17 no key can help."""
NEW_STREAM_UNITS = 60 * UNITS_PER_S
"""A sender that was not received before may be this far behind: one minute, as the standard says."""
RESERVED_UNITS, RENEWED_UNITS = 60 * UNITS_PER_S, 30 * UNITS_PER_S
"""The kept time is this far ahead when it is written, and is written again when only the second is left. A restart
begins there: more would put the whole vehicle's time farther ahead of other programs', and at more than a minute they
would be refused; less writes to the disk more often than twice a minute."""


class Signing:
    """Signs and verifies the frames of one link.

    Parameters
    ----------
    key
        32 bytes.
    clock
        Its UTC dates the frames, where it is not behind the kept time.
    kept
        The time that an earlier run has kept; 0: none.
    keep
        Called with the time to keep; it may wait for the disk, and raise OSError.
    accepts_unsigned
        For setting a key up: the other side may not have it yet.

    Attributes
    ----------
    keeps_time : bool
        Whether the time could be kept when that was last tried.
    verified : int
        Frames received that were signed with this key.
    """

    keeps_time = True
    verified = 0

    def __init__(
        self,
        key: bytes,
        clock: Clock,
        kept: int = 0,
        keep: Callable[[int], None] = lambda timestamp: None,
        accepts_unsigned: bool = False,
    ) -> None:
        self._key = key
        self._clock = clock
        self._last = self._reserved = kept
        self._keep = keep
        self._keeping = threading.Lock()
        self._accepts_unsigned = accepts_unsigned
        self._streams: dict[tuple[int, int, int], int] = {}

    def timestamp(self) -> int:
        """A timestamp for the next frame: greater than all before, here and in earlier runs."""
        by_clock = int((self._clock.utc() - EPOCH_S) * UNITS_PER_S)
        self._last = max(self._last + 1, _possible(by_clock))
        if self._last > self._reserved - RENEWED_UNITS:
            self._reserved = self._last + RESERVED_UNITS
            threading.Thread(target=self._keep_reserved, name="signing", daemon=True).start()
        return self._last

    def sign_next(self, mav: Any) -> None:
        """Have a sender (pymavlink's ``MAVLink``) sign the next frame that it packs, as that of link 0."""
        mav.signing.secret_key, mav.signing.sign_outgoing, mav.signing.timestamp = self._key, True, self.timestamp()

    def accepts(self, frame: Frame) -> bool:
        """Whether a received frame may be used: its signature is right, and it is newer than those before."""
        data = frame.data
        if not frame.is_signed or not hmac.compare_digest(
            data[-6:], hashlib.sha256(self._key + data[:-6]).digest()[:6]
        ):
            return self._accepts_unsigned
        stream = (data[-SIGNATURE_BYTES], frame.system, frame.component)
        timestamp = int.from_bytes(data[-12:-6], "little")
        before = self._streams.get(stream, self._last - NEW_STREAM_UNITS)
        if not before < timestamp < LATEST:
            return False
        self._streams[stream] = timestamp
        self._last = max(self._last, timestamp)
        self.verified += 1
        return True

    def _keep_reserved(self) -> None:
        try:
            # One after the other: a slow disk must not end with the older of two times.
            with self._keeping:
                self._keep(self._reserved)
            self.keeps_time = True
        except OSError:
            self.keeps_time = False


def _possible(timestamp: int) -> int:
    """A timestamp; 0 instead of one that no clock shows."""
    return timestamp if 0 <= timestamp < LATEST else 0


def read_key(path: Path) -> bytes:
    """The key in a file of 64 hexadecimal digits, which nobody but its owner may read.

    Raises
    ------
    ConfigError
        It is not there or no regular file, others may read it, or it holds something else.
    """
    try:
        text = read_text(path, MOST_FILE_BYTES)
        mode = path.stat().st_mode & 0o777
        key = bytes.fromhex(text.strip())
    except OSError as error:
        raise ConfigError(f"{path}: {error.strerror}; 'msp-range sign' makes the key") from None
    except ValueError:
        key = b""
    if mode & 0o077:
        raise ConfigError(f"{path}: found mode {mode:o}; expected 600, since who can read the key can fly the vehicle")
    if len(key) != KEY_BYTES:
        raise ConfigError(f"{path}: expected {2 * KEY_BYTES} hexadecimal digits, a signing key")
    return key


def signing_of(key_file: str | None, clock: Clock, accepts_unsigned: bool = False) -> Signing | None:
    """Signing with the key in a file, and the time that this computer has kept; None without a key.

    Raises
    ------
    ConfigError
        The key cannot be used.
    """
    if key_file is None:
        return None
    key = read_key(Path(key_file))
    time_file = state_folder() / TIME_NAME
    kept = 0
    # Without the time, or with a damaged one, it signs by the clock, which is right where the clock is.
    with suppress(OSError, ValueError):
        kept = _possible(int(read_text(time_file, MOST_FILE_BYTES)))

    def keep(timestamp: int) -> None:
        time_file.parent.mkdir(parents=True, exist_ok=True)
        with making(time_file, replacing=True) as new, new.open("w", encoding="ascii") as file:
            file.write(str(timestamp))
            file.flush()
            os.fsync(file.fileno())

    return Signing(key, clock, kept, keep, accepts_unsigned)
