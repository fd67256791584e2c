"""Who may see the page: programs of this computer without a token, and those of others with one.

Without a token a request is refused whose ``Host`` is no name of this computer: a page of the internet may resolve its
own name to 127.0.0.1. With one any ``Host`` is taken, since such a page does not know the token. A request whose
``Origin`` is another site (a page of the internet that opens a connection to here) is always refused.
"""

import hmac
import os
import secrets
from http import HTTPStatus
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

from msp_range.state_folder import state_folder
from msp_range.watch.place import LOOPBACK, Listen

TOKEN_BYTES = 16
"""128 bits: too many to try."""


def refusal(
    token: str | None, target: str | None, host: str | None, origin: str | None
) -> tuple[HTTPStatus, str] | None:
    """Status and text of the refusal of a request; None if it is allowed.

    Parameters
    ----------
    token
        Token that the request's address must have as ``?token=``; None: not needed.
    target
        Path and query of the request; None for files that need no token because they show nothing of the vehicle
        (styles, scripts).
    host, origin
        Its headers; None where there is none.

    Raises
    ------
    ValueError
        One of them is no address.

    Examples
    --------
    >>> refusal(None, "/", "127.0.0.1:8080", None) is None
    True
    >>> refusal(None, "/live", "127.0.0.1:8080", "http://example.org")[0].value
    403
    """
    if host is None:
        return HTTPStatus.FORBIDDEN, "the request has no Host header\n"
    if token is None and urlsplit(f"//{host}").hostname not in LOOPBACK:
        return HTTPStatus.FORBIDDEN, f"this page is for {LOOPBACK[0]} only; found Host {host}\n"
    if origin is not None and urlsplit(origin).netloc != host:
        return HTTPStatus.FORBIDDEN, f"this page is not for other sites; found Origin {origin}\n"
    if token is not None and target is not None:
        found = parse_qs(urlsplit(target).query).get("token", [""])[0]
        if not hmac.compare_digest(found.encode(), token.encode()):
            return HTTPStatus.UNAUTHORIZED, "the address needs ?token=...; the bridge's log has it\n"
    return None


def token_for(listen: Listen) -> str | None:
    """The token that requests to an address need, see `refusal`: none on this computer's own.

    The token outlives a restart, so that an open page finds the bridge again.
    """
    return None if listen.host in LOOPBACK else _token(state_folder() / "web-token")


def _token(path: Path) -> str:
    """The token in a file, which is made where there is none."""
    try:
        found = path.read_text().strip()
    except FileNotFoundError:
        found = ""
    if found:
        return found
    made = secrets.token_urlsafe(TOKEN_BYTES)
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), "w") as file:
        file.write(made)
    return made
