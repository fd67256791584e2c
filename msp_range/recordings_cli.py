"""The commands of msp-range that work on recordings: replay, tune, recover, export and layout."""

from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from msp_range.yaml_file import ConfigError, write_file

RecordingFile = Annotated[Path, Argument(metavar="FILE.mcap", help="a recording")]


def replay(
    file: Annotated[Path, Argument(metavar="FILE", help="a recording (.mcap), or measured readings (.csv)")],
    airframe_file: Annotated[
        Path | None,
        Option("--airframe", help="airframe file; default: the one in the recording. Required for a CSV file"),
    ] = None,
    run_name: Annotated[str | None, Option("--run", help="the run to replay, for a CSV file with several")] = None,
    record: Annotated[Path | None, Option(help="new recording to write (.mcap)")] = None,
    link: Annotated[str | None, Option(help="link URL to send on; default: none")] = None,
    realtime: Annotated[bool, Option("--realtime", help="replay in real time")] = False,
) -> None:
    """Play recorded or measured readings through the bridge again, and show the results."""
    from msp_range import replay as replaying
    from msp_range.clock import SystemClock, VirtualClock
    from msp_range.config import load_airframe, load_airframe_from
    from msp_range.mavlink.transport import open_transport
    from msp_range.recording.pings import read_recorded
    from msp_range.recording.reader import Recording, is_recording
    from msp_range.recording.writer import Recorder

    recording = Recording(file) if is_recording(file) else None
    source = recording or file
    if airframe_file is not None:
        airframe = load_airframe(airframe_file)
    elif recording is not None:
        airframe = load_airframe_from(recording.files, file, "; name one with --airframe")
    else:
        raise ConfigError(f"{file}: a table does not contain its airframe; name the file with --airframe")
    airframe = airframe.changed(link=link)
    recorded = read_recorded(source, run_name, {sensor.name: sensor.sensor_model for sensor in airframe.sensors})
    transport = replaying.Nowhere() if link is None else open_transport(link, SystemClock())
    clock = (replaying.PacedClock if realtime else VirtualClock)(recorded.first_ping_s)
    recorder = None if record is None else Recorder(record, clock, files=airframe.files)
    outcome = replaying.replay(airframe, recorded, file, clock, transport, recorder)
    if recorder is not None:
        recorder.close()
    replaying.show(outcome, file, None if recording is None else recording.losses)


def tune(
    recordings: Annotated[list[Path], Argument(metavar="RECORDING...", help="recorded flights (.mcap)")],
    airframe_file: Annotated[
        Path | None,
        Option("--airframe", metavar="AIRFRAME.yaml", help="airframe file; default: the one that was flown"),
    ] = None,
    model: Annotated[
        Literal["constant", "constant_velocity"] | None,
        Option(help="model of the Kalman filter; default: the airframe's"),
    ] = None,
) -> None:
    """Fit a Kalman filter's Q and R to recorded flights, and print the line for the airframe file."""
    from msp_range.extras import require

    require("kalman", "msp-range tune")
    from msp_range import tuning

    tuning.show(tuning.tune_recordings(recordings, airframe_file, model))


def recover(
    recording: Annotated[Path, Argument(metavar="FILE.mcap", help="a recording cut by a power failure")],
    out: Annotated[Path, Argument(metavar="OUT.mcap", help="the repaired copy to write")],
) -> None:
    """Repair a recording that a power cut left incomplete, so that Foxglove and other tools can open it."""
    from msp_range.recording.recover import recover as recover_recording

    kept = recover_recording(recording, out)
    files = f" and {kept.files} attached files" if kept.files else ""
    print(f"{out}: {kept.messages} messages{files}; lost: {kept.losses}")


def export(
    recording: RecordingFile,
    out: Annotated[Path, Argument(metavar="OUT.csv", help="the table to make")],
) -> None:
    """Write a recording's readings as CSV: time_s, sensor, reading_cm, and known context."""
    from msp_range.recording.export import export as export_recording
    from msp_range.recording.reader import Recording

    source = Recording(recording)
    rows = export_recording(source, out)
    print(f"{out}: {rows} readings; lost: {source.losses}")


def layout(
    recording: RecordingFile,
    out: Annotated[
        Path,
        Argument(metavar="OUT.json|OUT.xml", help="the layout to make: .json for Foxglove, .xml for PlotJuggler"),
    ],
) -> None:
    """Write a layout with which Foxglove or PlotJuggler shows a recording: each sensor's ranges, and the fused one."""
    from msp_range.recording.layouts import FORMS, plots_of
    from msp_range.recording.reader import Recording

    if out.suffix not in FORMS:
        raise ConfigError(f"{out}: found the ending {out.suffix!r}; expected .json (Foxglove) or .xml (PlotJuggler)")
    plots = plots_of(Recording(recording))
    write_file(out, FORMS[out.suffix](plots))
    print(f"{out}: {len(plots)} plots")
