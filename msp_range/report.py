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
RECORDING_BYTES = 20_000_000
"""Largest part of a recording [bytes]: what most mail servers take, and two hours of four sensors. Where the file is
larger its end is left out, and `msp-range recover` reads the rest."""
JOURNAL = ("journalctl", "--unit=msp-range", "--lines=5000", "--no-pager", "--output=short-iso")
"""The service's journal: 5000 lines are some days of a bench, or all that a bad day writes."""
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
            try:
                for name, content, note in part(path, computer, clock):
                    archive.writestr(name, SECRET.sub(REMOVED, content) if isinstance(content, str) else content)
                    listed.append(f"{name}: {note}, {len(content) / 1e3:.1f} kB")
                    yield listed[-1]
            except Exception as error:  # whatever it is, the other parts are of use without this one
                listed.append(printable(f"{part.__name__[1:]}: not in it: {error}"))
                yield listed[-1]
        archive.writestr("contents.txt", "\n".join(listed) + "\n")
    yield f"written: {out}. Values of keys, tokens and passwords are removed from its texts; look before you send it"


Part = Iterator[tuple[str, str | bytes, str]]
"""Files of a part: name in the archive, content, what it is."""


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
    yield "journal.txt", done.stdout + done.stderr, "the service's journal, its last 5000 lines"


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
    settings = load_airframe(path).recording
    newest = None if settings is None else newest_recording(settings.folder)
    if newest is None:
        raise ConfigError("there is none")
    with newest.open("rb") as file:
        content = file.read(RECORDING_BYTES)
    left = newest.stat().st_size - len(content)
    note = f"; its last {left / 1e6:.1f} MB are left out" if left > 0 else ""
    yield newest.name, content, f"the last recording{note}, as it was written, with its airframe file"
