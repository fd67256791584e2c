"""When an autopilot gets all texts of what is wrong once more: it has come, or has started again and forgotten them."""

AGAIN_S = 10.0
"""At most this often [s]: an autopilot whose clock jumps seems to start again with each jump. A real one takes longer
to start; a larger value leaves a pilot without the texts for longer."""


class Reminder:
    """One autopilot's comings and restarts."""

    def __init__(self) -> None:
        self._was_there = False
        self._known_reboots = 0
        self._waits = False
        self._sent_s = float("-inf")

    def is_due(self, now_s: float, is_there: bool, reboots: int) -> bool:
        """Whether the texts are to be sent now; they then count as sent.

        Parameters
        ----------
        now_s
            Time [s].
        is_there, reboots
            Whether the autopilot is received, and how often it has started again.
        """
        if is_there and (not self._was_there or reboots != self._known_reboots):
            self._waits = True
        self._was_there, self._known_reboots = is_there, reboots
        if not (self._waits and is_there and now_s - self._sent_s >= AGAIN_S):
            return False
        self._waits, self._sent_s = False, now_s
        return True
