"""Measured noise held against the sensor models, and models of one's own where it is larger.

Sensor models are shared, so a changed one is a new file next to the airframe file, which the sensors then name. A model
that says more than was measured stays: a bench is quieter than a flight, and a filter that is too sure is worse than
one that is not sure enough.
"""

import math
from collections.abc import Mapping
from pathlib import Path

from msp_range.commission.edit import Edit, edited
from msp_range.commission.motion import Measured
from msp_range.commission.outcome import Proposal, StepOutcome, shown
from msp_range.config import Airframe
from msp_range.yaml_file import ConfigError

NOISIER_M = 0.005
"""Noise above the model's by less [m] is left alone: readings are whole centimetres."""
ONE_OF_MANY = 1.6
"""A sensor that scatters by this more than the others of its model has a fault of its own; the model is not changed for
it. Between sensors that are alike, estimates from 40 readings differ by a fifth."""


def compare_noise(airframe: Airframe, measured: Mapping[str, Measured], when: str, outcome: StepOutcome) -> None:
    """Add what the measured noise means for the airframe file.

    Parameters
    ----------
    measured
        Standard deviation of single readings by the sensor's name [m].
    when
        How the vehicle was then, for a person: 'while still', 'in flight'.
    """
    for model in dict.fromkeys(sensor.model for sensor in airframe.sensors):
        sensors = [sensor for sensor in airframe.sensors if sensor.model == model and sensor.name in measured]
        if not sensors:
            continue
        sigma_m = sensors[0].sensor_model.reading_model.sigma_cm / 100
        quietest = sorted(measured[sensor.name].value for sensor in sensors)[: (len(sensors) + 1) // 2]
        usual_m = max(quietest[-1], sigma_m)
        faulty = [
            sensor
            for sensor in sensors
            if len(sensors) > 1
            and measured[sensor.name].value > ONE_OF_MANY * usual_m
            and measured[sensor.name].differs_from(usual_m, NOISIER_M)
        ]
        for sensor in faulty:
            text = f"it scatters by {_cm(measured[sensor.name])} {when}, others of its kind by less"
            remedy = "check its supply (100 ohm and 100 uF at the sensor), its wires, and what it looks at"
            outcome.wrong(f"noise of {sensor.name}", text, remedy)
        others = [measured[sensor.name] for sensor in sensors if sensor not in faulty]
        mean = Measured(
            math.sqrt(sum(other.value**2 for other in others) / len(others)),
            math.sqrt(sum(other.half_width**2 for other in others)) / len(others),
        )
        text = f"readings scatter by {_cm(mean)} {when}, {100 * sigma_m:.1f} cm in {model}"
        if mean.value > sigma_m and mean.differs_from(sigma_m, NOISIER_M):
            _propose(airframe, model, round(100 * mean.value, 1), text, outcome)
        else:
            outcome.right("noise", text)


def _cm(measured: Measured) -> str:
    return shown(Measured(100 * measured.value, 100 * measured.half_width), "cm", 1)


def _propose(airframe: Airframe, model: str, sigma_cm: float, text: str, outcome: StepOutcome) -> None:
    name = f"{Path(model).stem}_{sigma_cm:g}cm.yaml"
    try:
        content = edited(airframe.files[model], [Edit(("reading_model", "sigma_cm"), sigma_cm)])
    except ConfigError as error:
        outcome.wrong("noise", text, f"change sigma_cm in {model}: {error}")
        return
    edits = tuple(
        Edit(("sensors", i, "model"), name) for i, sensor in enumerate(airframe.sensors) if sensor.model == model
    )
    outcome.proposals.append(Proposal(f"{text}. A model of your own, {name}", edits, ((name, content),)))
