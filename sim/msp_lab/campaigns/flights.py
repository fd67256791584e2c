"""A campaign in the air: flights whose readings the bridge records itself, and the truth from another instrument.

From a campaign file of flights, and for each flight a recording of `msp-range run` and a table of the reference, it
makes the same table of readings as from a bench. Recordings and references are copied and never changed.
"""

import os
import re
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from pydantic import Field, model_validator
from rich.console import Console

from msp_lab.campaigns.campaign import Reference, repeated
from msp_lab.campaigns.store import READINGS_NAME, check_no_table
from msp_lab.logs.log import between_samples
from msp_range.arrays import Column
from msp_range.config import NamedAirframe
from msp_range.input_file import open_input
from msp_range.recording.csv_form import MeasuredData, join_tables, read_csv, write_csv
from msp_range.recording.error import RecordingError, new_file
from msp_range.recording.export import measured_data
from msp_range.recording.reader import LARGEST_FILE_BYTES, Recording
from msp_range.sensor_on_bus import Name
from msp_range.yaml_file import Section, config_path, load, read_yaml
from msp_sim.terminal import make_folder

GAP_S = 1.0
"""The true range is unknown between two values of the reference that are farther apart [s]: at 1 m/s it changes by a
metre. A larger gap interpolates over manoeuvres, a smaller one drops the readings of a slow reference."""
SCENARIO = "scenario"
TRUTH, TIME, UTC = "true_range_cm", "time_s", "utc_s"


class Flight(Section):
    """One flight of a campaign."""

    flight: Name
    """a name of its own; it is the condition of its readings"""
    question: str = ""
    """the question that it answers"""
    how: str = Field(min_length=1)
    """what the pilot does"""
    target: str = Field(min_length=1)
    """the surface below, a word"""
    scenario: str | None = None
    """scenario file that the simulator flies in its place, relative to this file"""


class FlightCampaign(Section):
    """A campaign file of flights."""

    campaign: Name
    """a name of its own: small letters, digits and underscores"""
    purpose: str = ""
    """what it is for"""
    reference: Reference
    """what the readings are compared with"""
    airframe: NamedAirframe
    """airframe file of the vehicle, relative to this file"""
    flights: tuple[Flight, ...] = Field(min_length=1)
    """the flights, in the order in which they are flown"""

    @model_validator(mode="after")
    def _once_each(self) -> "FlightCampaign":
        if twice := repeated(flight.flight for flight in self.flights):
            raise ValueError(f"flights: flight {twice[0]} is given more than once; each needs its own name")
        return self


def load_flights(path: Path | str) -> FlightCampaign:
    """Read a campaign file of flights and the airframe file that it names.

    Raises
    ------
    ConfigError
        The file cannot be read or used; one line per error.
    """
    return load(config_path(path, "campaigns"), FlightCampaign)


def is_of_flights(path: Path | str) -> bool:
    """Whether a campaign file is one of flights.

    Raises
    ------
    ConfigError
        It cannot be read.
    """
    content = read_yaml(config_path(path, "campaigns"))
    return isinstance(content, dict) and "flights" in content


class FlightArchive:
    """The folder of a flight campaign: ``flights/<flight>-001.mcap`` with its reference, and ``readings.csv``.

    If a flight was flown several times, the last recording is used. Recordings and references are only added. One that
    is not wanted can be deleted; its number is not used again while there are later ones.

    Raises
    ------
    RecordingError
        There is a ``readings.csv`` that was not made from recordings of these flights.
    """

    def __init__(self, folder: Path, campaign: FlightCampaign) -> None:
        self.folder = folder
        self._campaign = campaign
        if not any(self.recordings(flight) for flight in campaign.flights):
            check_no_table(folder, f"recording of these flights in {folder / 'flights'}")

    def recordings(self, flight: Flight) -> list[Path]:
        """Return the recordings of a flight in their order."""
        return [path for _, path in sorted(self._numbered(flight)) if path.suffix == ".mcap"]

    def _numbered(self, flight: Flight) -> list[tuple[int, Path]]:
        """Recordings and references of a flight with their numbers, in any order."""
        pattern = re.compile(re.escape(flight.flight) + r"-(\d{3,})(\.mcap|\.reference\.csv)")
        paths = (self.folder / "flights").glob("*")
        return [(int(found[1]), path) for path in paths if (found := pattern.fullmatch(path.name))]

    @contextmanager
    def making(self, flight: Flight) -> Iterator[Path]:
        """Give the path for the next recording of a flight; it gets its name when it is complete."""
        self._refuse_other_kind(simulated=True)
        with new_file(self._next_path(flight)) as unfinished:
            yield unfinished

    def _refuse_other_kind(self, *, simulated: bool) -> None:
        """Refuse where there are flights of the other kind already; the simulator names its scenario in a recording."""
        for flight in self._campaign.flights:
            for path in self.recordings(flight):
                if (SCENARIO in Recording(path).metadata) != simulated:
                    kind = "real" if simulated else "simulated"
                    raise RecordingError(f"{path}: a recording of a {kind} flight; name another folder with --out")

    def _next_path(self, flight: Flight) -> Path:
        folder = self.folder / "flights"
        make_folder(folder)
        # A reference whose recording was deleted must not become that of the next one.
        last = max((number for number, _ in self._numbered(flight)), default=0)
        return folder / f"{flight.flight}-{last + 1:03d}.mcap"

    def keep(self, flight: Flight, recording: Path, reference: Path | None) -> None:
        """Check a flight's recording and the table of its reference, and copy both.

        Raises
        ------
        RecordingError
            One cannot be read, has no usable content, is of a simulated flight, or cannot be copied.
        """
        recorded = Recording(recording)
        if SCENARIO in recorded.metadata:
            raise RecordingError(
                f"{recording}: a recording of a simulated flight, expected one of msp-range run; --simulate flies and "
                "keeps simulated ones, in a folder of their own"
            )
        data = measured_data(recorded, faults=False)
        if not len(data):
            raise RecordingError(f"{recording}: contains no readings")
        if reference is not None:
            known = ~np.isnan(truth_at(data["time_s"], recorded, reference))
            if not known.any():
                raise RecordingError(f"{reference}: its times do not overlap with those of {recording}")
        self._refuse_other_kind(simulated=False)
        path = self._next_path(flight)
        if reference is not None:
            # First: a recording without its reference would look complete.
            _copy(reference, path.with_suffix(".reference.csv"))
        _copy(recording, path)

    def readings(self) -> MeasuredData:
        """Return the readings of every flight's last recording, in the order of the campaign."""
        recorded = [(flight, self.recordings(flight)) for flight in self._campaign.flights]
        return join_tables([self._of(flight, paths[-1]) for flight, paths in recorded if paths])

    def write_table(self) -> tuple[Path, int]:
        """Write ``readings.csv``; return its path and its number of rows."""
        path, data = self.folder / READINGS_NAME, self.readings()
        write_csv(path, data, replacing=True)
        return path, len(data)

    def _of(self, flight: Flight, path: Path) -> MeasuredData:
        recording = Recording(path)
        data = measured_data(recording, faults=False)
        columns = dict(data.columns)
        columns["condition"] = np.full(len(data), flight.flight)
        if "target" not in columns:
            columns["target"] = np.full(len(data), flight.target)
        reference = path.with_suffix(".reference.csv")
        if reference.exists():
            columns[TRUTH] = truth_at(data["time_s"], recording, reference)
        return MeasuredData(columns)


