"""The one error of recordings and measured data, and a new file that ends in it."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from msp_range.errors import UserError
from msp_range.input_file import making


class RecordingError(UserError, ValueError):
    """A recording or a file of measured data that cannot be read or written; the text is for a person."""


@contextmanager
def new_file(path: Path | str, *, replacing: bool = False) -> Iterator[Path]:
    """Write a file as `making` does; raises RecordingError as `written` does."""
    with written(path), making(path, replacing=replacing) as unfinished:
        yield unfinished


@contextmanager
def written(path: Path | str) -> Iterator[None]:
    """Context in which a file is written.

    Raises
    ------
    RecordingError
        There is such a file already and it is not to be replaced, or the file cannot be written.
    """
    try:
        yield
    except FileExistsError:
        raise RecordingError(f"{path}: there is a file already, and none is overwritten") from None
    except OSError as error:
        raise RecordingError(f"{path}: cannot be written: {error.strerror}") from None
