"""The catalogue of effects: physics that a sensor's readings may show on top of the base mixture, one file each."""

from msp_sim.effects.air_temperature import AIR_TEMPERATURE
from msp_sim.effects.base import Effect
from msp_sim.effects.beyond_field_of_view import BEYOND_FIELD_OF_VIEW
from msp_sim.effects.crosstalk import CROSSTALK
from msp_sim.effects.hot_box import HOT_BOX

CATALOGUE: dict[str, Effect] = {
    effect.name: effect
    for effect in (
        AIR_TEMPERATURE,
        HOT_BOX,
        BEYOND_FIELD_OF_VIEW,
        CROSSTALK,
    )
}
"""Effects by name."""
