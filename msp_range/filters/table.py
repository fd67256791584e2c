"""The filters that an airframe file may name. A new one is a file beside this one and a line here."""

from typing import Annotated

from pydantic import Field

from msp_range.filters.changepoint import ChangepointParameters
from msp_range.filters.kalman import KalmanParameters
from msp_range.filters.median import MedianParameters
from msp_range.filters.moving_average import MovingAverageParameters

FilterParameters = Annotated[
    MovingAverageParameters | MedianParameters | KalmanParameters | ChangepointParameters,
    Field(discriminator="filter"),
]
