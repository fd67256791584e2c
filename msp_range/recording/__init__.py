"""Recordings on disk that survive a power cut, and measured data in the one CSV form.

`writer` is what flies; `reader` and the rest open what it has left.
"""
