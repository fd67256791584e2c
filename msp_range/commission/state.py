"""Which steps have passed, kept next to the airframe file, so that commissioning goes on where it stopped.

`AIRFRAME.commission.json` holds for each passed step when that was, what it measured, and a hash of those parts of the
airframe that it verified. A change of them by anybody makes the step due again; a change of others does not.
"""

import hashlib
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from msp_range.clock import Clock, stamp_of
from msp_range.commission.steps.table import STEPS
from msp_range.config import Airframe
from msp_range.input_file import making, read_text
from msp_range.yaml_file import LARGEST_FILE_BYTES, ConfigError, writing


def hash_of(step: str, airframe: Airframe) -> str:
    """A hash of the parts of an airframe that a step verifies."""
    content = json.dumps(STEPS[step].verified(airframe), sort_keys=True)
    return hashlib.sha256(content.encode()).hexdigest()[:16]


@dataclass
class PassedSteps:
    """The passed steps of one airframe file."""

    path: Path
    """File in which they are kept."""
    steps: dict[str, dict[str, Any]] = field(default_factory=dict)
    """What is kept of each step, by its name: ``passed`` (UTC), ``hash`` and ``measured``."""

    @classmethod
    def of(cls, airframe_file: Path) -> "PassedSteps":
        """The state next to an airframe file; empty where there is none.

        Raises
        ------
        ConfigError
            There is a file, and it cannot be used.
        """
        path = airframe_file.with_suffix(".commission.json")
        try:
            steps = json.loads(read_text(path, LARGEST_FILE_BYTES))["steps"]
            known = {
                name: each
                for name, each in steps.items()
                if {"passed", "hash"} <= each.keys() and isinstance(each.get("measured"), dict)
            }
        except FileNotFoundError:
            return cls(path)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise ConfigError(f"{path}: cannot be read ({error}): remove it to begin anew") from None
        return cls(path, known)

    def has_passed(self, step: str, airframe: Airframe) -> bool:
        """Whether a step has passed with the airframe as it is now."""
        return step in self.steps and self.steps[step]["hash"] == hash_of(step, airframe)

    def next_step(self, airframe: Airframe) -> str | None:
        """The first step that has not passed; None where all have."""
        return next((step for step in STEPS if not self.has_passed(step, airframe)), None)

    def save(self, step: str, airframe: Airframe, measured: dict[str, Any], clock: Clock) -> None:
        """Keep that a step has passed.

        Raises
        ------
        ConfigError
            The file cannot be written.
        """
        self.steps[step] = {
            "passed": stamp_of(clock.utc()),
            "hash": hash_of(step, airframe),
            "measured": measured,
        }
        with writing(self.path), making(self.path, replacing=True) as unfinished:
            unfinished.write_text(json.dumps({"steps": self.steps}, indent=2) + "\n", encoding="utf-8")
