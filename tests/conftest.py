"""What all tests need of the process that runs them."""

import signal
from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="session")
def _sigint_is_not_ignored() -> Iterator[None]:
    """A shell starts what is to run in the background with SIGINT ignored, and so would be all that tests start."""
    before = signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)
