"""Ranges that are cut to whole centimetres, not rounded."""

from collections.abc import Mapping

from msp_sim.effects.base import Contribution, Effect, Parameter, Scene


def _apply(scene: Scene, values: Mapping[str, float]) -> Contribution:
    return Contribution(bias_cm=-0.5 * values["share"])


FLOORING = Effect(
    name="flooring",
    sentence="The sensor cuts off fractions of a centimetre in place of rounding them: half a centimetre too near.",
    physics="floor(x) = round(x - 1/2): an offset of half a step, whatever the noise",
    source="integer arithmetic",
    parameters=(Parameter("share", "1", "1 where every reading is cut", 0.0, 1.0),),
    requires=("true_range_cm",),
    channels=("bias",),
    experiment="none tells it from an offset of -0.5 cm; both are calibration",
    apply=_apply,
    equivalent_causes=("an offset of -0.5 cm",),
)
