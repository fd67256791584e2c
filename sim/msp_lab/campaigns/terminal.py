"""The operator at a terminal: what to set up now, what is being read, what looks wrong, and the time that is left.

It shows points and readings, and asks the person.
"""

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from msp_lab.campaigns.collect import Arranged, Collection, Decision, Place
from msp_lab.campaigns.plan import Point, changes, reading_s, setup_s
from msp_lab.campaigns.store import Store
from msp_lab.campaigns.watch import Outlier, PointWatch
from msp_range.clock import Clock
from msp_range.reading import Reading, Status

BAR_CELLS = 40
"""Width of the bars in characters."""
REDRAW_S = 0.2
"""Time between two updates of the screen [s]; a shorter one costs processor time while readings come in."""
MAX_ROWS = 17
"""Lines of the histogram at most: a screen of 24 lines has room for it and the messages."""
KEYS: dict[str, tuple[str, float, float]] = {
    "range": ("true_range_cm", 1.0, 2000.0),
    "air": ("air_temperature_c", -40.0, 65.0),
    "far": ("target_temperature_c", -40.0, 65.0),
    "humidity": ("humidity_pct", 0.0, 100.0),
    "angle": ("incidence_deg", -89.0, 89.0),
}
"""Quantities that a person may enter where they differ from the plan: key -> column and bounds."""
HELP = (
    "Enter: set up as planned.  range=120.4 air=22.5: set up so.  s: later.  r: read the previous point again.  q: stop"
)


