"""Readings cut to eight bits."""

from collections.abc import Mapping

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene
from msp_sim.effects.codes import Saturated


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(fault=Saturated(), fault_share=values["share"])


SATURATED_BYTE = Effect(
    name="saturated_byte",
    sentence="Ranges beyond 255 cm all arrive as 255: they do not fit into the one byte that somebody kept.",
    physics="min(reading, 255)",
    source="report 4.3.2: 255 beside 765; 8-bit variables in drivers and loggers",
    parameters=(Parameter("share", "1", "share of the readings that it befalls", 0.0, 1.0),),
    requires=(),
    channels=("code",),
    experiment="a wall at 300 cm: 255 in place of 300, where OR-ed bytes would give 45",
    apply=_apply,
)
