"""A person at a terminal: what to set up now, what is being read, what looks odd, and how long it will take.

Points and readings enter, lines on the screen and a person's answers leave. Nothing is measured here.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence

from rich.console import Console, Group, RenderableType
from rich.live import Live
from rich.table import Table
from rich.text import Text

from msp_lab.campaigns.campaign import Campaign
from msp_lab.campaigns.collect import Arranged, Place, Say
from msp_lab.campaigns.plan import Point, reading_s, setup_s
from msp_lab.campaigns.watch import Outlier, Watch
from msp_range.clock import Clock
from msp_range.reading import Reading, Status

BAR_CELLS = 40
LOOK_EACH_S = 0.2
"""Time between two drawings of the screen [s]."""
ROWS_MOST = 17
"""Lines of the histogram."""
KEYS: dict[str, tuple[str, float, float]] = {
    "range": ("true_range_cm", 1.0, 2000.0),
    "air": ("air_temperature_c", -40.0, 65.0),
    "far": ("target_temperature_c", -40.0, 65.0),
    "humidity": ("humidity_pct", 0.0, 100.0),
    "angle": ("incidence_deg", -89.0, 89.0),
}
"""What a person may have measured otherwise than planned: column and bounds."""
HELP = (
    "Enter: it is set up.  range=120.4 air=22.5: it is so instead.  s: later.  r: read the one before again.  q: stop"
)


class Terminal:
    """A `msp_lab.campaigns.collect.Person` at a terminal.

    Parameters
    ----------
    campaign, points
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
        campaign: Campaign,
        points: Sequence[Point],
        console: Console,
        ask: Callable[[str], str],
        clock: Clock,
        stopped: Callable[[], bool],
    ) -> None:
        self._campaign = campaign
        self._points = list(points)
        self._console = console
        self._ask = ask
        self._clock = clock
        self._stopped = stopped
        self._measured: dict[str, tuple[object, float]] = {}
        self._air_asked: object = None
        self._visited: set[str] = set()
        self._live: Live | None = None
        self._noticed: list[str] = []
        self._next_look_s = 0.0
        self._question = ""
        self._has_read = False
        self._last: Point | None = None
        self._planned_setup_s = self._real_setup_s = 0.0

    def arrange(self, point: Point, to_change: Sequence[str], place: Place) -> Arranged:
        """Say what to change, and wait."""
        say = self._console.print
        say()
        say(f"{place.number} of {place.of}: {point.name}   {self._left(place)}", style="bold", highlight=False)
        if point.question and point.question != self._question:
            say(point.question, style="italic", highlight=False)
        self._question = point.question
        if place.had:
            say(f"{place.had} of its {point.readings} readings are there already; set it up as it was.")
        for number, line in enumerate(to_change, start=1):
            say(f"  {number}. {line}", highlight=False)
        began_s = self._clock.now()
        arranged = self._wait(point, to_change)
        self._planned_setup_s += setup_s(self._last.setup if self._last else None, point.setup)
        self._real_setup_s += self._clock.now() - began_s
        self._last = point
        self._noticed = []
        return arranged

    def look(self, point: Point, watches: Mapping[str, Watch], reading: Reading, outlier: Outlier | None) -> Say:
        """Draw the histogram now and then, and flag what is odd at once."""
        self._has_read = True
        if outlier is not None:
            self._noticed.append(f"{outlier.sensor} reading {outlier.number}: {outlier.reading_cm} cm, {outlier.why}")
        elif reading.status.is_fault:
            self._noticed.append(f"{reading.sensor}: {_fault_words(reading.status)}; asked again")
        if self._console.is_terminal and self._clock.now() >= self._next_look_s:
            self._next_look_s = self._clock.now() + LOOK_EACH_S
            if self._live is None:
                self._live = Live(console=self._console, auto_refresh=False, transient=True)
                self._live.start()
            self._live.update(self._screen(point, watches), refresh=True)
        if self._stopped():
            self._end_live()
            return Say.STOP
        return Say.GO

    def judge(self, point: Point, watches: Mapping[str, Watch]) -> Say:
        """Show the histogram; ask only where something is odd."""
        self._end_live()
        self._console.print(self._screen(point, watches))
        doubts = [doubt for watch in watches.values() for doubt in watch.doubts()]
        if not doubts:
            return Say.GO
        for doubt in doubts:
            self._console.print(f"  ! {doubt}", style="yellow", highlight=False)
        answer = self._ask("Enter: keep it.  r: read this point again.  q: stop > ").strip().lower()
        return {"r": Say.AGAIN, "q": Say.STOP}.get(answer, Say.GO)

    def trouble(self, text: str) -> Say:
        """Tell, and wait until it is looked after."""
        self._end_live()
        self._console.print(f"  ! {text}", style="red", highlight=False)
        self._console.print("    Look at power, the two bus wires and the address (msp-range scan).")
        answer = self._ask("Enter: try again.  s: leave this point for later.  q: stop > ").strip().lower()
        return {"s": Say.SKIP, "q": Say.STOP}.get(answer, Say.GO)

    def close(self) -> None:
        """Leave the screen as it is."""
        self._end_live()

    def _wait(self, point: Point, to_change: Sequence[str]) -> Arranged:
        if not to_change and point.name not in self._visited:
            return Arranged(Say.GO, self._differing(point))
        self._visited.add(point.name)
        if self._ask_air(point) is Say.STOP:
            return Arranged(Say.STOP)
        while True:
            answer = self._ask(f"  {HELP} > ").strip().lower()
            if answer == "r" and not self._has_read:
                self._console.print(
                    "  nothing was read before this; --repeat NAME reads a point of an earlier sitting again"
                )
                continue
            if answer in ("s", "r", "q"):
                return Arranged({"s": Say.SKIP, "r": Say.AGAIN, "q": Say.STOP}[answer])
            wrong = self._note(point, answer)
            if wrong is None:
                return Arranged(Say.GO, self._differing(point))
            self._console.print(f"  {wrong}", style="yellow", highlight=False)

    def _ask_air(self, point: Point) -> Say:
        """Ask for the air's temperature where no thermometer tells it and the plan has another one than before."""
        planned = point.columns.get("air_temperature_c")
        if self._campaign.thermometer is not None or (self._air_asked == (planned,)):
            return Say.GO
        self._air_asked = (planned,)
        expected = "unknown" if planned is None else f"{planned:g}"
        while True:
            answer = self._ask(f"  Air at the sensor, by your thermometer \\[{expected}] deg C > ").strip().lower()
            if answer == "q":
                return Say.STOP
            wrong = self._note(point, f"air={answer}") if answer else None
            if wrong is None:
                return Say.GO
            self._console.print(f"  {wrong}", style="yellow", highlight=False)

    def _note(self, point: Point, answer: str) -> str | None:
        """Take ``key=number`` pairs; returns what is wrong with them."""
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
        """What was measured otherwise than planned; it holds until the plan has another value."""
        planned = point.columns
        self._measured = {
            column: (then, value) for column, (then, value) in self._measured.items() if planned.get(column) == then
        }
        return {column: value for column, (_, value) in self._measured.items()}

    def _left(self, place: Place) -> str:
        """Time that the rest may take, at this person's pace."""
        rest = self._points[place.number - 1 :]
        pace = 1.0
        if self._planned_setup_s > 0.0:
            # Half a plan's worth of trust in the guess, so that the first minutes do not decide.
            pace = (self._real_setup_s + 600.0) / (self._planned_setup_s + 600.0)
        before = self._last
        left_s = 0.0
        for point in rest:
            left_s += reading_s(self._campaign, point) + pace * setup_s(before.setup if before else None, point.setup)
            before = point
        return f"about {duration(left_s)} left"

    def _screen(self, point: Point, watches: Mapping[str, Watch]) -> RenderableType:
        lines: list[RenderableType] = []
        for watch in watches.values():
            share = min(watch.read / point.readings, 1.0)
            bar = "█" * round(share * BAR_CELLS)
            lines.append(Text(f"{watch.sensor} {bar:·<{BAR_CELLS}} {watch.read} of {point.readings} readings"))
            lines.append(histogram(watch))
        lines.extend(Text(f"  ! {text}", style="yellow") for text in self._noticed[-4:])
        return Group(*lines)

    def _end_live(self) -> None:
        if self._live is not None:
            self._live.stop()
            self._live = None