class Terminal:
    """A `msp_lab.campaigns.collect.Operator` at a terminal.

    Parameters
    ----------
    collection
        What is measured.
    console
        Where to write.
    ask
        Shows a prompt and returns what was typed; "q" where the person wants to leave.
    clock
        For the pace.
    stopped
        Whether a signal asks to end.
    """

    def __init__(
        self,
        collection: Collection,
        console: Console,
        ask: Callable[[str], str],
        clock: Clock,
        stopped: Callable[[], bool],
    ) -> None:
        self._campaign = collection.campaign
        self._points = list(collection.points)
        self._console = console
        self._ask = ask
        self._clock = clock
        self._stopped = stopped
        self._measured: dict[str, tuple[object, float]] = {}
        self._air_asked: object = None
        self._visited: set[str] = set()
        self._live: Live | None = None
        self._noticed: list[str] = []
        self._next_redraw_s = 0.0
        self._question = ""
        self._has_read = False
        self._last: Point | None = None
        self._planned_setup_s = self._real_setup_s = 0.0

    def arrange(self, point: Point, to_change: Sequence[str], place: Place) -> Arranged:
        """Show what to change, and wait until it is done."""
        show = self._console.print
        show()
        show(f"{place.number} of {place.of}: {point.name}   {self._left(place)}", style="bold")
        if point.question and point.question != self._question:
            show(point.question, style="italic")
        self._question = point.question
        if place.had:
            show(f"{place.had} of its {point.readings} readings are recorded already; set it up in the same way.")
        for number, line in enumerate(to_change, start=1):
            show(f"  {number}. {line}")
        began_s = self._clock.now()
        arranged = self._wait(point, to_change)
        self._planned_setup_s += setup_s(self._last, point)
        self._real_setup_s += self._clock.now() - began_s
        self._last = point
        self._noticed = []
        return arranged

    def on_reading(
        self, point: Point, watches: Mapping[str, PointWatch], reading: Reading, outlier: Outlier | None
    ) -> Decision:
        """Update the histogram, and show outliers and faults at once."""
        self._has_read = True
        if outlier is not None:
            self._noticed.append(f"{outlier.sensor} reading {outlier.number}: {outlier.reading_cm} cm, {outlier.why}")
        elif reading.status.is_fault:
            self._noticed.append(f"{reading.sensor}: {_fault_words(reading.status)}; repeated")
        if self._console.is_terminal and self._clock.now() >= self._next_redraw_s:
            self._next_redraw_s = self._clock.now() + REDRAW_S
            if self._live is None:
                self._live = Live(console=self._console, auto_refresh=False, transient=True)
                self._live.start()
            self._live.update(self._screen(point, watches), refresh=True)
        if self._stopped():
            self.close()
            return Decision.STOP
        return Decision.GO

    def review(self, point: Point, watches: Mapping[str, PointWatch]) -> Decision:
        """Show the histogram; ask only if something looks wrong."""
        self.close()
        self._console.print(self._screen(point, watches))
        warnings = [warning for watch in watches.values() for warning in watch.warnings()]
        if not warnings:
            return Decision.GO
        for warning in warnings:
            self._console.print(f"  ! {warning}", style="yellow")
        answer = self._answer("Enter: keep it.  r: read this point again.  q: stop > ")
        return {"r": Decision.AGAIN, "q": Decision.STOP}.get(answer, Decision.GO)

    def on_trouble(self, text: str) -> Decision:
        """Report a silent sensor, and wait for an answer."""
        self.close()
        self._console.print(f"  ! {text}", style="red")
        self._console.print("    Check power, the two bus wires and the address (msp-range scan).")
        answer = self._answer("Enter: try again.  s: leave this point for later.  q: stop > ")
        return {"s": Decision.SKIP, "q": Decision.STOP}.get(answer, Decision.GO)

    def close(self) -> None:
        """End the live display."""
        if self._live is not None:
            self._live.stop()
            self._live = None

    def _answer(self, prompt: str) -> str:
        return self._ask(prompt).strip().lower()

    def _wait(self, point: Point, to_change: Sequence[str]) -> Arranged:
        if not to_change and point.name not in self._visited:
            return Arranged(Decision.GO, self._differing(point))
        self._visited.add(point.name)
        if self._ask_air(point) is Decision.STOP:
            return Arranged(Decision.STOP)
        while True:
            answer = self._answer(f"  {HELP} > ")
            if answer == "r" and not self._has_read:
                self._console.print(
                    "  no point was read before this one; --repeat NAME reads a point of an earlier session again"
                )
                continue
            if answer in ("s", "r", "q"):
                return Arranged({"s": Decision.SKIP, "r": Decision.AGAIN, "q": Decision.STOP}[answer])
            wrong = self._store_measured(point, answer)
            if wrong is None:
                return Arranged(Decision.GO, self._differing(point))
            self._console.print(f"  {wrong}", style="yellow")

    def _ask_air(self, point: Point) -> Decision:
        """Ask for the air temperature if there is no thermometer and the planned one has changed."""
        planned = point.columns.get("air_temperature_c")
        if self._campaign.thermometer is not None or (self._air_asked == (planned,)):
            return Decision.GO
        self._air_asked = (planned,)
        expected = "unknown" if planned is None else f"{planned:g}"
        while True:
            answer = self._answer(f"  Air temperature at the sensor, from your thermometer \\[{expected}] deg C > ")
            if answer == "q":
                return Decision.STOP
            wrong = self._store_measured(point, f"air={answer}") if answer else None
            if wrong is None:
                return Decision.GO
            self._console.print(f"  {wrong}", style="yellow")

    def _store_measured(self, point: Point, answer: str) -> str | None:
        """Store ``key=number`` pairs; return what is wrong with them, or None."""
        noted: dict[str, float] = {}
        for pair in answer.split():
            key, _, text = pair.partition("=")
            if key not in KEYS:
                return f"{pair!r}: expected one of {', '.join(f'{each}=' for each in KEYS)}, or Enter, s, r, q"
            column, low, high = KEYS[key]
            try:
                value = float(text)
            except ValueError:
                return f"{pair!r}: expected a number after {key}="
            if not low <= value <= high:
                return f"{pair!r}: expected {low:g} to {high:g}"
            noted[column] = value
        planned = point.columns
        even = planned.get("air_temperature_c") == planned.get("target_temperature_c")
        if "air_temperature_c" in noted and even:
            noted.setdefault("target_temperature_c", noted["air_temperature_c"])
        self._measured |= {column: (planned.get(column), value) for column, value in noted.items()}
        return None

    def _differing(self, point: Point) -> dict[str, float]:
        """Columns that differ from the plan; each is valid until the plan has another value."""
        planned = point.columns
        self._measured = {
            column: (then, value) for column, (then, value) in self._measured.items() if planned.get(column) == then
        }
        return {column: value for column, (_, value) in self._measured.items()}

    def _left(self, place: Place) -> str:
        """Estimate of the time left, at this person's pace."""
        rest = self._points[place.number - 1 :]
        pace = 1.0
        if self._planned_setup_s > 0.0:
            # Ten minutes at the planned pace are added, so that the first minutes do not dominate.
            pace = (self._real_setup_s + 600.0) / (self._planned_setup_s + 600.0)
        left_s = 0.0
        for before, point in zip([self._last, *rest], rest, strict=False):
            left_s += reading_s(self._campaign, point) + pace * setup_s(before, point)
        return f"about {duration(left_s)} left"

    def _screen(self, point: Point, watches: Mapping[str, PointWatch]) -> RenderableType:
        lines: list[RenderableType] = []
        for watch in watches.values():
            share = min(watch.read / point.readings, 1.0)
            bar = "█" * round(share * BAR_CELLS)
            lines.append(Text(f"{watch.sensor} {bar:·<{BAR_CELLS}} {watch.read} of {point.readings} readings"))
            lines.append(histogram(watch))
        lines.extend(Text(f"  ! {text}", style="yellow") for text in self._noticed[-4:])
        return Group(*lines)


