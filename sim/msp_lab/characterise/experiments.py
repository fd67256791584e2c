"""The experiments of a campaign, by their word in the column `condition`: how they are called, and what they ask."""

from typing import NamedTuple


class ExperimentWords(NamedTuple):
    """Words for an experiment; those of a question are empty where nothing is asked."""

    called: str
    """Name in a sentence."""
    short: str = ""
    """Short name, for a picture."""
    question: str = ""
    """The question that the experiment answers."""
    matters: str = ""
    """What changes the readings if the answer is yes."""


EXPERIMENTS = {
    "baseline": ExperimentWords("the baseline (nothing varied)"),
    "maximum_range": ExperimentWords("the maximum range"),
    "field_of_view": ExperimentWords("the field of view"),
    "material": ExperimentWords(
        "the target's material", "material", "Does the material of the target matter?", "the material"
    ),
    "temperature": ExperimentWords(
        "the temperature", "temperature", "Does hot or cold air at the sensor matter?", "the air at the sensor"
    ),
    "vibration": ExperimentWords("vibration", "vibration", "Does vibration of the housing matter?", "the vibration"),
    "crosstalk_simultaneous": ExperimentWords(
        "two sensors that ping at once",
        "pings at once",
        "Does a second sensor that pings at the same time matter?",
        "the other sensor's ping",
    ),
    "crosstalk_sequential": ExperimentWords(
        "two sensors that ping in turn",
        "pings in turn",
        "Does a second sensor matter that waits for the first?",
        "the sensor that waits",
    ),
    "external_interference": ExperimentWords(
        "external ultrasound", "external ultrasound", "Does external ultrasound matter?", "the external source"
    ),
    "temperature_compensation": ExperimentWords("temperature compensation"),
}

QUESTIONS = {name: each for name, each in EXPERIMENTS.items() if each.question}
"""The experiments that ask whether something matters."""
