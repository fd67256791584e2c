"""Disk, date and supply of the computer."""

from pathlib import Path

from msp_range.doctor.computer import SERVICE_USER, Computer
from msp_range.doctor.finding import Finding, right, unknown, wrong

NEEDED_BYTES = 16 * 2**20
"""What a new recording wants, as msp_range/recording has it."""
BYTES_PER_HOUR = 10e6
"""Of four sensors (docs/flying.md)."""
SHORT_HOURS = 10
"""With less than this left the disk is reported as nearly full."""
DAY_S = 86400.0
THROTTLED = "/sys/devices/platform/soc/soc:firmware/get_throttled"
"""The Raspberry Pi's bits: 0 the supply is too low now, 16 it was since the start."""
SYNCHRONISED = "/run/systemd/timesync/synchronized"


def check_disk(computer: Computer, folder: str | None) -> Finding:
    """Whether recordings can be written."""
    step = "disk"
    if folder is None:
        return unknown(step, "nothing is recorded", "name a folder: recording: {folder: /var/lib/msp-range}")
    path = Path(folder)
    if not path.is_absolute():
        return unknown(step, f"{folder} is relative: it depends on where the bridge is started", "give the whole path")
    there = path
    while not computer.at(there).is_dir() and there != there.parent:
        there = there.parent
    if _is_read_only(computer, str(there)):
        return wrong(step, f"{folder} is on a disk that is read-only", "mount it for writing, or name another folder")
    if not computer.may_write(str(there)):
        who = computer.user.name
        if computer.owner(there) == SERVICE_USER:
            text = f"{there} belongs to {SERVICE_USER}, whose service may write there; {who} may not"
            return unknown(step, text, "sudo msp-range doctor looks with the service's rights")
        remedy = f"sudo mkdir -p {folder} && sudo chown {who} {folder}"
        return wrong(step, f"{who} may not write into {there}, where {folder} is to be", remedy)
    left = computer.free_bytes(computer.at(there))
    if left < NEEDED_BYTES:
        return wrong(step, f"{folder} has {left / 1e6:.0f} MB left: nothing would be recorded", "delete old recordings")
    hours = left / BYTES_PER_HOUR
    if hours < SHORT_HOURS:
        return unknown(step, f"{folder} has {left / 1e6:.0f} MB left, for {hours:.0f} hours", "delete old recordings")
    return right(step, f"{folder} has room for {hours:.0f} hours")


def _is_read_only(computer: Computer, path: str) -> bool:
    """By the mount with the longest path that leads there."""
    best, read_only = "", False
    for line in (computer.text("/proc/mounts") or "").splitlines():
        words = line.split()
        if len(words) < 4:
            continue
        place = words[1].rstrip("/")
        if (path == place or path.startswith(f"{place}/")) and len(place) >= len(best):
            best, read_only = place, "ro" in words[3].split(",")
    return read_only


def check_date(computer: Computer, airframe_file: Path) -> Finding:
    """Whether the computer's date can be right: files and logs are named after it, distances are not."""
    step = "date"
    if computer.utc_s() < airframe_file.stat().st_mtime - DAY_S:
        text = "the computer's date is before that of the airframe file: it has no clock, and none has set it"
        return wrong(
            step, text, "connect it to a network once, or fit a clock module; recordings are undated till then"
        )
    if computer.exists(SYNCHRONISED):
        return right(step, "set by the network")
    return unknown(step, "not known to be set by the network", "timedatectl shows it; recordings may bear a wrong date")


def check_supply(computer: Computer) -> Finding | None:
    """Whether a Raspberry Pi's supply is strong enough; None for another computer."""
    word = computer.text(THROTTLED)
    if word is None:
        return None
    try:
        bits = int(word, 16)
    except ValueError:
        return None
    if bits & 0x10001:
        when = "is too low now" if bits & 1 else "was too low since the start"
        return wrong("supply", f"the computer's supply voltage {when}", "a stronger 5 V supply and shorter wires")
    return right("supply", "the computer's supply voltage was never too low")