def histogram(watch: PointWatch) -> Table:
    """Return the readings of a point by centimetre about their median, the others in one line above and one below."""
    table = Table.grid(padding=(0, 1))
    for label, count, style in _bars(watch):
        most = max(max(watch.counts.values(), default=1), watch.no_echo, 1)
        cells = math.ceil(count / most * BAR_CELLS)
        table.add_row(Text(f"{label:>12}"), Text("█" * cells, style=style), Text(str(count)))
    return table


def _bars(watch: PointWatch) -> Iterator[tuple[str, int, str]]:
    median_cm = watch.median_cm
    if median_cm is not None:
        reach = MAX_ROWS // 2
        centre = round(median_cm)
        near: Counter[int] = Counter()
        for reading_cm, count in watch.counts.items():
            if abs(reading_cm - centre) <= reach:
                near[round(reading_cm)] += count
        shorter = sum(count for reading_cm, count in watch.counts.items() if reading_cm < centre - reach)
        longer = sum(count for reading_cm, count in watch.counts.items() if reading_cm > centre + reach)
        if shorter:
            yield "shorter", shorter, "yellow"
        for whole_cm in range(min(near, default=centre), max(near, default=centre) + 1):
            yield f"{whole_cm} cm", near[whole_cm], "green"
        if longer:
            yield "longer", longer, "yellow"
    if watch.no_echo:
        yield "no echo", watch.no_echo, "red"


def duration(seconds: float) -> str:
    """Return a duration in hours and minutes.

    Examples
    --------
    >>> duration(40), duration(300), duration(9000)
    ('1 min', '5 min', '2 h 30 min')
    """
    minutes = max(1, round(seconds / 60))
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60} min"


def _fault_words(status: Status) -> str:
    return {
        Status.NO_ANSWER: "no answer",
        Status.CLOCK_FAULT: "clock fault (bit 15 set)",
        Status.IMPOSSIBLE: "an impossible answer",
        Status.PART_INFO: "part information in place of an answer",
    }[status]


def show_plan(console: Console, collection: Collection, store: Store) -> None:
    """Print the points in order, what to change between them, and the time they may take."""
    total_s = 0.0
    readings = 0
    points = [point for point in collection.points if point.name in collection.wanted or point.name in collection.again]
    for number, (before, point) in enumerate(zip([None, *points], points, strict=False), start=1):
        mark = "done" if store.is_done(point) else f"{point.readings} readings"
        console.print(f"{number:4d}  {point.name}   {mark}")
        for line in changes(before, point):
            console.print(f"        {line}", style="dim")
        if not store.is_done(point):
            total_s += reading_s(collection.campaign, point) + setup_s(before, point)
            readings += point.readings * len(point.setup.sensors)
    console.print(f"{readings} readings are left; estimated time {duration(total_s)}")
