"""The emulated device of the driver `acme`, for simulated flights and benches."""

from msp_sim.device.device import DeviceTiming, NotAcknowledged, RangeFinder

RANGE_COMMAND = b"\x01"
ADDRESS_COMMAND = 0x02


class EmulatedAcme(RangeFinder):
    """One sonar on the bus: centimetres of the world enter, millimetres leave."""

    minimum_cm = 3
    no_echo_cm = 600
    default_timing = DeviceTiming(ready_s=0.02, s_per_cm=58e-6, no_echo_s=0.05)
    fault_kinds = frozenset(
        {"missed_read", "stuck", "no_echo", "noisy", "offset", "silent", "power_cycle", "locked_up"}
    )

    def power_cycle(self) -> None:
        """Lose the last ranging."""
        super().power_cycle()
        self._answer = b"\xff\xff"

    def write(self, data: bytes) -> None:
        """Range, or take another address; raises NotAcknowledged while it ranges."""
        now_s = self._acknowledge()
        if data == RANGE_COMMAND:
            self._ping(now_s)
        elif len(data) == 2 and data[0] == ADDRESS_COMMAND:
            self.address = data[1]

    def read(self, count: int) -> bytes:
        """Millimetres, most significant byte first; raises NotAcknowledged while it ranges."""
        centimetres = int.from_bytes(self._read_answer(self._acknowledge()), "big")
        word = 0xFFFF if centimetres >= self.no_echo_cm else 10 * centimetres
        return word.to_bytes(2, "big").ljust(count, b"\xff")[:count]

    def _acknowledge(self) -> float:
        now_s = self._with_power()
        if now_s < self._busy_until_s:
            raise NotAcknowledged
        return now_s
