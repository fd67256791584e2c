"""Disk, date and supply of the computer."""

import os
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

from msp_range.doctor.computer import Computer
from msp_range.doctor.finding import UNKNOWN, Finding, first_of, unknown
from msp_range.recording.flight_recorder import START_FREE_BYTES
from msp_range.state_folder import SERVICE_USER

BYTES_PER_HOUR = 10e6
"""Size of an hour's recording of four sensors [bytes] (docs/flying.md)."""
SHORT_HOURS = 10
"""The disk is reported as nearly full with less than this left for recordings [h]."""
THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
"""The Raspberry Pi's bits: 0 the supply is too low now, 16 it was since the start."""
STRONGER = "a stronger 5 V supply and shorter wires"


def check_disk(computer: Computer, folder: str | None) -> Finding:
    """Whether recordings can be written."""
    step = "disk"
    if folder is None:
        return unknown(step, "nothing is recorded", "name a folder: recording: {folder: /var/lib/msp-range}")
    path = Path(folder)
    if not path.is_absolute():
        return unknown(step, f"{folder} is relative: it depends on where the bridge is started", "give the whole path")
    there = next(parent for parent in (path, *path.parents) if computer.at(parent).is_dir() or parent == parent.parent)
    who, disk = computer.user.name, computer.disk(computer.at(there))
    left = disk.f_bavail * disk.f_frsize
    is_refused, hours, left_mb = not computer.may_write(str(there)), left / BYTES_PER_HOUR, f"{left / 1e6:.0f} MB left"
    return first_of(
        step,
        (
            disk.f_flag & os.ST_RDONLY,
            f"{folder} is on a disk that is read-only",
            "mount it for writing, or name another folder",
        ),
        (
            is_refused and computer.owner(there) == SERVICE_USER,
            f"{there} belongs to {SERVICE_USER}, whose service may write there; {who} may not",
            "sudo msp-range doctor looks with the service's rights",
            UNKNOWN,
        ),
        (
            is_refused,
            f"{who} may not write into {there}, where {folder} is to be",
            f"sudo mkdir -p {folder} && sudo chown {who} {folder}",
        ),
        (left < START_FREE_BYTES, f"{folder} has {left_mb}: nothing would be recorded", "delete old recordings"),
        (hours < SHORT_HOURS, f"{folder} has {left_mb}, for {hours:.0f} hours", "delete old recordings", UNKNOWN),
        (True, f"{folder} has room for {hours:.0f} hours"),
    )


def check_date(computer: Computer, airframe_file: Path) -> Finding:
    """Whether the computer's date can be right: files and logs are named after it, distances are not."""
    return first_of(
        "date",
        (
            computer.utc_s() < airframe_file.stat().st_mtime - 86400,
            "the computer's date is before that of the airframe file: it has no clock, and none has set it",
            "connect it to a network once, or fit a clock module; recordings are undated till then",
        ),
        (computer.exists("/run/systemd/timesync/synchronized"), "set by the network"),
        (
            True,
            "not known to be set by the network",
            "timedatectl shows it; recordings may bear a wrong date",
            UNKNOWN,
        ),
    )


def check_supply(computer: Computer) -> Iterator[Finding]:
    """Whether a Raspberry Pi's supply is strong enough; nothing for another computer."""
    with suppress(ValueError):
        bits = int(computer.text(THROTTLED) or "", 16)
        yield first_of(
            "supply",
            (bits & 1, "the computer's supply voltage is too low now", STRONGER),
            (bits & 0x10000, "the computer's supply voltage was too low since the start", STRONGER),
            (True, "the computer's supply voltage was never too low"),
        )
