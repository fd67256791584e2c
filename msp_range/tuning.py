"""`msp-range tune`: fit Q and R of a Kalman filter to recorded flights, and print the line for the airframe file.

The readings are the filter's input: corrected for temperature, with status ok, and without values that are also fault
codes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

from msp_range.config import Airframe, load_airframe, load_airframe_from
from msp_range.filters.kalman import KalmanParameters
from msp_range.filters.tune import FEWEST, Track, Tuned, tune
from msp_range.reading import Status
from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.topics import RANGE_PREFIX
from msp_range.terminal import PlainConsole, plain_table

Model = Literal["constant", "constant_velocity"]


def tune_recordings(paths: Sequence[Path], airframe_file: Path | None, model: Model | None) -> Tuned:
    """Fit one filter to all sensors of all recordings.

    Raises
    ------
    RecordingError
        A file is not a recording, or too few readings have a range.
    ConfigError
        The airframe file cannot be used.
    """
    tracks: list[Track] = []
    for path in paths:
        tracks += recorded_tracks(path)
    if airframe_file is not None:
        airframe = load_airframe(airframe_file)
    else:
        airframe = load_airframe_from(Recording(paths[0]).files, paths[0], "; name one with --airframe")
    parameters = _kalman_of(airframe, model)
    models = [sensor.sensor_model for sensor in airframe.sensors]
    variance_cm2 = max(
        sensor_model.reading_model.sigma_cm**2 + sensor_model.answered_cm**2 / 12 for sensor_model in models
    )
    try:
        return tune(tracks, parameters, variance_cm2)
    except ValueError as error:
        raise RecordingError(f"{', '.join(map(str, paths))}: {error}: fly longer, or name more recordings") from None


def recorded_tracks(path: Path) -> list[Track]:
    """The readings of each sensor of a recording, as the input of its filters.

    Raises
    ------
    RecordingError
        The file is not a recording, or has no readings.
    """
    tracks: dict[str, list[tuple[float, float]]] = {}
    for topic, _, message in Recording(path):
        is_range = topic.startswith(RANGE_PREFIX) and message.get("status") == Status.OK.value
        if is_range and "corrected_m" in message and not message.get("suspect"):
            tracks.setdefault(topic, []).append((message["time_s"], message["corrected_m"]))
    if not tracks:
        raise RecordingError(f"{path}: contains no readings with a range; expected {FEWEST} or more")
    return [sorted(track) for track in tracks.values()]


def _kalman_of(airframe: Airframe, model: Model | None) -> KalmanParameters:
    """The airframe's Kalman filter; the default one if it has none or one of another model."""
    for parameters in airframe.filters:
        if isinstance(parameters, KalmanParameters) and model in (None, parameters.model):
            return parameters
    return KalmanParameters(filter="kalman", model=model or "constant_velocity")


def show(tuned: Tuned) -> None:
    """Print values, intervals, likelihoods, and the lines for the airframe file."""
    console = PlainConsole(width=120)
    console.print(
        f"Kalman filter, {tuned.parameters.model}: {tuned.innovations} innovations, {tuned.outliers} outliers removed\n"
    )
    rows = []
    for parameter in tuned.fitted:
        interval = f"{parameter.low:.3g} to {parameter.high:.3g}"
        if parameter.low == 0.0 or parameter.high == float("inf"):
            interval = "not determined by these flights"
        rows.append((parameter.name, f"{parameter.before:.3g}", f"{parameter.value:.3g}", interval))
    console.print(plain_table(("parameter", "before", "fitted", "95 % interval"), rows))
    gain = tuned.after - tuned.before
    console.print(f"log likelihood: {tuned.before:.1f} before, {tuned.after:.1f} fitted, {gain:+.1f}")
    console.print("\nfor the airframe file:\n\nfilters:")
    console.print(f"  - {{{_line(tuned.parameters)}}}", soft_wrap=True)


def _line(parameters: KalmanParameters) -> str:
    """All values that differ from the defaults, the model, and the fitted values."""
    defaults = KalmanParameters(filter="kalman").model_dump()
    of_q = "acceleration_std_m_s2" if parameters.model == "constant_velocity" else "process_variance_cm2"
    always = ("filter", "model", of_q, "measurement_variance_cm2")
    kept = {key: value for key, value in parameters.model_dump().items() if key in always or value != defaults[key]}
    return ", ".join(f"{key}: {'null' if value is None else value}" for key, value in kept.items())
