"""The MB1242 characterization report in numbers: what it measured, what it concluded, and what is wrong in it.

Section, figure, table, equation and erratum numbers are those of the report and of the notes on it.
"""

from msp_lab.characterise.page.picture_data import ReferenceNumbers
from msp_range.acoustics.air import ZERO_CELSIUS_K
from msp_range.reading_model.sensor_model import SensorModel
from msp_range.yaml_file import ConfigError

REPORT = ReferenceNumbers(
    name="the report",
    # Section 4.3.1, figure 4.4: apart from missed readings.
    largest_error_cm=1.0,
    # Section 4.3.2, figures 4.5 to 4.8: a single peak once 765 and 255 are masked.
    peak_range_cm=500.0,
    peak_cm=503.0,
    # Section 4.3.3, figures 4.9 to 4.12.
    half_angle_deg={50.0: 23.4, 100.0: 18.0, 150.0: 14.4, 200.0: 12.6},
    # Table 5.1.
    mean_error_cm={
        305.0: (1.00, 1.00),
        335.0: (2.821, 0.067),
        366.0: (2.739, 0.196),
        396.0: (2.724, 0.447),
        427.0: (4.931, 0.921),
    },
)
SENSOR = "MB1242"
"""The sensor model that it is about."""
CALIBRATION_TEMPERATURE_C = 20.0
"""Air temperature that its compensation takes the sensor to assume: 68 deg F, after eq 7. The maker's pulse width
implies 22.5 deg C (erratum 5)."""
ANSWERS = {
    "material": "4.3.4: plywood, asphalt and concrete are indistinguishable at these ranges",
    "temperature": "4.3.5: errors of 1 to 2 cm, because only the air near the sensor was hot or cold",
    "vibration": "4.3.6: effectively the same as the baseline",
    "crosstalk_simultaneous": "4.3.7: the second sensor reads short, because it receives the first one's ping",
    "crosstalk_sequential": "4.3.7: the errors are reduced when the sensors ping one after the other",
    "external_interference": "4.3.8: inconclusive",
}
"""The report's answer to each question (`findings.Question.name`), in a sentence."""
MATERIALS = ("plywood", "asphalt", "concrete")
"""Section 4.3.4: figures 4.13 to 4.15 in this order."""


def implied_temperature_c(range_cm: float) -> float | None:
    """Return the air temperature that takes Table 5.1's first number to its second [deg C] (erratum 12).

    None where the report has no such range, or where both numbers are the same: that row was not compensated.

    Examples
    --------
    >>> [round(each, 1) for each in map(implied_temperature_c, (335.0, 427.0)) if each], implied_temperature_c(305.0)
    ([15.2, 14.6], None)
    """
    pair = REPORT.mean_errors_at(range_cm)
    if pair is None or pair[0] == pair[1]:
        return None
    ratio = (range_cm + pair[1]) / (range_cm + pair[0])
    return (CALIBRATION_TEMPERATURE_C + ZERO_CELSIUS_K) * ratio**2 - ZERO_CELSIUS_K


def check_sensor(sensor: SensorModel) -> None:
    """Refuse another sensor than the report's: its numbers are no expectation for that.

    Raises
    ------
    ConfigError
        It is another one.
    """
    if sensor.name != SENSOR:
        raise ConfigError(f"--compare-with-report: the report is about the {SENSOR}, not the {sensor.name}")
