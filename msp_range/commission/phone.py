"""Commissioning from a phone: the same steps, with a page on the network in place of the terminal.

Whoever starts the command at the vehicle opens the page for `WINDOW_S`, to the one browser that gives the code which
the terminal shows. Nothing is written once that time is over. The page speaks JSON over one WebSocket: lines,
instructions and questions go out, answers come in.
"""

import hmac
import json
import secrets
from contextlib import suppress
from http import HTTPStatus
from importlib.resources import files
from queue import Empty, SimpleQueue
from threading import Lock, Thread
from typing import Any, Self, TextIO

from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response
from websockets.sync.server import ServerConnection, serve

from msp_range.clock import Clock
from msp_range.commission.command import commission
from msp_range.commission.operator import EXPECTED_HEIGHT, height_of
from msp_range.commission.session import Session
from msp_range.errors import UserError
from msp_range.terminal import wrapped
from msp_range.watch.place import Listen
from msp_range.web.access import refusal
from msp_range.web.network import hosts, show_code
from msp_range.web.server import file_response
from msp_range.yaml_file import ConfigError

WINDOW_S = 600.0
"""How long the page is open [s]: all steps but the flight take some eight minutes. Longer leaves a vehicle open that
its owner has left, shorter ends within a step."""
CODE_DIGITS, MOST_TRIES = 6, 5
"""Digits of the code, and how many wrong ones end the command: one in 200,000 is guessed. More of either is safer
against a guess, and worse for the person who types it with gloves."""
LONGEST_ANSWER = 200
"""Bytes that a browser may send at once: a code, or a height."""
POLL_S = 0.2
"""Time between two looks at whether the page's time is over [s]; it is also how long Ctrl-C at the vehicle takes."""
OVER = "the ten minutes of the page are over; nothing more was changed. The same command goes on here"
PROPELLERS = "Are the propellers off? The vehicle is lifted and tilted by hand."
OFF = "they are off"
EVERYWHERE = "0.0.0.0"
"""As the host of `Listen`: on all networks."""


def by_phone(session: Session, step: str | None, listen: Listen, out: TextIO) -> dict[str, Any]:
    """Do as `commission` does, with a page for ten minutes in place of the terminal; its report.

    Raises
    ------
    ConfigError
        As `commission`; the page's time is over, or the propellers are on.
    """
    with PhonePage(listen, session.clock) as page:
        places = [listen.host] if listen.host != EVERYWHERE else hosts() or [listen.host]
        urls = [f"http://{place}:{listen.port}/" for place in places]
        show_code(f"{urls[0]}?code={page.code}", out)
        out.write(
            f"On the phone open {' or '.join(urls)} and give the code {page.code}.\n"
            "One browser gets in, for ten minutes; the connection is not encrypted. Ctrl-C ends it.\n"
        )
        out.flush()
        try:
            if page.ask(PROPELLERS, OFF, "no") != OFF:
                raise ConfigError("take the propellers off, then the same command again; nothing was changed")
            session.operator = PersonAtPhone(page, out)
            report = commission(session, step)
        except UserError as error:
            page.show("end", str(error))
            raise
        page.show("end", _end_of(report))
    return report


def _end_of(report: dict[str, Any]) -> str:
    """What the page shows last of a report of `commission`.

    Examples
    --------
    >>> _end_of({"steps": {"wires": {"passed": True}}, "next": "addresses"})
    'It has passed; next: addresses.'
    """
    for name, each in report["steps"].items():
        if not each["passed"]:
            return f"{name} has not passed: see below."
    return "All steps have passed." if report["next"] is None else f"It has passed; next: {report['next']}."


