"""A sensor in a configuration file: its address on the bus or its serial port, and the file of its model.

Airframes and campaigns extend this section with further keys.
"""

import re
from typing import Annotated

from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from msp_range.bus import shown
from msp_range.mavlink.transport.url import SerialUrl, parse_url
from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.sensors.base import Driver
from msp_range.sensors.table import find_driver
from msp_range.yaml_file import Section, load_named


def _understood(address: object) -> object:
    """Refuse the 8-bit form of data sheets with the address that is meant, and what is neither address nor port."""
    if isinstance(address, str):
        if re.fullmatch(r"0x[0-9a-fA-F]+|\d+", address):
            raise ValueError(f"expected a number without quotes: address: {address}")
        try:
            url = parse_url(address)
        except ValueError:
            url = None
        if not isinstance(url, SerialUrl) or str(url) != address:
            raise ValueError(f"expected a 7-bit I2C address such as 0x70, or {PORT}")
    if isinstance(address, int) and 0x80 <= address <= 0xEF:  # 0xEF: of a read from 0x77
        raise ValueError(f"0x{address:02X} is the 8-bit form of 0x{address >> 1:02x}; expected the 7-bit form")
    return address


PORT = "serial:PATH:BAUD such as serial:/dev/ttyUSB0:9600"
Address = Annotated[Annotated[int, Field(ge=0x03, le=0x77)] | str, BeforeValidator(_understood)]
Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class SensorOnBus(Section):
    """One range finder on the bus, or on a serial port."""

    name: Name
    """name of the sensor: lower-case letters, digits and underscores"""
    address: Address
    """7-bit I2C address, e.g. 0x70; or the serial port of a sensor that has one, e.g. serial:/dev/ttyUSB0:9600"""
    model: str
    """sensor model file, relative to this file"""

    _model: SensorModel = PrivateAttr()
    _driver: type[Driver] = PrivateAttr()

    @model_validator(mode="after")
    def _load_model(self, info: ValidationInfo) -> "SensorOnBus":
        self._model = load_named(info, self.model, "sensors", load_sensor_model)
        driver = find_driver(self._model.driver)
        if driver is None:
            raise ValueError(f"expected a sensor that the bridge has a driver for; {self.model} says driver: none")
        if isinstance(self.address, str) != driver.is_serial:
            where = (
                f"a serial port, as address: {PORT}" if driver.is_serial else "the I2C bus, at an address such as 0x70"
            )
            raise ValueError(f"{driver.part} is on {where}; found {self.shown_address}")
        if not isinstance(self.address, str) and driver.ignores_address(self.address):
            raise ValueError(f"{driver.part} cannot have the address 0x{self.address:02x}; choose another one")
        self._driver = driver
        return self

    @property
    def shown_address(self) -> str:
        """Its address as files and messages write it."""
        return shown(self.address)

    @property
    def sensor_model(self) -> SensorModel:
        """The content of the model file."""
        return self._model

    @property
    def driver(self) -> type[Driver]:
        """The driver of this kind of sensor."""
        return self._driver
