"""A separate random stream for each part of a model, so that adding an effect does not change what the others draw."""

from zlib import crc32

import numpy as np


class RandomStreams(dict[str, np.random.Generator]):
    """Random generators by name, all derived from one.

    Parameters
    ----------
    rng
        Four numbers are drawn from it, for any number of streams.

    Examples
    --------
    >>> one, other = RandomStreams(np.random.default_rng(1)), RandomStreams(np.random.default_rng(1))
    >>> _ = other["crosstalk"].random(5)
    >>> one["hit"].random() == other["hit"].random()
    True
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._entropy = [int(word) for word in rng.integers(2**32, size=4)]
        self.last_error: dict[str, tuple[float, float]] = {}
        """Correlated noise: time [s] and error [standard deviations] of each series' last hit."""

    def __missing__(self, name: str) -> np.random.Generator:
        """The stream of this name, which is kept and continues from its present state."""
        self[name] = self._generator(name)
        return self[name]

    def normal_of(self, name: str, key: str) -> float:
        """A standard normal number that is always the same for the same key."""
        return float(self._generator(name, key).standard_normal())

    def _generator(self, *names: str) -> np.random.Generator:
        key = tuple(crc32(name.encode()) for name in names)
        return np.random.default_rng(np.random.SeedSequence(self._entropy, spawn_key=key))
