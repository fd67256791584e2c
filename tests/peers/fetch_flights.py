"""Fetch the public flight logs of docs/logs.md: ``python -m tests.peers.fetch_flights FOLDER``.

Each file is taken from its repository at its commit and kept if its SHA-256 is the expected one. Needs the internet,
so no test runs it; tests/peers/test_public_logs.py reads what is in the folder that MSP_RANGE_FLIGHTS names.
"""

import hashlib
import http.client
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote
from urllib.request import urlopen

ADDRESS = "https://raw.githubusercontent.com"
"""Where a file of a repository is: ADDRESS/OWNER/NAME/COMMIT/PATH."""
TIMEOUT_S = 60.0
"""Give a file up when nothing arrives for so long [s]. They have 0.6 to 2.7 MB; a slow link sends something all the
time."""


@dataclass(frozen=True)
class Flight:
    """A file of a public repository: its place there, its commit, and what identifies its content."""

    repository: str
    commit: str
    path: str
    size: int
    sha256: str

    @property
    def name(self) -> str:
        """Its name, there and in the folder."""
        return self.path.rsplit("/", 1)[-1]


FLIGHTS = (
    Flight(
        "Auterion/px4-ulog-rs",
        "a11df05aef8b1ff0b442165951909751557d7dc4",
        "tests/fixtures/esc_status_log.ulg",
        621_491,
        "471f4af4b57a94adbeb7006f1994cbc4742f0510a5ae8bc562b41c125282e860",
    ),
    Flight(
        "clydemcqueen/orca4_1_tests",
        "2b9eadd66324eba675c36b31102601f657c031fa",
        "2023_10_18_mohai/00000014.BIN",
        2_633_728,
        "ed6299e625b503563e62d0df825177090bd9f580cf96b2beb9436d11239be0ea",
    ),
    Flight(
        "andy8901/drone-log-analyzer",
        "89d3a92f32b18759e82419ad5b59657df9bcf6f8",
        "uploads/log_11_2026-6-3-09-17-42.bin",
        1_445_888,
        "66586656e6131f14446ec959eca0738263993e06f4c8894cfb73f98d1e3ffa17",
    ),
    Flight(
        "Mercy2Green/UAV-Flight-Datatset",
        "02262cac38d514b79852abdecff4c3114329931b",
        "Large/log_82_2022-12-1-15-26-52.ulg",
        1_856_652,
        "9823db2c0836fbb02d55aa31ffde60d301d2a941196baa9f0720435c2642f87c",
    ),
    Flight(
        "clydemcqueen/ardusub_log_tools",
        "2b7c8b137e265b2fc3d75659390628ede9b5b6aa",
        "pymavlink_bug/2023-04-18 11-03-34.tlog",
        2_013_370,
        "7cd8f734b8099c5a1d4c0a26935329516c4dd322917c6caad66f278640c55320",
    ),
)


def fetch(flight: Flight, folder: Path, address: str = ADDRESS) -> str:
    """Fetch a log into a folder, unless it is there.

    Returns
    -------
    str
        Why it could not be fetched; empty: it is there, with the expected SHA-256.
    """
    path = folder / flight.name
    if path.is_file() and hashlib.sha256(path.read_bytes()).hexdigest() == flight.sha256:
        return ""
    place = f"{address}/{flight.repository}/{flight.commit}/{quote(flight.path)}"
    try:
        with urlopen(place, timeout=TIMEOUT_S) as answer:
            # One byte more than expected is enough to see that it is another file.
            content = answer.read(flight.size + 1)
        found = hashlib.sha256(content).hexdigest()
        if found != flight.sha256:
            return f"{place}: found sha256 {found}, expected {flight.sha256}"
        folder.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    except (OSError, http.client.HTTPException) as error:
        return f"{place}: {error}"
    return ""


def main(arguments: Sequence[str], address: str = ADDRESS) -> int:
    """Fetch all logs, print a line for each, and return 1 if any is missing."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        print("usage: python -m tests.peers.fetch_flights FOLDER", file=sys.stderr)
        return 2
    reasons = {flight: fetch(flight, Path(arguments[0]), address) for flight in FLIGHTS}
    for flight, reason in reasons.items():
        print(f"{flight.name}: {reason or 'is there'}", file=sys.stderr if reason else sys.stdout)
    return 1 if any(reasons.values()) else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
