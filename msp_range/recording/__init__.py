"""Recordings on disk that survive a power cut, and measured data in the one CSV form."""

from msp_range.recording.error import RecordingError
from msp_range.recording.reader import Recording
from msp_range.recording.writer import Recorder

__all__ = ["Recorder", "Recording", "RecordingError"]
