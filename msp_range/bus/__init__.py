"""I2C bus and serial ports behind a two-verb interface, for a driver on real wires, an emulation or a recording."""

from msp_range.bus.base import Address, Bus, BusError, shown