def truth_at(time_s: Column, recording: Recording, reference: Path) -> Column:
    """The reference's range [cm] at times on the bridge's clock [s], NaN where it is unknown.

    Parameters
    ----------
    time_s
        Times of the echoes, shape (n,).
    recording
        Gives the UTC of its times.
    reference
        CSV with ``true_range_cm`` and either ``time_s`` on the bridge's clock or ``utc_s``, seconds since 1970.

    Returns
    -------
    ndarray, shape (n,)
        Linear between two values that are at most `GAP_S` apart.

    Raises
    ------
    RecordingError
        The table cannot be read, has no times, or they go backwards.
    """
    table = read_csv(reference, required=(TRUTH,))
    if TIME not in table and UTC not in table:
        raise RecordingError(f"{reference}: found no column {TIME} (the bridge's clock) nor {UTC} (since 1970)")
    known = ~np.isnan(table[TRUTH])
    their_s = table[TIME if TIME in table else UTC][known]
    if their_s.size < 2 or (np.diff(their_s) <= 0).any():
        raise RecordingError(
            f"{reference}: found times that do not increase, or fewer than two; expected increasing times"
        )
    asked_s = time_s if TIME in table else time_s + recording.utc_s(0.0)
    return between_samples(asked_s, their_s, table[TRUTH][known], GAP_S)


def show_flights(campaign: FlightCampaign, archive: FlightArchive, console: Console) -> None:
    """Print the flights, and which are recorded."""
    for number, flight in enumerate(campaign.flights, start=1):
        mark = "   recorded" if archive.recordings(flight) else ""
        console.print(f"{number:4d}  {flight.flight}{mark}")
        console.print(f"        {flight.question}\n        Over {flight.target}: {flight.how}", style="dim")
    console.print(f"The reference: {campaign.reference.method}")


def collect_flights(
    campaign: FlightCampaign, archive: FlightArchive, console: Console, ask: Callable[[str], str]
) -> None:
    """Lead a person through the flights: what to fly, then the paths of the recording and the reference."""
    for number, flight in enumerate(campaign.flights, start=1):
        if archive.recordings(flight):
            continue
        console.print(f"\n{number} of {len(campaign.flights)}: {flight.flight}", style="bold")
        console.print(f"{flight.question}\n  Over {flight.target}: {flight.how}")
        console.print(f"  The reference: {campaign.reference.method}")
        console.print("  Record it with: msp-range run AIRFRAME.yaml --record FOLDER")
        while True:
            answer = ask("  The recording (.mcap).  s: later.  q: stop > ").strip()
            if answer in ("s", "q"):
                break
            reference = ask("  Table of the reference (.csv), Enter: none > ").strip()
            if reference == "q":
                answer = "q"
                break
            try:
                archive.keep(flight, Path(answer), Path(reference) if reference else None)
                break
            except RecordingError as error:
                console.print(f"  {error}", style="yellow")
        if answer == "q":
            return


def _copy(source: Path, path: Path) -> None:
    """Copy a file completely or not at all."""
    with (
        new_file(path) as unfinished,
        open_input(source, LARGEST_FILE_BYTES) as read,
        unfinished.open("wb") as written,
    ):
        shutil.copyfileobj(read, written)
        written.flush()
        os.fsync(written.fileno())
