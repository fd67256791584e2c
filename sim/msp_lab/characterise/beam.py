"""The table of the beam beyond the measured angles: predicted before flight, and written into a sensor model file.

It gives a `SensorModel` its `predicted_breakaway`; in the text of a file everything else stays as it is.
"""

import re
from pathlib import Path

import yaml

from msp_range.commission.edit import save
from msp_range.reading_model.sensor_model import BreakawayPoint, PredictedBreakaway, SensorModel, load_sensor_model
from msp_range.yaml_file import ConfigError, read_config
from msp_range.yaml_loader import load_yaml
from msp_sim.acoustics.sonar import PARAMETERS, fit_beam

DIGITS = 7
"""Digits of an angle after the point [deg]: the field of view in DISTANCE_SENSOR, a number in single precision, is then
that of the unrounded angle to its last bit. Fewer change more of its bits, more change nothing."""


def predict_breakaway(sensor: SensorModel) -> PredictedBreakaway:
    """Predict the half angles of an ultrasonic sensor beyond the measured ones, by `extended_beam`.

    Rows that only repeat the last angle are left out: it is held anyway. No rows: the sonar equation cannot be fitted
    to the measured angles, or predicts no narrower one.
    """
    measured = [(point.range_cm, point.half_angle_deg) for point in sensor.breakaway]
    if len(measured) < PARAMETERS:
        return PredictedBreakaway(inputs=sensor.beam_inputs, rows=())
    *_, beam = fit_beam(measured, sensor, sensor.heard_on_axis_cm)
    rows = [
        BreakawayPoint(range_cm=round(100.0 * range_m, 6), half_angle_deg=round(angle_deg, DIGITS))
        for range_m, angle_deg in zip(beam.ranges_m, beam.half_angles_deg, strict=True)
    ]
    last = beam.half_angles_deg.index(beam.half_angles_deg[-1])
    return PredictedBreakaway(inputs=sensor.beam_inputs, rows=tuple(rows[len(measured) : last + 1]))


def with_prediction(text: str, predicted: PredictedBreakaway) -> str:
    """The text of a sensor model file with this prediction, in place of an older one or behind the measured angles.

    ConfigError if the file is written in a way in which it has to be changed by hand.
    """
    rows = [
        f"\n    - {{range_cm: {at.range_cm:.10g}, half_angle_deg: {at.half_angle_deg:.10g}}}" for at in predicted.rows
    ]
    block = (
        "predicted_breakaway:  # beyond the measured angles, by msp-lab beam\n"
        f'  inputs: "{predicted.inputs}"\n'
        f"  rows:{''.join(rows) or ' []'}"
    )
    # A key at the left edge, with all that is indented below it.
    older, measured = (
        re.search(rf"^{key}:.*(?:\n[ -].*)*", text, re.MULTILINE) for key in ("predicted_breakaway", "breakaway")
    )
    changed = ""
    if older is not None:
        changed = text[: older.start()] + block + text[older.end() :]
    elif measured is not None:
        changed = f"{text[: measured.end()]}\n{block}{text[measured.end() :]}"
    try:
        is_whole = load_yaml(changed) == {**load_yaml(text), "predicted_breakaway": predicted.model_dump(mode="json")}
    except yaml.YAMLError:
        is_whole = False
    if not is_whole:
        raise ConfigError(f"this file has to be changed by hand; it lacks:\n{block}")
    return changed


def predict_in_file(path: Path) -> tuple[PredictedBreakaway, Path | None]:
    """Write the prediction into a sensor model file; return it, and where the file as it was is kept.

    That is None if the file had this prediction already. ConfigError if the file cannot be used or written, or its
    sensor does not range with sound.
    """
    sensor = load_sensor_model(path)
    if sensor.medium != "sound":
        raise ConfigError(f"{path}: ranges with {sensor.medium}; only the beam of a sensor of sound is predicted")
    predicted = predict_breakaway(sensor)
    if sensor.predicted_breakaway == predicted:
        return predicted, None
    try:
        text = with_prediction(read_config(path), predicted)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    return predicted, save(path, text)