def histogram(watch: Watch) -> Table:
    """The readings of a point, whole centimetres about their median, and the rest in a line above and below."""
    table = Table.grid(padding=(0, 1))
    for label, count, style in _bars(watch):
        most = max(max(watch.counts.values(), default=1), watch.no_echo, 1)
        cells = math.ceil(count / most * BAR_CELLS)
        table.add_row(Text(f"{label:>12}"), Text("█" * cells, style=style), Text(str(count)))
    return table


def _bars(watch: Watch) -> Iterator[tuple[str, int, str]]:
    median_cm = watch.median_cm
    if median_cm is not None:
        reach = ROWS_MOST // 2
        centre = round(median_cm)
        near = {each: count for each, count in watch.counts.items() if abs(each - centre) <= reach}
        shorter = sum(count for each, count in watch.counts.items() if each < centre - reach)
        longer = sum(count for each, count in watch.counts.items() if each > centre + reach)
        if shorter:
            yield "shorter", shorter, "yellow"
        for each in range(min(near, default=centre), max(near, default=centre) + 1):
            yield f"{each} cm", near.get(each, 0), "green"
        if longer:
            yield "longer", longer, "yellow"
    if watch.no_echo:
        yield "no echo", watch.no_echo, "red"


def duration(seconds: float) -> str:
    """A time as people say it.

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
        Status.IMPOSSIBLE: "an answer that cannot be",
        Status.PART_INFO: "part information in place of an answer",
    }[status]


def show_plan(console: Console, campaign: Campaign, points: Sequence[Point], done: Callable[[Point], bool]) -> None:
    """What is to be done, in order, and how long it may take."""
    from msp_lab.campaigns.plan import changes

    before: Point | None = None
    total_s = 0.0
    readings = 0
    for number, point in enumerate(points, start=1):
        mark = "done" if done(point) else f"{point.readings} readings"
        console.print(f"{number:4d}  {point.name}   {mark}", highlight=False)
        for line in changes(before, point):
            console.print(f"        {line}", style="dim", highlight=False)
        if not done(point):
            total_s += reading_s(campaign, point) + setup_s(before.setup if before else None, point.setup)
            readings += point.readings * len(point.setup.sensors)
        before = point
    console.print(f"{readings} readings are left, which may take {duration(total_s)}")
