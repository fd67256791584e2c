"""The person who moves the vehicle and decides, and what she is asked to do."""

import sys
from typing import Protocol, TextIO

from msp_range.terminal import wrapped
from msp_range.yaml_file import ConfigError

LEAST_HEIGHT_M, MOST_HEIGHT_M = 0.1, 10.0
"""Heights over the floor that a sensor can measure and a person too [m]; another number is in another unit."""
EXPECTED_HEIGHT = f"expected metres between {LEAST_HEIGHT_M:g} and {MOST_HEIGHT_M:g}, such as 0.85"


class Operator(Protocol):
    """Whoever moves the vehicle and decides."""

    def begin(self, text: str) -> None:
        """Explain a step, and wait until the person is ready."""

    def instruct(self, text: str) -> None:
        """Show what is to be done from now on."""

    def show(self, text: str) -> None:
        """Show what was found; a line of the text may be of any length."""

    def agrees(self, text: str) -> bool:
        """Ask with yes or no whether to make a change."""

    def height_m(self, text: str) -> float | None:
        """Ask for a measured height until it is one [m]; None: there is no further one."""


def height_of(answer: str) -> float | None:
    """A height that somebody typed [m]; None where it is none.

    Examples
    --------
    >>> height_of("0,85"), height_of("85"), height_of("high")
    (0.85, None, None)
    """
    try:
        height_m = float(answer.strip().replace(",", "."))
    except ValueError:
        return None
    return height_m if LEAST_HEIGHT_M <= height_m <= MOST_HEIGHT_M else None


class PersonAtTerminal:
    """A person at a terminal.

    Parameters
    ----------
    accepts_all
        Agree to every change without a question, and do not wait for the Enter key.
    heights_m
        Heights that were given on the command line, in the order in which they are asked for.
    out
        Where texts go.

    Raises
    ------
    ConfigError
        A height cannot be one.
    """

    def __init__(self, accepts_all: bool, heights_m: tuple[float, ...], out: TextIO) -> None:
        for height_m in heights_m:
            if not LEAST_HEIGHT_M <= height_m <= MOST_HEIGHT_M:
                raise ConfigError(f"--height {height_m:g}: {EXPECTED_HEIGHT}")
        self._accepts_all = accepts_all
        self._heights = list(heights_m)
        self._out = out

    def begin(self, text: str) -> None:
        """Explain a step, and wait for the Enter key."""
        self.show(" ".join(text.split()))
        if not self._accepts_all:
            self._answer("Press Enter when you are ready, Ctrl-C to go on another time. ")

    def instruct(self, text: str) -> None:
        """Show what is to be done from now on, with the terminal's bell: the person looks at the vehicle."""
        self.show(f">> {text}")
        if self._out.isatty():
            self._out.write("\a")
            self._out.flush()

    def agrees(self, text: str) -> bool:
        """Ask with yes or no whether to make a change."""
        self.show(text)
        if self._accepts_all:
            self.show("changed, as --yes says")
            return True
        while True:
            answer = self._answer("Change it? [y/n] ").strip().lower()
            if answer in ("y", "yes", "n", "no"):
                return answer.startswith("y")

    def height_m(self, text: str) -> float | None:
        """Ask for a measured height until it is one [m]; None: there is no further one."""
        if self._heights:
            height_m = self._heights.pop(0)
            self.show(f"{text}\n{height_m:g} m, as --height says")
            return height_m
        if self._accepts_all:
            return None
        self.show(text)
        while True:
            answer = self._answer("Height in metres (Enter: no further one): ").strip()
            if not answer:
                return None
            found_m = height_of(answer)
            if found_m is not None:
                return found_m
            self.show(f"found {answer!r}; {EXPECTED_HEIGHT}")

    def _answer(self, question: str) -> str:
        if not sys.stdin.isatty():
            raise ConfigError(
                "a question would be asked, and standard input is no terminal: use --yes to accept all changes, and "
                "--height METRES for each height that you have measured"
            )
        self._out.write(question)
        self._out.flush()
        answer = sys.stdin.readline()
        if not answer:
            raise KeyboardInterrupt
        return answer

    def show(self, text: str) -> None:
        """Show what was found, in lines of at most 80 columns."""
        self._out.write("\n".join([*wrapped(text), ""]))
        self._out.flush()
