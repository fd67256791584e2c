"""`msp-range airframes`: the airframes that come with the program, by what their files say, and the choice of one."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from msp_range.config import AIRFRAME_NAME, Airframe, read_airframe
from msp_range.yaml_file import SHIPPED, ConfigError, writing

AROUND = {"forward", "right", "rear", "left"}
"""Orientations of sensors that look around."""


def shipped_airframes() -> dict[str, Airframe]:
    """Those of the package by their names."""
    return {path.stem: read_airframe(path) for path in sorted(SHIPPED.glob("*.yaml"))}


def _looks(airframe: Airframe) -> str:
    names = {sensor.orientation.name for sensor in airframe.sensors}
    if names >= AROUND:
        names = (names - AROUND) | {"around"}
    return ", ".join(sorted(names, reverse=True))


def _kind(airframe: Airframe) -> str:
    kinds = {
        f"{sensor.sensor_model.name} on {'a serial port' if sensor.driver.is_serial else 'I2C'}"
        for sensor in airframe.sensors
    }
    return " and ".join(sorted(kinds))


def _cant(airframe: Airframe) -> str:
    pitches = [abs(sensor.rotation_deg.pitch) for sensor in airframe.sensors]
    cant_deg = max(min(pitch, abs(pitch - 90)) for pitch in pitches)
    return f"canted by {cant_deg:g} deg" if cant_deg else "not canted"


QUESTIONS: tuple[tuple[str, Callable[[Airframe], str]], ...] = (
    ("How many range finders has the vehicle?", lambda airframe: str(len(airframe.sensors))),
    ("Where do they look?", _looks),
    ("Which range finders?", _kind),
    ("How are they mounted?", _cant),
    ("Which autopilot?", lambda airframe: airframe.link.autopilot),
    ("How is it connected? (link.url of the file)", lambda airframe: airframe.link.url),
    ("Which vehicle?", lambda airframe: airframe.vehicle),
)
"""Each question, and its answer of an airframe file. One is asked only where the answers of the files that are left
differ."""


def described(airframes: Mapping[str, Airframe]) -> Iterator[str]:
    """Airframes by their names, and the answers of each, one line for each."""
    for name, airframe in airframes.items():
        count, looks, kind, cant, *link, _ = (answer(airframe) for _, answer in QUESTIONS)
        yield f"{name}: {count} {kind}, {looks}, {cant}; {', '.join(link)}"


def choose(airframes: Mapping[str, Airframe], ask: Callable[[str, Sequence[str]], str]) -> str:
    """The name of the one that has all answers.

    Parameters
    ----------
    airframes
        Those to choose from, by their names.
    ask
        Asks a question with its answers, and returns one of them.
    """
    left = dict(airframes)
    for question, answer in QUESTIONS:
        answers = sorted({answer(each) for each in left.values()})
        if len(answers) > 1:
            chosen = ask(question, answers)
            left = {name: each for name, each in left.items() if answer(each) == chosen}
    return next(iter(left))


def ask_at_terminal(question: str, answers: Sequence[str]) -> str:
    """The answer of a person, by its number.

    Raises
    ------
    ConfigError
        There is no terminal to ask on, or the input ends.
    """
    if not sys.stdin.isatty():
        raise ConfigError(f"which airframe? Name one of {', '.join(shipped_airframes())}")
    numbers = {str(number): each for number, each in enumerate(answers, 1)}
    lines = [question, *(f"  {number}) {each}" for number, each in numbers.items())]
    print("\n".join(lines), file=sys.stderr)
    while True:
        print("number: ", end="", file=sys.stderr, flush=True)
        line = sys.stdin.readline()
        if not line:
            raise ConfigError("no airframe chosen")
        if (chosen := numbers.get(line.strip())) is not None:
            return chosen


def write_into(airframe: Airframe, folder: Path) -> Iterator[Path]:
    """Write an airframe file as ``airframe.yaml``, and the sensor models that it names; gives each path it has written.

    A model file that exists stays as it is.

    Raises
    ------
    ConfigError
        There is an airframe file already, or one cannot be written.
    """
    if (folder / AIRFRAME_NAME).exists():
        raise ConfigError(f"{folder / AIRFRAME_NAME}: exists already; change it, or move it away to choose another one")
    # The airframe file is last: where it is, all of it is.
    for name, text in sorted(airframe.files.items(), key=lambda each: each[0] == AIRFRAME_NAME):
        path = folder / name
        if not path.exists():
            with writing(path):
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(text, encoding="utf-8")
            yield path
