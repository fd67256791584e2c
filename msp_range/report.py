"""`msp-range report`: one archive with what somebody who helps needs to know, and the list of what is in it.

A part that is missing is named in the list with the reason, and the others are there all the same.
"""

import json
import platform
import re
import subprocess
from collections.abc import Iterator
from importlib.metadata import distributions
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile

from msp_range import __version__
from msp_range.clock import Clock, stamp_of
from msp_range.config import AIRFRAME_NAME, load_airframe
from msp_range.doctor.command import text_of
from msp_range.doctor.computer import Computer
from msp_range.doctor.examination import examine
from msp_range.input_file import printable
from msp_range.recording.error import new_file
from msp_range.recording.reader import newest_recording
from msp_range.state_folder import SERVICE_FOLDER
from msp_range.terminal import wrapped
from msp_range.watch.client import connect, read_once
from msp_range.watch.place import sockets
from msp_range.watch.terminal import as_object
from msp_range.yaml_file import ConfigError, read_config

SECRET = re.compile(
    r"""((?:key|token|secret|passw\w*|passphrase)["']?\s*[:=]\s*)("[^"]*"|'[^']*'|[^\s,}&]+)|\b[0-9a-f]{64}\b""", re.I
)
"""A value with the name of a secret, in YAML, JSON or an address of the page; and the 32 bytes of a signing key."""
REMOVED = r"\1(removed)"
RECORDING_BYTES = 15_000_000
"""Largest part of a recording [bytes]: 20.5 MB in a mail, where base64 makes 4 bytes of 3, and so below the 25 MB that
servers usually take. Of a larger file the middle is left out, since what is reported happened at its end;
`msp-range recover` reads the rest. More would not arrive by mail, less would show less of what led to it."""
BEGINNING_BYTES = 1_000_000
"""What of a larger recording's beginning is kept [bytes]: it has the airframe file and the form of each topic, without
which the end cannot be read. It is minutes of four sensors; a topic whose first message comes later is lost."""
JOURNAL = ("journalctl", "--unit=msp-range", "--unit=msp-range-web", "--lines=5000", "--no-pager", "--output=short-iso")
"""The journal of bridge and page: 5000 lines are some days of a bench, or all that a bad day writes."""
JOURNAL_S = 20.0


def write_report(path: Path, out: Path | None, computer: Computer, clock: Clock) -> Iterator[str]:
    """Write the archive; gives each line of its list as soon as it is known.

    Parameters
    ----------
    path
        The airframe file.
    out
        The archive; None: a file in the working folder, with the date in its name.

    Raises
    ------
    RecordingError
        There is such a file already, or it cannot be written.
    """
    out = out or Path(f"msp-range-report-{stamp_of(clock.utc())}.zip")
    listed = []
    with new_file(out) as unfinished, ZipFile(unfinished, "w", ZIP_DEFLATED) as archive:
        for part in (_airframe, _sensors, _versions, _journal, _doctor, _status, _recording):
            found, failure = _collected(part(path, computer, clock))
            for name, content, note in found:
                archive.writestr(name, SECRET.sub(REMOVED, content) if isinstance(content, str) else content)
                listed.append(f"{name}: {note}, {len(content) / 1e3:.1f} kB")
                yield listed[-1]
            if failure is not None:
                listed.append(printable(f"{part.__name__[1:]}: not in it: {failure}"))
                yield listed[-1]
        archive.writestr("contents.txt", "\n".join(listed) + "\n")
    yield f"written: {out}. Values of keys, tokens and passwords are removed from its texts; look before you send it"


File = tuple[str, str | bytes, str]
"""Name in the archive, content, what it is."""
Part = Iterator[File]


def _collected(part: Part) -> tuple[list[File], Exception | None]:
    """Files of a part, and the error that ended it."""
    found: list[File] = []
    try:
        found.extend(part)
    except Exception as error:  # whatever it is, the other parts are of use without this one
        return found, error
    return found, None


def _airframe(path: Path, *_: object) -> Part:
    yield AIRFRAME_NAME, read_config(path), f"the airframe file {path}"


def _sensors(path: Path, *_: object) -> Part:
    for name, text in load_airframe(path).files.items():
        if name != AIRFRAME_NAME:
            yield f"sensors/{Path(name).name}", text, "sensor model"


def _versions(_: Path, computer: Computer, __: Clock) -> Part:
    packages = sorted(f"{each.name} {each.version}" for each in distributions())
    system, board = (computer.text(path) or "" for path in ("/etc/os-release", "/proc/device-tree/model"))
    lines = (f"msp-range {__version__}", f"Python {platform.python_version()}", platform.platform(), board, system)
    yield "versions.txt", "\n".join([*lines, *packages]), "versions of programs, packages, kernel and board"


def _journal(*_: object) -> Part:
    done = subprocess.run(JOURNAL, capture_output=True, timeout=JOURNAL_S, text=True, errors="replace")
    if done.returncode != 0 and not done.stdout:
        raise ConfigError(f"journalctl: exit code {done.returncode}: {done.stderr.strip()}")
    ending = f", where journalctl ended with exit code {done.returncode}" if done.returncode != 0 else ""
    yield "journal.txt", done.stdout + done.stderr, f"journal of the service and its page, the last 5000 lines{ending}"


def _doctor(path: Path, computer: Computer, clock: Clock) -> Part:
    lines = [line for finding in examine(path, computer, clock) for line in wrapped(text_of(finding))]
    yield "doctor.txt", "\n".join(lines), "what msp-range doctor finds"


def _status(*_: object) -> Part:
    connection = connect(sockets())
    if connection is None:
        raise ConfigError("no bridge runs")
    with connection:
        yield "status.json", json.dumps(as_object(read_once(connection)), indent=1), "what msp-range status shows"


def _recording(path: Path, *_: object) -> Part:
    files = [each for folder in _folders(path) if (each := newest_recording(str(folder))) is not None]
    if not files:
        raise ConfigError("there is none")
    newest = max(files, key=lambda each: each.stat().st_mtime)
    left = newest.stat().st_size - RECORDING_BYTES
    with newest.open("rb") as file:
        content = file.read(RECORDING_BYTES if left <= 0 else BEGINNING_BYTES)
        if left > 0:
            file.seek(BEGINNING_BYTES + left)
            content += file.read(RECORDING_BYTES - BEGINNING_BYTES)
    note = f"; {left / 1e6:.1f} MB of its middle are left out: msp-range recover reads the rest" if left > 0 else ""
    yield newest.name, content, f"the last recording{note}, as it was written, with its airframe file"


def _folders(path: Path) -> list[Path]:
    """Where the last recording may be; a relative folder is the service's or one of this working folder."""
    try:
        settings = load_airframe(path).recording
    except ConfigError:  # the list has the error already; the service's bridge ran before the file was broken
        return [SERVICE_FOLDER, *(each for each in SERVICE_FOLDER.glob("*") if each.is_dir())]
    return [] if settings is None else [Path(settings.folder), SERVICE_FOLDER / settings.folder]
