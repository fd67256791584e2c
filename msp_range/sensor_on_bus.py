"""A sensor as a configuration file names it: its address on the bus, and the file of its model.

An entry of a YAML file enters, a checked `SensorOnBus` leaves. Airframes and campaigns say more of a sensor, each in a
section of its own that extends this one.
"""

from typing import Annotated

from pydantic import Field, PrivateAttr, ValidationInfo, field_validator, model_validator

from msp_range.reading_model.sensor_model import SensorModel, load_sensor_model
from msp_range.sensors.addressing import ILLEGAL_8BIT
from msp_range.yaml_file import Section, load_named

Name = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class SensorOnBus(Section):
    """One range finder on the bus."""

    name: Name
    """a name of its own: small letters, digits and underscores"""
    address: int = Field(ge=0x03, le=0x77)
    """7-bit I2C address, e.g. 0x70"""
    model: str
    """sensor model file, relative to this file"""

    _model: SensorModel = PrivateAttr()

    @field_validator("address")
    @classmethod
    def _legal(cls, address: int) -> int:
        if address << 1 in ILLEGAL_8BIT:
            raise ValueError(f"an MB1242 cannot have the address 0x{address:02x}; choose another one")
        return address

    @model_validator(mode="after")
    def _load_model(self, info: ValidationInfo) -> "SensorOnBus":
        self._model = load_named(info, self.model, load_sensor_model)
        return self

    @property
    def sensor_model(self) -> SensorModel:
        """The content of the file that ``model`` names."""
        return self._model
