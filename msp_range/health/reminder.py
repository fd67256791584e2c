"""When an autopilot gets all texts of what is wrong once more: it has come, or has started again and forgotten them."""

AGAIN_S = 10.0
"""At most this often [s]: an autopilot whose clock jumps seems to start again with each jump. A real one takes longer
to start; a larger value leaves a pilot without the texts for longer."""


class Reminder:
    """One autopilot's comings and restarts."""

    _reboots: int | None = None
    _waits = False
    _sent_s = float("-inf")

    def is_due(self, now_s: float, reboots: int | None) -> bool:
        """Whether the texts are to be sent now; they then count as sent.

        Parameters
        ----------
        now_s
            Time [s].
        reboots
            How often the autopilot has started again; None: it is not received.
        """
        if reboots not in (None, self._reboots):
            self._waits = True
        self._reboots = reboots
        if not self._waits or reboots is None or now_s - self._sent_s < AGAIN_S:
            return False
        self._waits, self._sent_s = False, now_s
        return True
