"""The one way in which tests wait, in real time, for another program, a page, a link or a thread."""

import inspect
import time
from collections.abc import Callable
from pathlib import Path

LIMIT_S = 60.0
"""How long a test waits for what must come [s]. Nothing here takes a tenth of it on an idle computer: less fails tests
on a busy one, more only delays the message of a test that fails."""


def until(
    holds: Callable[[], bool],
    limit_s: float = LIMIT_S,
    work: Callable[[], object] = lambda: time.sleep(0.002),
    seen: Callable[[], object] | None = None,
) -> None:
    """Wait until something holds.

    Parameters
    ----------
    holds
        Whether it does.
    limit_s
        For how long [s]; it is asked once more at the end, whatever has kept this process from asking.
    work
        What is done between two questions.
    seen
        The state in which it was seen last, for the message.

    Raises
    ------
    AssertionError
        It does not hold in time.
    """
    _wait(holds, limit_s, work, lambda: f"{_source(holds)}; seen last: {seen() if seen else 'not known'}")


def until_passes(
    check: Callable[[], object], limit_s: float = LIMIT_S, work: Callable[[], object] = lambda: time.sleep(0.002)
) -> None:
    """Wait until all that a function asserts holds at the same time; as `until`, with the last failed assertion."""
    failed: list[AssertionError] = []

    def passes() -> bool:
        try:
            check()
        except AssertionError as error:
            failed[:] = [error]
            return False
        return True

    _wait(passes, limit_s, work, lambda: f"{_source(check)}; seen last: {failed[0]}")


def without_processor_s(process: int | str = "thread-self") -> float:
    """For how long a process, or this thread, could have run since it began and had no processor [s] (proc(5))."""
    _, waited_ns, _ = Path(f"/proc/{process}/schedstat").read_text().split()
    return 1e-9 * int(waited_ns)


def _wait(holds: Callable[[], bool], limit_s: float, work: Callable[[], object], describe: Callable[[], str]) -> None:
    give_up_s = time.monotonic() + limit_s
    is_over = False
    while not holds():
        assert not is_over, f"not within {limit_s:.0f} s: {describe()}"
        work()
        is_over = time.monotonic() >= give_up_s


def _source(condition: Callable[[], object]) -> str:
    try:
        return " ".join(inspect.getsource(condition).split())
    except (OSError, TypeError):
        return repr(condition)
