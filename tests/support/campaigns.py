"""Small campaigns, and operators at their bench who do as a test sets."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from msp_lab.campaigns.campaign import Campaign, load_campaign
from msp_lab.campaigns.collect import Arranged, Collection, Decision, Place, collect_readings
from msp_lab.campaigns.plan import Point, make_plan
from msp_lab.campaigns.simulated_bench import AutoOperator, Draw, SimulatedBench, readings_of
from msp_lab.campaigns.store import Store
from msp_lab.campaigns.watch import Outlier, PointWatch
from msp_range.reading import Reading
from msp_sim.device.device import Fault
from tests.support.shipped import CONFIGS

MODEL = str(CONFIGS / "sensors/mb1242.yaml")
BENCH_MODEL = str(CONFIGS / "sensors/mb1242_bench.yaml")
SENSORS = [
    {"name": "one", "address": 0x70, "model": MODEL, "simulator": BENCH_MODEL},
    {"name": "two", "address": 0x71, "model": MODEL, "simulator": BENCH_MODEL},
]
PLYWOOD = {"material": "plywood", "size_cm": [20.0, 20.0]}


def condition(**changed: Any) -> dict[str, Any]:
    """An entry of ``conditions``."""
    return {"condition": "baseline", "ranges_cm": [60, 120], "targets": [PLYWOOD]} | changed


def written(folder: Path, *conditions: dict[str, Any], **changed: Any) -> Path:
    """A campaign file."""
    content = {
        "campaign": "small",
        "reference": {"method": "a ruler", "uncertainty_cm": 0.2},
        "sensors": SENSORS,
        "room": {"air_temperature_c": 22.5},
        "readings": 30,
        "conditions": list(conditions) or [condition()],
    } | changed
    path = folder / "campaign.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


def campaign(folder: Path, *conditions: dict[str, Any], **changed: Any) -> Campaign:
    """The campaign of such a file."""
    return load_campaign(written(folder, *conditions, **changed))


class Collected:
    """A campaign on the simulator, which a test may resume as often as it likes."""

    def __init__(
        self,
        of: Campaign,
        folder: Path,
        seed: int = 1,
        faults: Mapping[str, Sequence[Fault]] | None = None,
        draw: Draw | None = None,
    ) -> None:
        self.campaign = of
        self.points = make_plan(of)
        models, words = readings_of(of, None)
        if draw is not None:
            models = lambda name, generator: draw  # noqa: E731
        self.bench = SimulatedBench(of, self.points, models, seed, words, faults)
        self.store = Store(folder, self.points, self.bench.description, self.bench.clock, of.files)

    def go(self, person: Any = None, wanted: Sequence[str] | None = None, again: Sequence[str] = ()) -> Any:
        """Collect; returns the person."""
        person = person or AutoOperator()
        names = [point.name for point in self.points] if wanted is None else wanted
        try:
            collection = Collection(self.campaign, self.points, names, again)
            collect_readings(collection, self.bench, self.store, person)
        finally:
            self.store.close()
        return person

    def table(self) -> str:
        """``readings.csv`` as text."""
        path, _ = self.store.write_table()
        return path.read_text()


class ScriptedOperator(AutoOperator):
    """An operator who answers as a test sets, when asked; GO afterwards."""

    def __init__(
        self,
        arranged: Sequence[Arranged | Decision] = (),
        judged: Sequence[Decision] = (),
        troubled: Sequence[Decision] = (),
        looked: Callable[[Reading], Decision] = lambda reading: Decision.GO,
    ) -> None:
        super().__init__()
        self._arranged = list(arranged)
        self._judged = list(judged)
        self._troubled = list(troubled)
        self._looked = looked
        self.visited: list[str] = []
        self.to_change: list[list[str]] = []
        self.places: list[Place] = []

    def arrange(self, point: Point, to_change: Sequence[str], place: Place) -> Arranged:
        self.visited.append(point.name)
        self.to_change.append(list(to_change))
        self.places.append(place)
        answer = self._arranged.pop(0) if self._arranged else Decision.GO
        return Arranged(answer) if isinstance(answer, Decision) else answer

    def on_reading(
        self, point: Point, watches: Mapping[str, PointWatch], reading: Reading, outlier: Outlier | None
    ) -> Decision:
        super().on_reading(point, watches, reading, outlier)
        return self._looked(reading)

    def review(self, point: Point, watches: Mapping[str, PointWatch]) -> Decision:
        return self._judged.pop(0) if self._judged else Decision.GO

    def on_trouble(self, text: str) -> Decision:
        super().on_trouble(text)
        return self._troubled.pop(0) if self._troubled else Decision.GO
