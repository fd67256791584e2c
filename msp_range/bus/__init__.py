"""The I2C bus behind a two-verb interface, so that a driver runs on a kernel bus, an emulation or a recording."""

from msp_range.bus.base import Bus, BusError
