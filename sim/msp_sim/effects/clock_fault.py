"""Effect: the bus master samples too early."""

from msp_sim.effects.base import Effect, damage, share_of_readings
from msp_sim.effects.codes import ClockFault

CLOCK_FAULT = Effect(
    name="clock_fault",
    sentence="The computer samples the bus before the sensor is ready, and 3 m arrives as more than 300 m.",
    finding="{share:of} readings are fetched too early and arrive as more than 300 m",
    physics="bit 15 reads as one: 32768 + reading",
    source="Raspberry Pi 1-4 sample SDA while the sensor still stretches the clock; cured by a bus clock of 50 kHz",
    parameters=(share_of_readings("share of the readings affected"),),
    channels=("code",),
    experiment="the same wall with dtparam=i2c_arm_baudrate at 100000 and at 50000",
    apply=damage(ClockFault()),
)
