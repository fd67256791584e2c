"""The one error of recordings and measured data."""

from msp_range.errors import UserError


class RecordingError(UserError, ValueError):
    """A recording or a file of measured data that cannot be read or written; the text is for a person."""
