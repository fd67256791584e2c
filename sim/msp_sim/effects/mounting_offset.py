"""A sensor that is not mounted where the airframe file says."""

from collections.abc import Mapping

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(bias_cm=values["offset_cm"])


MOUNTING_OFFSET = Effect(
    name="mounting_offset",
    sentence="One sensor sits a little higher or lower than the others, so it reads too far or too near everywhere.",
    physics="a constant added to every range of one sensor; of all sensors alike it is calibration",
    source="geometry",
    parameters=(Parameter("offset_cm", "cm", "how much too far this sensor reads", -50.0, 50.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="all sensors before one wall at once, then two of them swapped: the offset stays with its place",
    apply=_apply,
    per="sensor",
    equivalent_causes=("the reference's offset for this sensor",),
)