class PhonePage:
    """The page, from the command on: use it in a ``with`` statement.

    Parameters
    ----------
    listen
        Host and port.
    clock
        For the end of its time.

    Raises
    ------
    ConfigError
        The port cannot be had.

    Attributes
    ----------
    code
        What the browser must give.
    """

    def __init__(self, listen: Listen, clock: Clock) -> None:
        self.code = f"{secrets.randbelow(10**CODE_DIGITS):0{CODE_DIGITS}d}"
        self._clock, self._end_s = clock, clock.now() + WINDOW_S
        # What the browser that gave the code shows when it comes again, such as after the phone slept.
        self._secret: str | None = None
        self._tries = 0
        self._lock = Lock()
        self._browser: ServerConnection | None = None
        self._shown: list[dict[str, Any]] = []
        self._answers: SimpleQueue[tuple[int, str]] = SimpleQueue()
        self._files = {file.name: file.read_bytes() for file in (files("msp_range.commission") / "static").iterdir()}
        try:
            self._server = serve(
                self._on_browser,
                listen.host,
                listen.port,
                process_request=self._on_request,
                max_size=LONGEST_ANSWER,
                compression=None,
            )
        except OSError as error:
            raise ConfigError(f"--listen {listen.host}:{listen.port}: {error.strerror or error}") from None
        self._thread = Thread(target=self._server.serve_forever, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock, suppress(ConnectionClosed):
            if self._browser is not None:
                self._browser.close()
        self._server.shutdown()
        self._thread.join()

    def show(self, kind: str, text: str, **more: object) -> None:
        """Show something: a ``line``, an ``instruction``, or the ``end``."""
        with self._lock:
            self._shown.append({"kind": kind, "text": text, **more})
            self._send(self._shown[-1])

    def ask(self, text: str, *answers: str) -> str:
        """One of the answers, or with none given what the person types.

        Raises
        ------
        ConfigError
            The page's time is over.
        """
        number = len(self._shown)
        self.show("question", text, number=number, answers=answers)
        while self._clock.now() < self._end_s:
            with suppress(Empty):
                answered, answer = self._answers.get(timeout=POLL_S)
                # A button that was pressed twice has answered this already.
                if answered == number and (not answers or answer in answers) and self._clock.now() < self._end_s:
                    self.show("answer", answer)
                    return answer
            if self._tries >= MOST_TRIES:
                raise ConfigError(f"{MOST_TRIES} wrong codes: the page is closed. The same command opens it again")
        raise ConfigError(OVER)

    def _send(self, message: dict[str, Any]) -> None:
        with suppress(ConnectionClosed):
            if self._browser is not None:
                self._browser.send(json.dumps(message))

    def _on_request(self, connection: ServerConnection, request: Request) -> Response | None:
        path = request.path.partition("?")[0]
        try:
            # Whoever knows the code is let in; a page of another site is not, whatever it knows.
            refused = refusal("", None, request.headers.get("Host"), request.headers.get("Origin"))
        except (ValueError, LookupError):
            refused = HTTPStatus.BAD_REQUEST, "expected one address each in Host and Origin\n"
        if refused is not None:
            return connection.respond(*refused)
        return None if path == "/live" else file_response(connection, path, self._files)

    def _on_browser(self, browser: ServerConnection) -> None:
        with suppress(ConnectionClosed, ValueError, KeyError, TypeError):
            refused = self._refused(json.loads(browser.recv()))
            if refused is not None:
                browser.send(json.dumps({"kind": "refused", "text": refused}))
                return
            with self._lock:
                before, self._browser = self._browser, browser
                browser.send(json.dumps({"kind": "open", "secret": self._secret, "left_s": self._left_s}))
                for message in self._shown:
                    self._send(message)
            if before is not None:
                before.close()
            for answer in browser:
                found = json.loads(answer)
                self._answers.put((int(found["number"]), str(found["answer"])))

    @property
    def _left_s(self) -> float:
        return max(self._end_s - self._clock.now(), 0.0)

    def _refused(self, first: dict[str, Any]) -> str | None:
        """Why a browser may not come in, by its first message; None: it may."""
        with self._lock:
            if self._left_s <= 0 or self._tries >= MOST_TRIES:
                return "The page is closed: start the command at the vehicle again."
            if self._secret is not None:
                known = hmac.compare_digest(str(first.get("secret")).encode(), self._secret.encode())
                return None if known else "Another browser has used the code. Start the command at the vehicle again."
            if not hmac.compare_digest(str(first.get("code")).encode(), self.code.encode()):
                self._tries += "code" in first
                return f"That is not the code that the terminal shows; {MOST_TRIES - self._tries} tries are left."
            self._secret = secrets.token_urlsafe()
            return None


class PersonAtPhone:
    """A person with a phone next to the vehicle.

    Parameters
    ----------
    page
        Where she reads and answers.
    out
        The terminal, which shows what was found too.
    """

    def __init__(self, page: PhonePage, out: TextIO) -> None:
        self._page, self._out = page, out

    def begin(self, text: str) -> None:
        """Explain a step, and wait until she is ready."""
        self._page.ask(" ".join(text.split()), "ready")

    def instruct(self, text: str) -> None:
        """Show what is to be done from now on; the phone vibrates."""
        self._page.show("instruction", text)

    def show(self, text: str) -> None:
        """Show what was found, which the page breaks into lines itself."""
        self._page.show("line", text.strip("\n"))
        self._out.write("\n".join([*wrapped(text), ""]))
        self._out.flush()

    def agrees(self, text: str) -> bool:
        """Ask with yes or no whether to make a change."""
        return self._page.ask(text, "change it", "leave it") == "change it"

    def height_m(self, text: str) -> float | None:
        """Ask for a measured height until it is one [m]; None: there is no further one."""
        question = f"{text}\nHeight in metres; leave it empty if there is no further one."
        while answer := self._page.ask(question).strip():
            height_m = height_of(answer)
            if height_m is not None:
                return height_m
            question = f"found {answer!r}; {EXPECTED_HEIGHT}"
        return None
